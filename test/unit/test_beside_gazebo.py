"""scripts/beside_gazebo.sh compares as it says, and what agrees with Gazebo goes on to do so."""

import math

import pytest
from beside_direct import DirectStage
from beside_gazebo import DEVIATE, known, main, names, play, rows_of
from beside_scenarios import DRIVES, ROLLS, STOP, Drive, Leg, Played, motions, play_drive
from beside_table import (
    FAILED,
    OK,
    TOLD,
    TRIALS,
    Allowed,
    allowed_by_name,
    allowed_in_drive,
    allowed_of_sensor,
    as_csv,
    compare,
    read_figures,
    table,
    write_figures,
)
from shared import cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import FrameState

LEGS = (Leg(0.2, 0.0, 0.0, 5.0), STOP, Leg(0.0, 0.0, 1.0, 5.0), Leg(0.0, 0.1, 0.0, 1.0))


class Obedient:
    """A robot that moves exactly as commanded, and slides on for 0.1 s."""

    def spawn(self, text, pose):
        self.pose, self.twist = Pose((3.0, -2.0, 0.0)) * pose, (0.0, 0.0, 0.0)

    def clear(self):
        """Nothing is left."""

    def state(self, name):
        return FrameState(self.pose)

    def command(self, name, vx, vy, wz):
        if not (vx or vy or wz):
            self.run(0.1)
        self.twist = vx, vy, wz

    def run(self, seconds):
        vx, vy, wz = (value * seconds for value in self.twist)
        self.pose = self.pose * Pose.from_rpy((vx, vy, 0.0), (0.0, 0.0, wz))


@cases("heading: [0.0, 30.0, -170.0]")
def test_legs_are_told_by_the_heading_before_them(heading):
    drive = Drive("one", "urdf/block_robot.urdf", LEGS, ROLLS)
    played = play_drive(drive, Obedient(), heading)
    told = {
        "leg 0": (1.0, 0.0, 0.0),
        "leg 1": (0.02, 0.0, 0.0),
        "legs 0-1": (1.02, 0.0, 0.0),
        # More than half a turn.
        "leg 2": (0.0, 0.0, math.degrees(5.0)),
        "leg 3": (0.0, 0.1, 0.0),
    }
    for leg, figures in told.items():
        for word, value in zip(("ahead m", "left m", "turned deg"), figures):
            assert played.figures[f"{leg} {word}"] == pytest.approx(value, abs=1e-9), (leg, word)
    assert len(played.path) == 120
    assert played.path[0][:2] == pytest.approx((0.1, 3.0 + 0.02 * math.cos(math.radians(heading))))
    # A leg and the stop after it are one motion.
    assert motions(LEGS) == [(0, 2), (2, 3), (3, 4)]


@cases("""
limit, gazebo, here, found:
  # What is allowed, Gazebo's figure, ours, and the verdict.
  - [{share: 0.02}, 1.0, 1.019, ok]
  - [{share: 0.02}, 1.0, 1.021, FAIL]
  - [{share: 0.02}, -1.0, -0.979, FAIL]
  - [{within: 3.0}, 0.0, -2.9, ok]
  - [{within: 3.0}, 0.0, .nan, FAIL]
  - [{within: 3.0}, 0.0, null, FAIL]
  - [null, 0.0, 9.0, told]
  - [null, null, 9.0, not known]
  - [{}, odom, odom, ok]
  - [{}, odom, map, FAIL]
  - [{}, odom, 1.0, FAIL]
  # Of Gazebo's array, the first numbers are known.
  - [{within: 0.1}, [0.0, 1.0], [0.0, 1.05, 7.0], ok]
  - [{within: 0.1}, [0.0, 1.0], [0.0, 1.2], FAIL]
  - [{within: 0.1}, [0.0, 1.0], [0.0], FAIL]
""")
def test_a_verdict(limit, gazebo, here, found):
    there = {} if gazebo is None else {"a": gazebo}
    allowed = {} if limit is None else {"a": Allowed(**limit)}
    (row,) = compare("one", there, {"a": here}, allowed.get)
    assert row.verdict == found


def test_the_table_shows_what_has_a_limit_and_the_csv_all():
    rows = compare("one", {"a m": 1.0, "b": 2.0}, {"a m": 1.5}, {"a m": Allowed(share=0.1)}.get)
    assert [row.verdict for row in rows] == [FAILED, TOLD]
    lines = table(rows, False).splitlines()
    assert lines[1].split() == ["one", "a", "m", "1.00000", "1.50000", "10", "%", FAILED]
    assert len(lines) == 2
    assert len(table(rows, True).splitlines()) == len(as_csv(rows).splitlines()) == 3


def test_figures_are_read_as_they_were_written(tmp_path):
    figures = {"a m": 0.25, "frame": "odom", "moments": [1.0, 0.5]}
    told = {"one": Played(figures, [(0.1, 1.0, 2.0, 3.0)]), "two": Played({"b": 1.0})}
    write_figures(tmp_path / "figures.json", "here", told)
    assert read_figures(tmp_path / "figures.json") == told


def test_each_limit_is_of_a_figure_that_gazebo_has():
    figures = known()
    assert set(figures) == set(names())
    limits = {name: allowed_by_name(name) for name in names()}
    limits.update(
        {drive.name_at(at): allowed_in_drive(drive) for drive in DRIVES for at in drive.turned}
    )
    for name, limited in limits.items():
        assert limited.keys() <= figures[name].figures.keys()
    assert all(any(name.startswith(start) for name in figures) for start in TRIALS)
    assert sum(allowed_of_sensor(name) is not None for name in figures["sensors"].figures) > 200


def is_played_here(name):
    """Whether this plays a scenario: at all headings, robots that skid are for test/long."""
    skids = name.startswith("four_wheels") and not name.endswith("@45")
    return not (skids or name.startswith(DEVIATE))


def test_what_agrees_with_gazebo_goes_on_to_do_so():
    rows = rows_of(play(is_played_here), known())
    assert [row for row in rows if row.verdict == FAILED] == []
    assert sum(row.verdict == OK for row in rows) > 130


def test_a_figure_that_is_too_far_off_is_an_error(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(DirectStage, "run", lambda self, seconds: None)
    assert main(["--direct", "--only", "fall", "--out", str(tmp_path)]) == 1
    assert "0 ok, 2 FAIL" in capsys.readouterr().out
    assert (tmp_path / "table.csv").read_text().count(FAILED) == 2
