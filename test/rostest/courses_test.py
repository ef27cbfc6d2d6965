#!/usr/bin/env python3
"""Launch files of courses come up here, or one line says what is missing."""

import os
import re
import unittest
from concurrent.futures import ThreadPoolExecutor

import rosgraph
import yaml
from lab_testing import PACKAGE, Master, Process, run_tests, wait_for

from bullet_lab.ros.record.robot_parts import COLOURS, failures_in, reason_in

COURSES = PACKAGE / "test" / "courses"
SPAWNED = "Successfully spawned entity"
# The topics that come, and how many models are spawned.
UP = yaml.safe_load("""
blank_before: [[], 1]
database: [[], 3]
inorder: [&cart [/cmd_vel, /odom, /scan], 1]
legacy_mode: [*cart, 1]
mapping: [*cart, 1]
navigation: [[/cmd_vel, /odom, /scan, /map, /amcl_pose, /move_base/goal], 1]
own_server: [*cart, 1]
paused: [*cart, 1]
ros_control: [[/mobile_base_controller/odom, /joint_states, /scan], 1]
shapes: [*cart, 1]
static_tf: [*cart, 1]
tools: [*cart, 1]
two_robots: [[/robot1/cmd_vel, /robot2/odom], 2]
xacro_py: [*cart, 1]
""")
# What must stand in the output of each, beside that.
SAID = {
    "database": r"'model://house_1': in none of the model folders .*osrf/gazebo_models",
    "legacy_mode": r"<legacyMode> is ignored, as in ROS Noetic",
}
# Launch files that end, with the line that explains it.
ENDS = {
    "gazebo_worlds": r"Resource not found: gazebo_worlds",
    "old_tags": r"since ROS Noetic, <macro> is <xacro:macro>, <property> is <xacro:property>",
}
# Packages whose nodes cannot start; others may, where they are installed.
MISSING = {"mapping": ("gmapping",)}
NONE = "{0}/slam_{0}: there is no ROS package '{0}'; Debian has none that is known"
MAY_MISS = {"static_tf": r"tf2?_ros|tf/", "tools": r"teleop|rqt_robot_steering|_gui/"}


class Launched(Process):
    """A launch file, with a master of its own."""

    def __init__(self, name):
        self._master = Master()
        paths = f"{COURSES}{os.pathsep}{os.environ.get('ROS_PACKAGE_PATH', '')}"
        environment = {"ROS_PACKAGE_PATH": paths, "ROS_MASTER_URI": self._master.uri}
        super().__init__("roslaunch", "courses", f"{name}.launch", **environment)

    def topics(self):
        """Names of the topics that its nodes publish or subscribe to."""
        master = rosgraph.Master("/courses_test", self._master.uri)
        published, subscribed, _ = master.getSystemState()
        return {topic for topic, _ in (*published, *subscribed)}

    def end(self):
        super().end()
        self._master.end()


def run(name):
    """Run a launch file until all of it has come; return whether it has ended, and what it said."""
    topics, spawned = UP.get(name, ((), 0))
    launched = Launched(name)
    missing = set(topics)
    try:
        wait_for(
            lambda: not launched.runs() or launched.said.count(SPAWNED) >= spawned > 0,
            lambda: f"{name} to spawn: {launched.said}",
        )
        if launched.runs():
            wait_for(lambda: missing <= launched.topics(), f"{name}: {sorted(missing)}")
        return not launched.runs(), COLOURS.sub("", launched.said)
    finally:
        launched.end()


class CoursesTest(unittest.TestCase):
    """Each launch file by its name."""

    results = None

    def setUp(self):
        cls = type(self)
        if cls.results is None:
            names = [path.stem for path in (COURSES / "launch").iterdir()]
            with ThreadPoolExecutor(3) as pool:
                cls.results = dict(zip(names, pool.map(run, names)))

    # Without subTest, whose failures rosunit does not name.

    def test_each_comes_up(self):
        self.assertEqual({*UP, *ENDS}, {*self.results})
        for name in UP:
            has_ended, said = self.results[name]
            self.assertFalse(has_ended, f"{name}: {said}")
            self.assertNotIn("Traceback", said, name)
            self.assertRegex(said, SAID.get(name, SPAWNED), name)

    def test_nodes_that_cannot_start_are_named_with_their_package(self):
        for name in UP:
            found = failures_in(self.results[name][1])
            others = [f for f in found if not re.search(MAY_MISS.get(name, "$^"), f)]
            missing = {NONE.format(package) for package in MISSING.get(name, ())}
            self.assertEqual(missing, {*others}, name)

    def test_what_cannot_come_up_says_why_in_one_line(self):
        for name, line in ENDS.items():
            has_ended, said = self.results[name]
            self.assertTrue(has_ended, name)
            self.assertRegex(reason_in(said), line)


if __name__ == "__main__":
    run_tests(node=False)
