"""Tests of the costmap and of the drive on a map, in the engine too."""

import math

import numpy as np
import pytest
from map_values import value_at
from numpy.testing import assert_allclose, assert_array_equal
from shared import PACKAGE, cases

from bullet_lab.core.pose import Pose
from bullet_lab.drive import STANDSTILL, DrivePhase
from bullet_lab.navigation import occupancy
from bullet_lab.navigation.driver import MapDriver
from bullet_lab.navigation.occupancy import OccupancyMap, RobotCostmap, read_map
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_spawned
from bullet_lab.studies.map import MapSettings, map_world

CELL = 0.05


def floor(*walls, unknown=()):
    """A map of 4 x 3 m of free floor from 0, 0, but for boxes x0, y0, x1, y1 (m)."""
    cells = np.zeros((60, 80), dtype=np.int8)
    for value, boxes in ((100, walls), (-1, unknown)):
        for box in boxes:
            x0, y0, x1, y1 = np.rint(np.divide(box, CELL)).astype(int)
            cells[y0:y1, x0:x1] = value
    return OccupancyMap(cells, CELL)


def length(way):
    return sum(math.dist(a[:2], b[:2]) for a, b in zip(way, way[1:]))


# A wall across the floor, with a door of 0.8 m.
WALL, DOOR = (2.0, 0.0, 2.1, 1.5), (2.0, 2.3, 2.1, 3.0)
ACROSS = (2.0, 0.0, 2.1, 3.0)
START = (1.0, 1.0, 0.0)


def test_on_free_floor_the_plan_is_straight():
    # Up to the map's edge.
    for goal in (3.5, 2.0), (3.99, 2.99):
        assert RobotCostmap(floor(), 0.2).plan((0.5, 0.5), goal) == [(0.5, 0.5), goal]
    # A robot too near to a wall drives away from it.
    way = RobotCostmap(floor(ACROSS), 0.3).plan((1.8, 1.5), (0.5, 1.5))
    assert max(x for x, _ in way) <= 1.8


@cases("radius: [0.1, 0.2, 0.3]")
def test_the_plan_goes_through_a_door_at_a_distance(radius):
    costmap = RobotCostmap(floor(WALL, DOOR), radius)
    way = costmap.plan((0.6, 0.6), (3.4, 0.6))
    points, _ = occupancy.points_of(way, 0.01)
    assert costmap.clearance(points).min() >= radius
    # It is about the shortest through the middle of the door.
    shortest = 2.0 * math.hypot(1.45, 1.3)
    assert shortest <= length(way) <= 1.05 * shortest


@cases("""
goal, radius, why:
  - [[3.4, 0.6], 0.45, wide enough for a radius of 0.45 m]
  - [[1.9, 0.6], 0.2, from something; the robot needs 0.24]
  - [[9.0, 0.6], 0.2, off the map]
""")
def test_without_a_way_there_is_a_reason(goal, radius, why):
    costmap = RobotCostmap(floor(WALL, DOOR), radius)
    assert costmap.plan((0.6, 0.6), goal) is None
    assert why in costmap.why_not(goal)


def test_unknown_floor_is_dear_or_closed():
    known = floor(unknown=[(1.5, 0.0, 2.5, 2.0)])
    assert RobotCostmap(known, 0.2, allow_unknown=True).plan((1.0, 0.2), (3.0, 0.2)) is not None
    closed = RobotCostmap(known, 0.2, allow_unknown=False)
    assert max(y for _, y in closed.plan((1.0, 1.0), (3.0, 1.0))) > 2.0
    assert closed.plan((1.0, 1.0), (2.0, 1.0)) is None
    assert "over known floor to (2.00, 1.00) m" in closed.why_not((2.0, 1.0))


def test_costs_fall_with_the_distance_as_costmap_2d_publishes_them():
    values = RobotCostmap(floor((2.0, 0.0, 2.05, 3.0)), 0.2, 0.5).values().cells[30]
    assert values[40] == 100
    assert (values[41:45] == 99).all()
    assert (np.diff(values[45:51].astype(int)) < 0).all()
    assert (values[51:] == 0).all()


def test_a_large_map_is_planned_on_with_larger_cells(monkeypatch):
    monkeypatch.setattr(occupancy, "MOST_CELLS", 1000)
    costmap = RobotCostmap(floor(WALL, DOOR), 0.1)
    assert costmap.map.cells.size <= 1000
    assert costmap.plan((0.6, 0.6), (3.4, 0.6)) is not None
    assert value_at(costmap.map, 2.05, 0.5) == 100


def scan(costmap, x, y, *distances, yaw=0.0):
    """A laser at a place sees one ray at 0 and one on each side of it."""
    laser = Pose.from_rpy((x, y, 0.1), (0.0, 0.0, yaw))
    costmap.see(laser, np.array([-0.05, 0.0, 0.05]), np.array(distances), 5.0)


def test_the_laser_marks_what_the_map_does_not_show_and_clears_it():
    costmap = RobotCostmap(floor((3.0, 0.0, 3.1, 3.0)), 0.2)

    def is_free():
        return costmap.is_free([(2.5, 1.5)], (1.0, 1.5))

    # The wall of the map, with noise, is not marked.
    before = costmap.values().cells
    scan(costmap, 1.0, 1.5, 1.99, 2.0, 2.03)
    assert_array_equal(costmap.values().cells, before)
    scan(costmap, 1.0, 1.5, 0.8, 0.8, 0.8)
    assert not is_free()
    assert costmap.clearance(np.array([[1.81, 1.5]]))[0] < CELL
    # Not a number and less than 0 tell nothing.
    scan(costmap, 1.0, 1.5, math.nan, -1.0, 0.0)
    assert not is_free()
    scan(costmap, 1.0, 1.5, *[math.inf] * 3)
    assert is_free()
    # Turned, it sees along y.
    scan(costmap, 1.0, 1.0, 1.0, 1.0, 1.0, yaw=math.pi / 2)
    assert costmap.clearance(np.array([[1.0, 2.01]]))[0] < CELL


def tick(driver, seconds):
    """Return the last command after a time at the start."""
    return [driver.command(START, 0.1) for _ in range(round(seconds / 0.1))][-1]


def test_without_a_way_it_waits_forgets_what_it_saw_and_gives_up():
    driver = MapDriver((3.0, 1.0, 0.0), RobotCostmap(floor(ACROSS), 0.2), wait=5.0)
    assert tick(driver, 4.0) == STANDSTILL and not driver.failure
    tick(driver, 3.0)
    assert "no way to (3.00, 1.00) m" in driver.failure
    # What only the laser has seen is forgotten after half of the time.
    seen = RobotCostmap(floor(), 0.2)
    seen.mark(np.column_stack([np.full(60, 2.0), np.linspace(0.01, 2.99, 60)]))
    driver = MapDriver((3.0, 1.0, 0.0), seen, wait=5.0)
    tick(driver, 7.0)
    assert driver.plans and not driver.failure


def test_a_robot_that_is_held_drives_back_and_gives_up():
    driver = MapDriver((3.0, 1.0, 0.0), RobotCostmap(floor(), 0.2))
    assert tick(driver, 4.0)[0] > 0.0
    # It drives back three times, for 2 s each.
    assert [tick(driver, 1.0)[0] < 0.0 for _ in range(21)].count(True) == 6
    assert "stuck at (1.00, 1.00) m" in driver.failure


def test_a_robot_that_is_pushed_aside_at_the_end_plans_anew():
    driver = MapDriver((2.0, 1.0, 0.0), RobotCostmap(floor(), 0.2))
    # Then beside the goal, as far along the line as it goes.
    for pose in (START, (2.0, 1.4, 0.0), (2.0, 1.4, 0.0)):
        _, turn = driver.command(pose, 0.1)
    assert driver.plans == 2 and turn < 0.0


BOX = """<sdf version="1.6"><model name="thing"><static>1</static><pose>{} {} 0.2 0 0 0</pose>
<link name="link"><collision name="box"><geometry><box><size>0.4 0.4 0.4</size></box></geometry>
</collision></link></model></sdf>"""


def drive(simulation, robot, goal, costmap):
    """Drive to a goal; return the driver, the path (n, 3) and the models that were touched."""
    driver, path, touched = MapDriver(goal, costmap), [robot.pose().planar], set()
    end = simulation.seconds + 300.0
    while driver.phase is not DrivePhase.ARRIVED and not driver.failure:
        assert simulation.seconds < end, "neither arrived nor given up"
        v, w = driver.command(path[-1], 0.05)
        robot.command("cmd_vel", PlanarCommand(vx=v, wz=w))
        for _ in range(10):
            simulation.run_for(0.005)
            touched |= simulation.contacts(robot.name) - {"ground_plane"}
        path.append(robot.pose().planar)
    return driver, path, touched


@pytest.mark.long
def test_it_drives_through_the_house_around_what_the_map_does_not_show():
    costmap = RobotCostmap(map_world(MapSettings()), 0.22)
    with Simulation.of("package://bullet_lab/worlds/house.world") as simulation:
        robot = simulation.spawn("package://bullet_lab/urdf/sensor_robot.urdf")

        def see(scan):
            angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
            laser = robot.pose() * Pose((0.0, 0.0, 0.125))
            costmap.see(laser, angles, scan.ranges, scan.range_max)

        robot.listen("scan", see)
        # Where boxes stand in the way to two goals.
        for goal, box in (
            ((2.8, 0.5, 1.0), (1.5, 0.25)), ((4.0, -0.9, 0.0), None), ((0.4, 2.0, 3.0), (1.9, 0.4)),
        ):
            shortest = length(costmap.plan(robot.pose().planar, goal))
            if box:
                simulation.add(read_spawned(BOX.format(*box), "test"))
            driver, path, touched = drive(simulation, robot, goal, costmap)
            assert not driver.failure and not touched
            assert driver.distance(path[-1]) <= 0.05
            assert (driver.plans > 1) == bool(box)
            share = length(path) / shortest
            assert share > 1.05 if box else share < 1.02
            if box:
                simulation.remove("thing")


def test_the_map_beside_the_house_is_that_of_the_house():
    found, made = read_map(PACKAGE / "worlds" / "house.yaml"), map_world(MapSettings())
    assert_array_equal(found.cells, made.cells)
    assert_allclose(found.origin, made.origin)
