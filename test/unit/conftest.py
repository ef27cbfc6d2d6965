import csv
import signal

import numpy as np
import pytest
from alike import assert_as_before
from shared import BLOCK_ROBOT, EMPTY_WORLD, PACKAGE

from bullet_lab.drive import Square, open_loop_side
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation


@pytest.fixture(autouse=True)
def _answered_signals():
    # A study that ended in an earlier test ignores them, as does what a script started in its
    # background; processes inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


@pytest.fixture
def as_before(request):
    """A function that compares lines with those in a file beside the test."""
    return lambda lines, name, **more: assert_as_before(lines, request.path.with_name(name), **more)


@pytest.fixture(scope="session")
def package():
    return PACKAGE


@pytest.fixture
def world():
    with Simulation.of(EMPTY_WORLD) as simulation:
        yield simulation


@pytest.fixture
def robot(world):
    return world.spawn(BLOCK_ROBOT)


@pytest.fixture(scope="session")
def published_run():
    """Odometry samples and corner points of the square, driven as in listing 9."""
    samples = []
    square = Square()
    with Simulation.of(EMPTY_WORLD) as simulation:
        robot = simulation.spawn(BLOCK_ROBOT)
        robot.listen("odom", samples.append)
        corners = [robot.pose().position[:2]]
        for _ in range(square.sides):
            driving = True
            for ahead, turn in open_loop_side(square):
                if driving and turn:
                    corners.append(robot.pose().position[:2])
                driving = not turn
                robot.command("cmd_vel", PlanarCommand(vx=ahead, wz=turn))
                simulation.run_for(0.1)
    return samples, np.array(corners)


@pytest.fixture(scope="session")
def figure_corners():
    """Start and the four corners of the perfect path in figure 1a, m, shape (5, 2)."""
    with (PACKAGE / "data" / "fig1_paths.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["series"] == "fig1a_perfect"]
    points = np.array([(float(row["x_m"]), float(row["y_m"])) for row in rows])
    return points[[0, 1, 4, 7, 10]]
