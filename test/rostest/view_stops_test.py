#!/usr/bin/env python3
"""However the driver of a robot is lost, it soon stands."""

import signal
import time
from pathlib import Path

import rospkg
from geometry_msgs.msg import Twist
from lab_testing import PACKAGE, Node, NodeTest, Topic, run_tests, wait_for
from nav_msgs.msg import Odometry
from view_looker import Link, Looker, wait_for_url

SPEED = 0.4
# s from the last key to the robot at rest: 0.6 on an idle machine, and at a load of 13.
LATEST = 1.5
BURST = 6.0


class ViewStopsTest(NodeTest):
    @classmethod
    def setUpClass(cls):
        world = "package://bullet_lab/worlds/empty.world"
        robot = PACKAGE / "urdf" / "block_robot.urdf"
        cls.bridge = Node("pybullet_bridge.py", world=world, robot=robot)
        cls.odom = Topic("odom", Odometry)

    @classmethod
    def tearDownClass(cls):
        cls.bridge.end()

    def setUp(self):
        self.view = self.node("view.py", port=18100, speed=SPEED)
        self.url = wait_for_url(lambda: self.view.out)
        self.looker = self.closed(Looker(self.url))
        wait_for(self.is_offered, "the robot on the page")

    def closed(self, thing):
        """Have a thing closed at the end of the test."""
        self.addCleanup(thing.close)
        return thing

    def is_offered(self):
        controls = list(self.looker.controls.values())
        return any(c.get("label") == "Robot" and c.get("value") == "/cmd_vel" for c in controls)

    def place(self):
        position = self.odom.position()
        return position.x, position.y

    def speed(self):
        return self.odom.messages[-1].twist.twist.linear.x

    def drive(self, driver, seconds=1.0):
        """Hold the key until the robot drives, and so much longer."""

        def drives():
            driver.send("1 0")
            time.sleep(0.1)
            return self.speed() > 0.9 * SPEED

        wait_for(drives, "the robot to drive")
        self.hold(driver, seconds)
        driver.send("1 0")

    @staticmethod
    def hold(driver, seconds=BURST):
        """Hold the key."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            driver.send("1 0")
            time.sleep(0.1)

    def check_stop(self, before):
        """Check that it stands, no farther from there than it drives in the time allowed."""
        wait_for(lambda: abs(self.speed()) < 1e-3, "the robot to stand")
        self.assertLess(abs(self.place()[0] - before[0]), LATEST * SPEED)

    def test_the_url_is_in_no_log(self):
        token = self.url.rstrip("/").rsplit("/", 1)[1]
        logs = list(Path(rospkg.get_log_dir()).rglob("*.log*"))
        self.assertTrue([path for path in logs if "view" in path.name], logs)
        self.assertFalse([path for path in logs if token in path.read_text(errors="replace")])

    def test_a_silent_link(self):
        with self.looker.driver() as driver:
            self.drive(driver)
            self.check_stop(self.place())

    def test_a_view_that_is_killed(self):
        self.lose_view(signal.SIGKILL)

    def test_a_view_that_hangs(self):
        self.lose_view(signal.SIGSTOP)

    def lose_view(self, how):
        with self.looker.driver() as driver:
            self.drive(driver)
            before = self.place()
            self.view.signal(how)
            self.check_stop(before)
            if how == signal.SIGSTOP:
                self.view.signal(signal.SIGCONT)

    def test_a_slow_link(self):
        link = self.closed(Link(self.url, 2.0))
        there = self.closed(Looker(link.url))
        before = self.place()
        with there.driver() as driver:
            self.hold(driver)
            wait_for(lambda: driver.listen()["late"], "the page to say so")
            self.check_stop(before)

    def test_a_stalled_link(self):
        link = self.closed(Link(self.url))
        there = self.closed(Looker(link.url))
        wait_for(lambda: there.controls, "the page")
        with there.driver() as driver:
            self.drive(driver)
            before = self.place()
            link.stalled.set()
            self.hold(driver)
            self.check_stop(before)
            driver.socket.send(f"{driver.told['time']} 0 0")
            link.stalled.clear()
            # The server has read all that was on its way once it tells a time that is newer.
            newest = driver.told["time"]
            wait_for(lambda: driver.listen()["time"] > newest + BURST, "the link")
            self.check_stop(before)

    def test_a_slider_that_says_nan_or_too_much(self):
        commands = self.topic("cmd_vel", Twist, False)
        for value in (float("nan"), 1e9, -5.0):
            self.looker.press("m/s", value)
        self.looker.press("Robot", "/elsewhere")
        with self.looker.driver() as driver:

            def drives():
                driver.send("1 0")
                return commands.messages and commands.messages[-1].linear.x

            # Where a menu says what it does not offer, nothing is driven.
            self.looker.press("Robot", "/cmd_vel")
            wait_for(drives, "the robot to be driven")
        wait_for(lambda: commands.messages[-1] == Twist(), "the robot to be stopped")
        self.assertTrue(all(0.0 <= m.linear.x <= 2.0 for m in commands.messages))


if __name__ == "__main__":
    run_tests()
