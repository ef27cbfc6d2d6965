#!/usr/bin/env python3
"""The sensors job leaves what each sensor measured, true to the world."""

import unittest

import numpy as np
import rosbag
from lab_testing import run_job, run_tests
from mcap.reader import make_reader

# Of worlds/sensors.world and urdf/sensor_robot.urdf.
CRATE_WEIGHT, CRATE_FRICTION = 2.0 * 9.8, 0.5


class SensorsJobTest(unittest.TestCase):
    """One run for all tests."""

    @classmethod
    def setUpClass(cls):
        run = run_job("sensors", "record:=true")
        cls.out, cls.summary = run.out, run.summary

    def rows(self, name):
        table = self.out / f"{name}.csv"
        self.assertTrue(table.read_text().startswith("stamp,"))
        return np.loadtxt(table, delimiter=",", skiprows=1)

    def test_every_message_of_every_sensor(self):
        self.assertTrue(self.summary["finished"])
        self.assertEqual(0, self.summary["refused_messages"])
        self.assertTrue((self.out / "sensors.png").is_file())
        for name, period in {"odom": 51, "scan": 100, "range": 50, "imu": 20, "bumper": 50}.items():
            stamps = np.round(1000.0 * self.rows(name)[:, 0])
            self.assertEqual({period}, set(np.diff(stamps)), name)

    def test_the_bumper_feels_the_friction_of_the_crate(self):
        self.assertEqual(["crate"], self.summary["touched"])
        self.assertAlmostEqual(
            CRATE_FRICTION * CRATE_WEIGHT, self.summary["median_push_N"], delta=0.5
        )
        bumper = self.rows("bumper")
        self.assertEqual(0.0, np.abs(bumper[bumper[:, 0] < 15.0, 1:]).max())

    def test_both_bags_have_every_message_at_its_stamp(self):
        with rosbag.Bag(str(self.out / "record.bag")) as bag:
            bagged = [(topic, when.to_nsec()) for topic, _, when in bag.read_messages(raw=True)]
        with (self.out / "record.mcap").open("rb") as file:
            messages = make_reader(file).iter_messages()
            in_mcap = [(channel.topic, it.log_time) for _, channel, it in messages]
        self.assertTrue(sorted(bagged) == sorted(in_mcap))
        for topic, name in {"/odom": "odom", "/scan": "scan", "/imu": "imu"}.items():
            stamps = np.array([when for its, when in bagged if its == topic])
            recorded = self.rows(name)[:, 0]
            np.testing.assert_allclose(1e-9 * stamps[: len(recorded)], recorded, atol=1e-9)
        self.assertEqual({"/clock", "/tf", "/tf_static"} - {topic for topic, _ in bagged}, set())


if __name__ == "__main__":
    run_tests(node=False)
