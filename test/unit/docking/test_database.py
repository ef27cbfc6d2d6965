"""Tests of the dock database, of its one-line errors, and of the verdict on a docking."""

import math
from pathlib import Path

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from shared import cases

from bullet_lab.core.parameters import declarations
from bullet_lab.docking.database import (
    ERRORS,
    Dock,
    DockMarker,
    DockTolerance,
    DockUncertainty,
    DockWalls,
    docking_errors,
    drawn_error,
    find_dock,
    judge,
    parse_docks,
    read_docks,
)
from bullet_lab.docking.types import DockingError, DockingSettings
from bullet_lab.errors import LabError

SHIPPED = Path(__file__).parents[3] / "config" / "docks.yaml"
GOOD = """
docks:
  home:
    frame: map
    pose: [1.0, -2.0, 90]
    marker: {dictionary: DICT_4X4_50, id: 3, size: 0.1, height: 0.4}
    walls: {opening: 1.0, depth: 2.0, thickness: 0.2}
    staging_distance: 3.0
    docked_distance: 0.4
    tolerance: {distance: 0.005, lateral: 0.005, yaw_deg: 0.5}
    uncertainty: {position: 0, yaw_deg: 180}
"""


KINDS = DockMarker, DockWalls, DockTolerance, DockUncertainty, Dock, DockingSettings


def test_what_is_read_and_its_limits_are_as_before():
    found = [*lines_of(parse_docks(GOOD), "good"), *lines_of(read_docks(SHIPPED), "shipped")]
    for kind in KINDS:
        said = {name: (one.doc, one.allowed) for name, one in declarations(kind).items()}
        found += lines_of(said, kind.__name__)
    # The errors of a pose, uniform within its uncertainty and the seed's own.
    drawn = [drawn_error(DockUncertainty(0.3, 0.2), 0.5, seed) for seed in range(9)]
    found += lines_of(np.array(drawn), "drawn")
    assert_as_before(found, Path(__file__).with_name("docks.txt"))


@cases(r"""
old, new, said:
  - ["size: 0.1", "size: -0.1", "docks: home: marker: size is -0.1"]
  - ["id: 3", "id: 3.5", "docks: home: marker: id is 3.5"]
  - ["id: 3, ", "", "docks: home: marker: id is missing"]
  - ["pose: [1.0, -2.0, 90]", "pose: [1.0, -2.0]", "docks: home: pose is [1.0, -2.0]"]
  - ["pose: [1.0, -2.0, 90]", "pose: [true, -2.0, 90]", "docks: home: pose is [True, -2.0, 90]"]
  - ["pose: [1.0, -2.0, 90]", "pose: [1.0, .inf, 90]", "docks: home: pose is [1.0, inf, 90]"]
  - ["frame: map", "frame: ''", "docks: home: frame is ''"]
  - ["height: 0.4", "height: 0.4, hieght: 1", "docks: home: marker: unknown key hieght"]
  - ["staging_distance: 3.0", "staging_distance: 2.0", "staging_distance is 2.0, not outside"]
  - ["docked_distance: 0.4", "docked_distance: 3.0", not beyond docked_distance]
  - ["docks:", "doks:", docks is missing]
  - ["marker: {", "marker: [", no YAML]
  # In place of all of it.
  - [null, "docks: {}", docks is no mapping from names]
  - [null, "docks: [1]", docks is no mapping from names]
  - [null, "3", not a mapping]
  - [null, "docks:\n  1: {}\n  a: {}", docks is no mapping from names]
""")
def test_says_what_is_wrong(old, new, said):
    with pytest.raises(LabError) as error:
        parse_docks(GOOD.replace(old or GOOD, new), "docks.yaml")
    assert said in str(error.value)
    assert str(error.value).startswith("docks.yaml")
    assert "\n" not in str(error.value)


def test_names_a_missing_file_and_the_known_docks(tmp_path):
    with pytest.raises(LabError, match=r"nothing\.yaml"):
        read_docks(tmp_path / "nothing.yaml")
    with pytest.raises(LabError, match="no dock 'harbour'; known are home"):
        find_dock(parse_docks(GOOD), "harbour")


@cases("""
said, errors, contacts, result:
  - [NONE, [0.0049, -0.0029, 0.39], 0, docked]
  - [NONE, [-0.0051, 0.0, 0.0], 0, inaccurate]
  - [NONE, [0.0, 0.0031, 0.0], 0, inaccurate]
  - [NONE, [0.0, 0.0, -0.41], 0, inaccurate]
  - [NONE, [.nan, 0.0, 0.0], 0, inaccurate]
  - [TIMED_OUT, [0.0, 0.0, 0.0], 1, wall_contact]
  - [TIMED_OUT, [0.0, 0.0, 0.0], 0, timed_out]
""")
def test_docked_is_who_says_so_stands_within_tolerance_and_touched_nothing(
    said, errors, contacts, result
):
    tolerance = DockTolerance(0.005, 0.003, math.radians(0.4))
    found = judge(DockingError[said], dict(zip(ERRORS, errors)), tolerance, contacts)
    assert found == result


@cases("""
dock, robot, errors, most:
  - [[4.0, 0.0, 0.0], [3.43, 0.02, 0.0], [0.01, 0.02, 0.0], 1.0e-12]
  # 0.16 (1 - cos 0.1).
  - [[4.0, 0.0, 0.0], [3.44, 0.0, 0.1], [0.00079933355548742, 0.0, 0.1], 1.0e-12]
  # A quarter turn.
  - - [1.0, 2.0, 1.5707963267948966]
    - [0.98, 1.43, 1.5807963267948966]
    - [0.01, 0.02, 0.01]
    - 1.0e-4
""")
def test_errors_of_a_docked_robot_are_those_seen_from_the_dock(dock, robot, errors, most):
    found = docking_errors(robot, dock, camera_ahead=0.16, docked_distance=0.4)
    expected = (*errors[:2], math.degrees(errors[2]))
    assert [found[name] for name in ERRORS] == pytest.approx(expected, abs=most)


def test_the_error_of_a_pose_is_uniform_within_its_uncertainty_and_the_seeds_own():
    uncertainty = DockUncertainty(0.3, math.radians(10.0))
    drawn = np.array([drawn_error(uncertainty, 0.5, seed) for seed in range(400)])
    most = np.array([0.15, 0.15, math.radians(5.0)])
    assert (np.abs(drawn) <= most).all()
    # 1 - 0.98 ** 400 is 1 - 3e-4.
    assert (np.abs(drawn).max(axis=0) > 0.98 * most).all()
    # Three standard errors of the mean of 400.
    assert (np.abs(drawn.mean(axis=0)) < 3.0 * most / math.sqrt(3.0 * 400)).all()
    assert drawn_error(uncertainty, 0.0, 1) == (0.0, 0.0, 0.0)
    noise = np.random.default_rng(1).uniform(-1.0, 1.0, 3)
    assert not np.isclose(drawn[1] / most, noise, atol=0.01).any()
