"""A robot in a simulated world that drives on a map by MapDriver, without ROS."""

import numpy as np

from bullet_lab.core.pose import Pose
from bullet_lab.drive import DrivePhase, GoalLimits
from bullet_lab.navigation.driver import MapDriver
from bullet_lab.simulation.plugins.samples import PlanarCommand

ROBOT = "package://bullet_lab/urdf/sensor_robot.urdf"
RADIUS = 0.22
# Of the laser in the robot.
MOUNT = Pose((0.0, 0.0, 0.125))
TICK = 0.05


def pose_of(robot):
    pose = robot.pose()
    return (*pose.position[:2], pose.yaw)


def spawn(simulation, costmap):
    """Add the robot, whose laser's scans go to the costmap."""
    robot = simulation.spawn(ROBOT)

    def see(scan):
        angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
        costmap.see(robot.pose() * MOUNT, angles, scan.ranges, scan.range_max)

    robot.listen("scan", see)
    return robot


def drive(simulation, robot, goal, costmap, wait=15.0, patience=300.0):
    """Drive to a goal; return the driver, the path (n, 3) and the models that were touched."""
    driver, path, touched = MapDriver(goal, costmap, GoalLimits(), wait), [], set()
    end = simulation.seconds + patience
    while driver.phase is not DrivePhase.ARRIVED and not driver.failure:
        assert simulation.seconds < end, "neither arrived nor given up"
        path.append(pose_of(robot))
        v, w = driver.command(path[-1], TICK)
        robot.command("cmd_vel", PlanarCommand(vx=v, wz=w))
        for _ in range(10):
            simulation.run_for(0.1 * TICK)
            touched |= simulation.contacts(robot.name) - {"ground_plane"}
    return driver, np.array(path), touched
