#!/usr/bin/env python3
"""Both odometries are paired by stamp and are on the disk as they come."""

import csv
import json
import math
import os
import re
import tempfile
from pathlib import Path
from unittest import mock

import rospy
import rostest
from lab_testing import PACKAGE, NodeTest, odometry, wait_for
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import Imu
from std_msgs.msg import Time

from bullet_lab.reports import save_all
from bullet_lab.reports.squares import SquaresReport
from bullet_lab.ros.node.node import NodeError
from bullet_lab.ros.record.plots import PlotParameters, plot

PNG = b"\x89PNG\r\n\x1a\n"
PERIOD = 0.05


def perfect(k):
    """The k-th message of a robot that drives along x."""
    return odometry(PERIOD * k, 0.01 * k)


def noisy(k):
    """The same with an error of its own."""
    return odometry(PERIOD * k, 0.01 * k, 1.0, 0.001 * k)


class PlotNoiseTest(NodeTest):
    """Each test has a folder of its own."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.out = Path(folder.name) / "new" / "out"

    def start(self, **parameters):
        node = self.node("plot_noise.py", out=self.out, **parameters)
        self.perfect = self.publisher("odom", Odometry)
        self.noisy = self.publisher("noisy_odom", Odometry)
        return node

    def send(self, ks):
        """Publish both messages of each number."""
        for k in ks:
            self.perfect.publish(perfect(k))
            self.noisy.publish(noisy(k))

    def rows(self, name="paths.csv"):
        """The rows of a table so far."""
        try:
            return list(csv.DictReader((self.out / name).read_text().splitlines()))
        except FileNotFoundError:
            # Not there so far, or just put aside.
            return []

    def summary(self):
        """What summary.json says so far."""
        path = self.out / "summary.json"
        return json.loads(path.read_text()) if path.exists() else {}

    def wait_for_rows(self, number):
        wait_for(lambda: len(self.rows()) >= number, f"{number} rows, have {self.rows()}")

    def assert_pairs(self, ks, name="paths.csv"):
        """Assert that the rows are the pairs of these numbers, in this order."""
        rows = [{key: float(value) for key, value in row.items()} for row in self.rows(name)]
        self.assertEqual([round(PERIOD * k, 6) for k in ks], [round(r["stamp"], 6) for r in rows])
        for k, row in zip(ks, rows):
            self.assertAlmostEqual(0.01 * k, row["x"], 9)
            self.assertAlmostEqual(0.0, row["y"], 9)
            self.assertAlmostEqual(0.01 * k, row["noisy_x"], 9)
            self.assertAlmostEqual(1.0, row["noisy_y"], 9)
            self.assertAlmostEqual(0.001 * k, row["noisy_yaw"], 9)

    def end(self, node):
        """Send Ctrl-C; return summary.json."""
        node.signal()
        self.assertEqual(0, node.wait(), node.err)
        self.assertNotIn("Traceback", node.err)
        return self.summary()

    def test_all_files_are_there_while_it_runs_and_after_ctrl_c(self):
        node = self.start(about="{std: 0.1, job: squares}", plot_period=0.3)
        self.send(range(1, 6))
        bad = [perfect(6) for _ in range(3)]
        bad[0].pose.pose.position.x = math.nan
        bad[1].pose.pose.orientation.w = 0.0
        bad[2].header.frame_id = "map"
        for message in (*bad, perfect(5)):
            self.perfect.publish(message)
        nan = noisy(6)
        nan.pose.pose.orientation.z = math.inf
        self.noisy.publish(nan)
        self.send(range(6, 11))
        wait_for(lambda: self.summary().get("pairs") == 10, "summary.json")
        self.assertEqual(PNG, (self.out / "paths.png").read_bytes()[: len(PNG)])
        for topic in ("odom_path", "noisy_odom_path"):
            # Late, and so what is latched.
            message = self.topic(topic, PathMessage).wait(1)[0]
            self.assertEqual(("odom", 10), (message.header.frame_id, len(message.poses)))
        summary = self.end(node)
        names = {"odom.tum", "noisy_odom.tum", "paths.csv", "paths.png", "summary.json"}
        self.assertEqual(names, {path.name for path in self.out.iterdir()})
        self.assertEqual((0.1, "squares"), (summary["std"], summary["job"]))
        self.assertEqual((False, 5), (summary["finished"], summary["refused_messages"]))
        self.assertAlmostEqual(1.0, summary["final_error_m"], 6)
        self.assertAlmostEqual(9 * PERIOD, summary["sim_time_s"], 6)
        self.assert_pairs(range(1, 11))

    def test_the_end_that_was_announced_after_a_new_run(self):
        node = self.start(until="over")
        over = self.publisher("over", Time)
        self.send(range(1, 21))
        self.wait_for_rows(20)
        # Time is set back.
        self.send(range(1, 6))
        wait_for(lambda: len(self.rows()) == 5, "a new table")
        # To there and no farther, whatever comes.
        over.publish(Time(rospy.Time.from_sec(8 * PERIOD)))
        self.send(range(6, 11))
        self.assertEqual((0, ""), (node.wait(), node.err))
        self.assert_pairs(range(1, 9))
        self.assert_pairs(range(1, 21), "run_1/paths.csv")
        self.assertTrue(self.summary()["finished"])

    def test_all_files_though_nothing_came(self):
        save_all(SquaresReport(self.out), finished=False)
        self.assertEqual((0, None), (self.summary()["pairs"], self.summary()["final_error_m"]))
        self.assertTrue((self.out / "paths.png").is_file())

    def test_full_disk(self):
        self.out.mkdir(parents=True)
        (self.out / "odom.tum").symlink_to("/dev/full")
        node = self.start()
        self.send(range(1, 6))
        self.assertEqual(1, node.wait())
        self.assertEqual(1, len(node.err.splitlines()), node.err)
        self.assertIn("odom.tum", node.err)

    def test_a_report_from_contributing(self):
        text = (PACKAGE / "CONTRIBUTING.md").read_text()
        pattern = r"`src/bullet_lab/reports/shake.py`\n\n```python\n(.*?)```"
        (code,) = re.findall(pattern, text, flags=re.DOTALL)
        folder = self.out.parents[1]
        (folder / "shake.py").write_text(code)
        with mock.patch.dict(os.environ):
            os.environ["PYTHONPATH"] = f"{folder}:{os.environ['PYTHONPATH']}"
            node = self.node("plot.py", out=self.out, report="shake:ShakeReport")
        imu = self.publisher("imu", Imu)
        for k in range(1, 6):
            message = Imu()
            message.header.stamp = rospy.Time(PERIOD * k)
            message.linear_acceleration.z = 9.8
            imu.publish(message)
        wait_for(lambda: len(self.rows("imu.csv")) == 5, "5 rows")
        self.assertEqual(5, self.end(node)["readings"])
        self.assertTrue((self.out / "shake.png").read_bytes().startswith(PNG))

    def test_a_report_that_is_not_there(self):
        missing = "bullet_lab.reports.nothing:Report"
        with self.assertRaisesRegex(NodeError, f"~report is '{missing}'"):
            plot.__wrapped__(PlotParameters(out=str(self.out), report=missing))


def setUpModule():
    rospy.init_node("plot_noise_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "plot_noise_test", "__main__")
