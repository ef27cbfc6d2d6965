"""Tests of move_base's parameters, of localization and of drawn goals, without a master."""

import math
import re

import numpy as np
import pytest
from map_values import CELLS
from shared import cases, refuses

pytest.importorskip("rospy")
# The real move_base has no such module.
read = pytest.importorskip("move_base.node").read

from nav_msgs.msg import MapMetaData, OccupancyGrid  # noqa: E402
from sensor_msgs.msg import LaserScan  # noqa: E402

from bullet_lab.core.parameters import ParameterError  # noqa: E402
from bullet_lab.navigation.occupancy import OccupancyMap, RobotCostmap  # noqa: E402
from bullet_lab.ros.messages.poses import InputError  # noqa: E402
from bullet_lab.ros.node.node import NodeError  # noqa: E402
from bullet_lab.ros.nodes.map_floor import grid_message, read_grid, read_scan  # noqa: E402
from bullet_lab.ros.nodes.send_goals import draw_goal  # noqa: E402


def parameters(given):
    """Return those of move_base by their names."""
    given = {f"~{name}": value for name, value in given.items()}
    return read(lambda name, default: given.get(name, default))


@cases("""
given, name, value:
  # What is set, and the parameter of the drive with its value.
  - [{}, radius, 0.46]
  - [{}, tolerance, 0.1]
  - [{}, map, map]
  - [{TrajectoryPlannerROS/max_vel_x: 0.5}, speed, 0.5]
  - [{DWAPlannerROS/max_vel_x: 0.5}, speed, 0.2]
  - - {base_local_planner: dwa_local_planner/DWAPlannerROS, DWAPlannerROS/max_vel_x: 0.5}
    - speed
    - 0.5
  - - {base_local_planner: dwa_local_planner/DWAPlannerROS, DWAPlannerROS/max_rot_vel: 1.5}
    - turn_speed
    - 1.5
  - [{TrajectoryPlannerROS/acc_lim_theta: 3.2}, turn_acceleration, 3.2]
  - [{TrajectoryPlannerROS/yaw_goal_tolerance: 0.2}, yaw_tolerance, 0.2]
  - [{TrajectoryPlannerROS/yaw_goal_tolerance: 6.28}, heading, false]
  - [{}, heading, true]
  - [{controller_frequency: 3.0}, rate, 5.0]
  - [{global_costmap/robot_radius: 0.18}, radius, 0.18]
  - [{local_costmap/robot_radius: 0.18}, radius, 0.18]
  - [{global_costmap/footprint: [[-0.3, -0.4], [0.1, 0.0], [0.2, 0.2]]}, radius, 0.5]
  - [{local_costmap/footprint: "[[0.3, 0.4], [0, 0.1], [-0.1, 0]]"}, radius, 0.5]
  - [{global_costmap/inflation_layer/inflation_radius: 0.7}, inflation, 0.7]
  - [{global_costmap/inflation_radius: 0.7}, inflation, 0.7]
  - - local_costmap:
        obstacle_layer:
          observation_sources: cloud laser
          cloud: {data_type: PointCloud2, topic: points}
          laser: {data_type: LaserScan, topic: /base_scan}
    - scan
    - /base_scan
""")
def test_parameters_of_move_base_are_those_of_the_drive(given, name, value):
    assert getattr(parameters(given), name) == value


@cases("""
given, line:
  - [{TrajectoryPlannerROS/max_vel_x: -1}, "~TrajectoryPlannerROS/max_vel_x is -1: it must"]
  - [{global_costmap/footprint: round}, "footprint is round: it must be a list of points"]
  - [{global_costmap/footprint: [[0, 0]]}, footprint]
""")
def test_a_value_that_cannot_be_used_is_named_as_move_base_has_it(given, line):
    with refuses(re.escape(line), ParameterError):
        parameters(given)


def test_a_map_is_the_same_as_a_message():
    made = OccupancyMap(CELLS, 0.05, (-1.0, 2.0, 0.0))
    message = grid_message(made, OccupancyGrid().header)
    assert list(message.data) == [0, 100, -1, 0, 0, 100]
    found = read_grid(message)
    np.testing.assert_array_equal(found.cells, made.cells)
    assert (found.resolution, found.origin) == (made.resolution, made.origin)


@cases("width, resolution: [[3, 0.1], [2, 0.0], [2, .nan], [2, .inf]]")
def test_a_map_of_another_size_is_refused(width, resolution):
    info = MapMetaData(width=width, height=2, resolution=resolution)
    info.origin.orientation.w = 1.0
    with refuses("4 values for", InputError):
        read_grid(OccupancyGrid(info=info, data=[0] * 4))


def test_a_scan_has_no_ranges_below_the_least():
    message = LaserScan(range_min=0.1, range_max=5.0, angle_min=-0.1, angle_increment=0.1)
    message.ranges = [0.05, 1.0, math.inf]
    found = read_scan(message)
    np.testing.assert_array_equal(found.ranges, [math.nan, 1.0, math.inf])
    np.testing.assert_allclose(found.angles, [-0.1, 0.0, 0.1])
    message.angle_increment = math.nan
    with refuses("not finite", InputError):
        read_scan(message)


def test_drawn_goals_have_a_way_and_follow_from_the_seed():
    cells = np.zeros((60, 80), dtype=np.int8)
    cells[:, 50] = 100
    costmap = RobotCostmap(OccupancyMap(cells, 0.05), 0.2)
    robot = (0.5, 0.5, 0.0)

    def draw():
        random = np.random.default_rng(7)
        return [draw_goal(costmap, robot, random) for _ in range(20)]

    goals = draw()
    assert goals == draw()
    for x, y, _ in goals:
        assert x < 2.5 - 0.2 and math.dist((x, y), robot[:2]) >= 1.0
    with refuses("no goal on the map", NodeError):
        draw_goal(RobotCostmap(OccupancyMap(cells, 0.01), 0.2), robot, np.random.default_rng(7))
