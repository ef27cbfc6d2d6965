#!/usr/bin/env python3
"""Both odometries are paired by stamp and are on the disk as they come."""

import csv
import json
import math
import os
import re
import signal
import tempfile
import time
import unittest
from pathlib import Path
from unittest import mock

import rospy
import rostest
from lab_testing import PACKAGE, Node, Topic, odometry, publisher, wait_for
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import Imu
from std_msgs.msg import Time

PNG = b"\x89PNG\r\n\x1a\n"
PERIOD = 0.05


def perfect(k):
    """The k-th message of a robot that drives along x."""
    return odometry(PERIOD * k, 0.01 * k)


def noisy(k):
    """The same with an error of its own."""
    return odometry(PERIOD * k, 0.01 * k, 1.0, 0.001 * k)


class PlotNoiseTest(unittest.TestCase):
    """Each test has a node and a folder of its own."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.out = Path(folder.name) / "new" / "out"

    def start(self, **parameters):
        node = Node("plot_noise.py", out=self.out, **parameters)
        self.addCleanup(node.end)
        self.perfect, self.noisy = self.publisher("odom"), self.publisher("noisy_odom")
        return node

    def publisher(self, topic):
        made = publisher(topic, Odometry)
        self.addCleanup(made.unregister)
        return made

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

    def lines(self, name):
        return (self.out / name).read_text().splitlines()

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

    def end(self, node, status=0):
        """Send Ctrl-C; return summary.json."""
        node.signal()
        self.assertEqual(status, node.wait(), node.err)
        self.assertNotIn("Traceback", node.err)
        return json.loads((self.out / "summary.json").read_text())

    def test_pairs_by_stamp_whatever_comes_first(self):
        node = self.start()
        for k in range(1, 6):  # all perfect ones first
            self.perfect.publish(perfect(k))
        wait_for(lambda: len(self.lines("odom.tum")) == 5, "the perfect path")
        for k in (1, 2, 4, 5):  # one is missing
            self.noisy.publish(noisy(k))
        self.wait_for_rows(4)
        for k in range(6, 11):  # now the noisy ones first
            self.noisy.publish(noisy(k))
        wait_for(lambda: len(self.lines("noisy_odom.tum")) == 9, "the noisy path")
        for k in range(6, 11):
            self.perfect.publish(perfect(k))
        self.wait_for_rows(9)
        summary = self.end(node)
        self.assert_pairs([1, 2, 4, 5, 6, 7, 8, 9, 10])
        self.assertEqual(9, summary["pairs"])
        self.assertEqual((10, 9), (len(self.lines("odom.tum")), len(self.lines("noisy_odom.tum"))))

    def test_nothing_is_lost_when_it_is_killed(self):
        node = self.start()
        self.assertEqual("stamp,x,y,yaw,noisy_x,noisy_y,noisy_yaw", self.lines("paths.csv")[0])
        self.send(range(1, 31))
        self.wait_for_rows(30)
        node.signal(signal.SIGKILL)
        node.wait()
        self.assert_pairs(range(1, 31))
        for name in ("odom.tum", "noisy_odom.tum"):
            rows = [[float(word) for word in line.split()] for line in self.lines(name)]
            self.assertEqual(30 * [8], [len(row) for row in rows])

    def test_ctrl_c_leaves_all_files(self):
        node = self.start(about="{std: 0.1, job: squares}")
        self.send(range(1, 41))
        self.wait_for_rows(40)
        summary = self.end(node)
        names = {"odom.tum", "noisy_odom.tum", "paths.csv", "paths.png", "summary.json"}
        self.assertEqual(names, {path.name for path in self.out.iterdir()})
        self.assertEqual(PNG, (self.out / "paths.png").read_bytes()[: len(PNG)])
        self.assertEqual((0.1, "squares"), (summary["std"], summary["job"]))
        self.assertEqual(
            (False, 40, 0), (summary["finished"], summary["pairs"], summary["refused_messages"])
        )
        self.assertAlmostEqual(1.0, summary["final_error_m"], 6)
        self.assertAlmostEqual(39 * PERIOD, summary["sim_time_s"], 6)

    def test_ctrl_c_before_anything_came(self):
        node = self.start()
        summary = self.end(node)
        self.assertEqual((0, None), (summary["pairs"], summary["final_error_m"]))
        self.assertTrue((self.out / "paths.png").is_file())

    def test_picture_and_summary_while_it_runs(self):
        self.start(plot_period=0.3)
        self.send(range(1, 11))
        self.wait_for_rows(10)

        def is_there():
            path = self.out / "summary.json"
            return path.exists() and json.loads(path.read_text())["pairs"] == 10

        wait_for(is_there, "summary.json")
        self.assertEqual(PNG, (self.out / "paths.png").read_bytes()[: len(PNG)])

    def test_ends_with_the_message_that_says_so(self):
        node = self.start(until="over")
        over = rospy.Publisher("over", Time, queue_size=1, latch=True)
        self.addCleanup(over.unregister)
        self.send(range(1, 11))
        self.wait_for_rows(10)
        # To here and no farther, though more has come already.
        over.publish(Time(rospy.Time.from_sec(8 * PERIOD)))
        self.assertEqual((0, ""), (node.wait(), node.err))
        self.assert_pairs(range(1, 9))
        self.assertEqual((8, 8), (len(self.lines("odom.tum")), len(self.lines("noisy_odom.tum"))))
        self.assertTrue(json.loads((self.out / "summary.json").read_text())["finished"])

    def test_waits_for_messages_up_to_the_announced_end(self):
        node = self.start(until="over")
        over = rospy.Publisher("over", Time, queue_size=1, latch=True)
        self.addCleanup(over.unregister)
        wait_for(lambda: over.get_num_connections() > 0, "the node to listen")
        self.send(range(1, 6))
        over.publish(Time(rospy.Time.from_sec(10 * PERIOD)))
        time.sleep(0.5)
        self.assertTrue(node.runs())
        self.send(range(6, 11))
        self.assertEqual((0, ""), (node.wait(), node.err))
        self.assert_pairs(range(1, 11))

    def test_time_set_back_begins_a_new_run(self):
        node = self.start()
        self.send(range(1, 21))
        self.wait_for_rows(20)
        self.send(range(1, 11))
        wait_for(lambda: len(self.rows()) == 10, "a new table")
        self.assert_pairs(range(1, 21), "run_1/paths.csv")
        self.send(range(1, 6))
        wait_for(lambda: len(self.rows()) == 5, "another new table")
        self.assertEqual(5, self.end(node)["pairs"])
        self.assert_pairs(range(1, 11), "run_2/paths.csv")
        self.assert_pairs(range(1, 6))
        self.assertEqual(
            (20, 20), (len(self.lines("run_1/odom.tum")), len(self.lines("run_1/noisy_odom.tum")))
        )

    def test_late_messages_of_the_old_run_stay_out_of_the_new_one(self):
        node = self.start()
        self.send(range(1, 19))
        self.wait_for_rows(18)
        for k in (19, 20, 1):
            self.perfect.publish(perfect(k))
        wait_for(lambda: (self.out / "run_1").is_dir(), "a new run")
        for k in (19, 20, 1):
            self.noisy.publish(noisy(k))
        self.send(range(2, 6))
        wait_for(lambda: len(self.rows()) == 5, "the pairs of the new run")
        self.end(node)
        self.assert_pairs(range(1, 6))
        self.assert_pairs(range(1, 19), "run_1/paths.csv")
        self.assertFalse((self.out / "run_2").exists())

    def test_what_cannot_be_used_is_refused_and_counted(self):
        node = self.start()
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
        self.wait_for_rows(10)
        self.assertEqual(5, self.end(node)["refused_messages"])
        self.assert_pairs(range(1, 11))

    def test_paths_for_rviz(self):
        self.start()
        self.send(range(1, 11))
        self.wait_for_rows(10)
        for topic in ("odom_path", "noisy_odom_path"):
            # Late, and so what is latched.
            path = Topic(topic, PathMessage)
            self.addCleanup(path.close)
            message = path.wait(1)[0]
            self.assertEqual("odom", message.header.frame_id)
            self.assertEqual(10, len(message.poses))

    def test_folder_that_cannot_be_written_to(self):
        self.out.parent.mkdir()
        self.out.write_text("a file")
        node = Node("plot_noise.py", out=self.out)
        self.addCleanup(node.end)
        self.assertEqual(1, node.wait())
        self.assertEqual(1, len(node.err.splitlines()), node.err)
        self.assertIn(str(self.out), node.err)

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
            node = Node("plot.py", out=self.out, report="shake:ShakeReport")
        self.addCleanup(node.end)
        imu = publisher("imu", Imu)
        self.addCleanup(imu.unregister)
        for k in range(1, 6):
            message = Imu()
            message.header.stamp = rospy.Time(PERIOD * k)
            message.linear_acceleration.z = 9.8
            imu.publish(message)
        wait_for(lambda: len(self.rows("imu.csv")) == 5, lambda: node.err)
        self.assertEqual(5, self.end(node)["readings"])
        self.assertTrue((self.out / "shake.png").read_bytes().startswith(PNG))

    def test_a_report_that_is_not_there(self):
        node = Node("plot.py", out=self.out, report="bullet_lab.reports.nothing:Report")
        self.addCleanup(node.end)
        self.assertEqual(1, node.wait())
        self.assertEqual(1, len(node.err.splitlines()), node.err)
        self.assertIn("~report is 'bullet_lab.reports.nothing:Report'", node.err)

    def test_bad_parameters(self):
        node = Node("plot_noise.py", about="[1]")
        self.addCleanup(node.end)
        self.assertEqual(2, node.wait(), node.err)
        self.assertEqual(1, len(node.err.splitlines()), node.err)
        self.assertIn("~about", node.err)


def setUpModule():
    rospy.init_node("plot_noise_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "plot_noise_test", "__main__")
