#!/usr/bin/env python3
"""A client of move_base drives through the house that map_server, amcl and move_base know."""

import math
import signal
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import rosnode
import rospkg
import rospy
from actionlib import SimpleActionClient
from actionlib_msgs.msg import GoalStatus
from bullet_lab.msg import TouchedModels
from bullet_lab.srv import SetRtf
from gazebo_msgs.srv import GetModelState
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from lab_testing import PACKAGE, Topic, publisher, run_tests, wait_for
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from nav_msgs.msg import MapMetaData, OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetMap, GetPlan
from std_srvs.srv import Empty

from bullet_lab.navigation.occupancy import read_map
from bullet_lab.ros.messages.poses import stamped_pose

HOUSE = PACKAGE / "worlds" / "house.yaml"


def goal(x, y, yaw=0.0):
    return MoveBaseGoal(stamped_pose(rospy.Time.now(), "map", (x, y, yaw)))


def truth():
    pose = rospy.ServiceProxy("/gazebo/get_model_state", GetModelState)("my_robot", "world").pose
    return pose.position.x, pose.position.y


class NavigationTest(unittest.TestCase):
    """All by the names of the navigation stack."""

    @classmethod
    def setUpClass(cls):
        launch = PACKAGE / "test" / "rostest" / "course_navigation" / "navigation.launch"
        cls.course = subprocess.Popen(["roslaunch", "--wait", str(launch)])
        rospy.init_node("navigation_test")
        rospy.wait_for_service("/bullet_lab/set_rtf")
        rospy.ServiceProxy("/bullet_lab/set_rtf", SetRtf)(3.0)
        cls.client = SimpleActionClient("move_base", MoveBaseAction)
        cls.pose = Topic("amcl_pose", PoseWithCovarianceStamped)
        cls.plan = Topic("move_base/NavfnROS/plan", PathMessage, connected=False)
        cls.touched = Topic("bullet_lab/touched", TouchedModels)
        wait_for(lambda: cls.pose.messages, "amcl_pose")
        cls.client.wait_for_server()

    @classmethod
    def tearDownClass(cls):
        cls.course.send_signal(signal.SIGINT)
        cls.course.wait()

    def test_1_the_map_is_that_of_the_file(self):
        known = read_map(HOUSE)
        grid = rospy.wait_for_message("map", OccupancyGrid)
        self.assertEqual(list(grid.data), known.cells.ravel().tolist())
        self.assertEqual(grid.header.frame_id, "map")
        info = rospy.wait_for_message("map_metadata", MapMetaData)
        self.assertEqual((info.width, info.height), known.cells.shape[::-1])
        self.assertAlmostEqual(info.resolution, 0.05)
        self.assertEqual(rospy.ServiceProxy("static_map", GetMap)().map.info, grid.info)

    def test_2_map_saver_writes_the_same_file(self):
        saver = rospkg.RosPack().get_path("map_server") + "/scripts/map_saver"
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, saver, "-f", f"{folder}/saved"], check=True)
            saved = Path(folder, "saved.pgm").read_bytes()
            self.assertTrue(saved == HOUSE.with_suffix(".pgm").read_bytes())
            self.assertEqual(read_map(Path(folder, "saved.yaml")).origin, read_map(HOUSE).origin)

    def test_4_a_plan_can_be_asked_for(self):
        ask = rospy.ServiceProxy("move_base/make_plan", GetPlan)
        found = ask(PoseStamped(), goal(2.8, 0.6).target_pose, 0.0).plan.poses
        first, last = found[0].pose.position, found[-1].pose.position
        self.assertLess(math.dist((first.x, first.y), truth()), 0.1)
        self.assertLess(math.dist((last.x, last.y), (2.8, 0.6)), 0.01)
        self.assertFalse(ask(PoseStamped(), goal(9.0, 9.0).target_pose, 0.0).plan.poses)

    def test_5_a_goal_in_another_room_is_reached_without_a_contact(self):
        self.client.send_goal(goal(2.8, 0.6, 1.0))
        self.client.wait_for_result()
        text = self.client.get_goal_status_text()
        self.assertEqual(self.client.get_state(), GoalStatus.SUCCEEDED, text)
        # The tolerance of the course's yaml, and the map's cells know it.
        self.assertLess(math.dist(truth(), (2.8, 0.6)), 0.09)
        self.assertTrue(self.plan.messages)
        touched = {name for one in self.touched.messages for name in one.models}
        self.assertLessEqual(touched, {"ground_plane"})

    def test_6_a_goal_in_a_wall_is_aborted_with_a_reason(self):
        rospy.ServiceProxy("move_base/clear_costmaps", Empty)()
        self.client.send_goal(goal(1.5, -1.0))
        self.client.wait_for_result()
        self.assertEqual(self.client.get_state(), GoalStatus.ABORTED)
        self.assertIn("the robot needs 0.25 m", self.client.get_goal_status_text())

    def test_7_a_pose_that_is_given_places_a_map_of_another_origin(self):
        sender = publisher("initialpose", PoseWithCovarianceStamped)

        def place(x, y):
            message = PoseWithCovarianceStamped()
            message.header.frame_id = "map"
            message.pose.pose = stamped_pose(rospy.Time.now(), "map", (x, y, 1.0)).pose
            sender.publish(message)

        def is_at(x, y):
            found = self.pose.position()
            return math.dist((found.x, found.y), (x, y)) < 0.02

        here = truth()
        # Within amcl's reach, the truth counts; beyond, what is given.
        place(here[0] + 3.0, here[1])
        wait_for(lambda: is_at(here[0] + 3.0, here[1]), "the pose that was given")
        rospy.ServiceProxy("global_localization", Empty)()
        wait_for(lambda: is_at(*here), "the truth")
        place(here[0] + 0.3, here[1])
        rospy.sleep(0.5)
        self.assertTrue(is_at(*here))

    def test_8_fake_localization_does_without_amcl(self):
        rosnode.kill_nodes(["/amcl"])
        wait_for(lambda: not self.pose.is_connected(), "the end of amcl")
        self.pose.messages.clear()
        program = rospkg.RosPack().get_path("fake_localization") + "/scripts/fake_localization"
        words = ("_base_frame_id:=base_footprint", "_delta_x:=1.0", "_delta_yaw:=0.5")
        process = subprocess.Popen([sys.executable, program, *words])
        try:
            wait_for(lambda: self.pose.messages, "amcl_pose")
            found, (x, y) = self.pose.position(), truth()
            # The world's origin is at 1, 0 of the map, turned by 0.5.
            there = (1.0 + math.cos(0.5) * x - math.sin(0.5) * y,
                     math.sin(0.5) * x + math.cos(0.5) * y)
            self.assertLess(math.dist((found.x, found.y), there), 0.01)
        finally:
            process.terminate()
            process.wait()


if __name__ == "__main__":
    run_tests(node=False)
