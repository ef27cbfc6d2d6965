"""Tests of what is drawn under stress, and of what it does to a scenario."""

import math

import numpy as np
import pytest
from shared import cases
from study_runs import summary_of
from test_dock_campaign import assert_same_results, in_order, outcome_of, shuffled

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.docking.types import CalibrationErrors, Learned
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.studies.dock_campaign import study
from bullet_lab.studies.dock_campaign.stress import (
    STRESSES,
    Stress,
    StressedOdometry,
    found_columns,
    robot_under,
    stress_columns,
)
from bullet_lab.studies.dock_campaign.study import DockCampaignSettings, run_each
from bullet_lab.studies.dock_campaign.trial import (
    CAMERA_FRAME,
    DrawSettings,
    dock_of,
    draw_scenario,
    run_trial,
)
from bullet_lab.studies.worlds import ROBOT

FINDER = ResourceFinder.anywhere()


def scenario_of(index, *stress):
    return draw_scenario(DrawSettings(seed=5, stress=stress or ("none",)), index)


@pytest.mark.parametrize("name", STRESSES)
def test_a_stress_changes_nothing_that_another_one_or_the_scenario_draws(name):
    alone, together, plain = (scenario_of(7, *names) for names in ((name,), ("all",), ()))
    drawn = {k: v for k, v in stress_columns(alone.stress).items() if v != getattr(Stress(), k)}
    assert drawn
    assert drawn.items() <= stress_columns(together.stress).items()
    assert alone.start == together.start == plain.start
    assert alone.image_seed == plain.image_seed
    assert alone.stress.seed == together.stress.seed


def test_the_camera_is_where_the_mount_says():
    stress = Stress(mount_x_m=0.01, mount_pitch_deg=2.0)
    robot = read_urdf_file(FINDER.find(ROBOT))
    _, pose = robot_under(stress, robot, CAMERA_FRAME).frames[CAMERA_FRAME]
    assert pose.position == pytest.approx((0.17, 0.0, 0.44))
    assert pose.rpy() == pytest.approx((0.0, math.radians(2.0), 0.0), abs=1e-9)


def test_docking_is_told_what_is_not_so():
    stress = Stress(focal_error=0.02, size_error=-0.03)
    camera = PinholeCamera(640, 480, 502.0, 502.0, 319.5, 239.5)
    assert 1.02 * stress.known_camera(camera).fx == pytest.approx(502.0)
    dock = dock_of(scenario_of(0))
    assert 0.97 * stress.known_dock(dock).marker.size == pytest.approx(dock.marker.size)
    # Nearer by as much as the print is smaller, less what the lens makes larger.
    assert stress.costs(0.4) == pytest.approx((0.4 * (1.0 - 0.97 * 1.02), 0.0, 0.0))


LEARNED = CalibrationErrors(*(Learned(math.radians(1.0), 0.001) for _ in range(7)))


@cases("over, result: [[0.0029, docked], [0.0045, inaccurate]]")
def test_what_the_stress_costs_is_added_to_the_tolerance(over, result):
    def outcome(scenario):
        beside = abs(scenario.stress.mount_y_m) + over
        said = {"error_name": "NONE", "distance_error_m": 0.0, "yaw_error_deg": 0.0}
        return outcome_of(scenario, **said, lateral_error_m=beside, calibration=LEARNED)

    record = run_trial(DrawSettings(seed=5, stress=("mount",)), 0, outcome)
    assert record["lateral_cost_m"] == abs(record["mount_y_m"]) > 0.001
    assert record["result"] == result
    assert record["found_pitch_deg"] == pytest.approx(1.0)


def test_nothing_found_leaves_the_same_columns():
    assert found_columns(None) == dict.fromkeys(found_columns(LEARNED))


def test_odometry_without_stress_is_told_as_it_is():
    odometry = StressedOdometry(Stress(), np.random.default_rng(1))
    for pose in ((0.0, 0.0, 0.0), (0.3, 0.1, 0.2), (0.7, 0.1, 0.1)):
        assert odometry.update(pose) == pose


def test_slips_tell_more_way_than_there_is():
    odometry = StressedOdometry(Stress(slips_per_m=0.5), np.random.default_rng(3))
    told = np.array([odometry.update((way, 0.0, 0.0)) for way in np.arange(0.0, 60.0, 0.01)])
    steps = np.hypot(*np.diff(told[:, :2], axis=0).T)
    # One in 2 m and its own length, 0.125 m on the mean, on which 15 % are added.
    assert np.sum(steps) == pytest.approx(60.0 * (1.0 + 0.15 * 0.125 / 2.125), rel=0.005)
    slipping = np.mean(steps > 0.01 + 1e-9)
    assert slipping == pytest.approx(0.125 / 2.125, abs=0.03)
    assert np.max(np.abs(np.diff(told[:, 2]))) <= 0.1 * 0.01


@pytest.mark.long
def test_each_stress_has_its_campaign_and_a_row_of_one_table(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "STRESSES", {"mount": STRESSES["mount"]})
    settings = DockCampaignSettings(dockings=4, stress=("each",))
    lines = run_each(tmp_path / "a", settings, in_order)
    assert lines[1].startswith(("none: ", "mount: "))
    run_each(tmp_path / "b", settings, shuffled)
    for name in ("none", "mount", "all"):
        assert_same_results(tmp_path / "a" / name, tmp_path / "b" / name)
    table = (tmp_path / "a" / "stresses.csv").read_bytes()
    assert table == (tmp_path / "b" / "stresses.csv").read_bytes()
    summary = summary_of(tmp_path / "a")
    assert list(summary["by_stress"]) == ["none", "mount", "all"]
    # What is there is not run again.
    run_each(tmp_path / "a", settings, lambda *_: pytest.fail("run again"))
