import numpy as np
import pytest
from alike import lines_of_figure
from shared import cases

from bullet_lab.core.parameters import read_parameters
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.odometry_noise import derived_seed
from bullet_lab.reports import Reading
from bullet_lab.reports.squares import (
    FleetReport,
    SquaresReport,
    fleet_figure,
    fleet_summary,
)
from bullet_lab.ros.nodes.drive_squares import robot_names
from bullet_lab.ros.nodes.noisy_odom import NoisyOdomParameters, robots_of

FIGURES = {"final_error_m": 0.3, "final_heading_error_deg": -2.0, "ape_rmse_m": 0.1}


def path(x=0.0, y=0.0):
    places = np.array([(0, 0, 0), (1, 0, 0), (1, -1, 0), (0, -1, 0)], dtype=float)
    return Trajectory(np.arange(4.0), places + (x, y, 0.0))


def test_each_robot_has_noise_of_its_own():
    given = {"~seed": 7, "~std": 0.3}
    # Without a number of robots there is one, in the node's namespace.
    alone = read_parameters(NoisyOdomParameters, given.get)
    assert robots_of(alone) == {"": alone}
    robots = robots_of(read_parameters(NoisyOdomParameters, {**given, "~robots": 2}.get))
    assert list(robots) == ["robot1/", "robot2/"]
    assert [its.seed for its in robots.values()] == [derived_seed(7, 0), derived_seed(7, 1)]
    assert {its.std for its in robots.values()} == {0.3}


def test_summary_has_mean_and_largest_errors(tmp_path):
    robots = [
        {"name": "robot1", **FIGURES},
        {"name": "robot2", **FIGURES, "final_error_m": 0.4, "final_heading_error_deg": 1.0},
    ]
    expected = {
        "final_error_m_rms": pytest.approx(0.125**0.5),
        "final_error_m_largest": 0.4,
        "final_heading_error_deg_largest": 2.0,
        "robots": robots,
    }
    assert expected.items() <= fleet_summary(robots).items()
    # Robots that have not moved have no errors.
    robots[1] = {"name": "robot2", **SquaresReport(tmp_path).measured()}
    assert fleet_summary(robots)["final_error_m_rms"] is None
    assert fleet_summary([])["ape_rmse_m_largest"] is None


@cases("number: [1, 7]")
def test_figures_are_as_before(number, as_before):
    robots = {
        name: (path(2.5 * (k % 5), 2.5 * (k // 5)), path(2.5 * (k % 5) + 0.1))
        for k, name in enumerate(robot_names(number))
    }
    told = lines_of_figure(fleet_figure(robots, "fleet"))
    as_before(told, f"fleet_of_{number}.txt")


def test_figure_of_robots_that_have_sent_nothing_yet():
    figure = fleet_figure({"robot1": (None, None)}, "fleet")
    figure.canvas.draw()
    assert not figure.axes[0].texts


def test_each_robot_has_a_folder_of_its_own(tmp_path):
    report = FleetReport(tmp_path, {"robot1": 11, "robot2": 12})
    for topic in report.topics:
        assert report.newest() is None
        report.take(topic, Reading(50_000_000, (1.0, 2.0, 0.0)))
    assert report.newest() == 50_000_000
    assert len((tmp_path / "robot2" / "paths.csv").read_text().splitlines()) == 2
    summary = report.summary(True, {"real_time_factor": 3.0})
    assert [robot["seed"] for robot in summary["robots"]] == [11, 12]
    assert report.line(summary).startswith("2 robots, 0 sides")
