import math

import numpy as np
import pytest

from bullet_lab.core.figures import save
from bullet_lab.core.trajectory import read_tum
from bullet_lab.reports.dock import (
    STATES,
    DockingRunError,
    Keepsakes,
    PathRecording,
    docking_errors,
    docking_figure,
    strip_figure,
)

DOCK = (4.0, 0.0, 0.0)
STEP = 50_000_000


def path_of(folder, count):
    recording = PathRecording(folder / "truth.tum")
    for number in range(1, count + 1):
        recording.add(STEP * number, (0.1 * number, 0.01 * number, 0.0))
    return recording


def test_each_pose_is_in_the_file_at_once(tmp_path):
    recording = path_of(tmp_path / "new", 3)
    found = read_tum(tmp_path / "new" / "truth.tum")
    assert found.stamps.tolist() == [0.05, 0.1, 0.15]
    assert found.poses[2, 1] == 0.01 * 3
    recording.finish(None)


def test_what_came_after_the_end_is_left_out(tmp_path):
    recording = path_of(tmp_path, 10)
    assert recording.last == 10 * STEP
    recording.finish(4 * STEP)
    assert len(read_tum(tmp_path / "truth.tum")) == 4
    assert len(recording.until(4 * STEP)) == 4
    assert recording.until(0) is None


def test_time_does_not_go_back(tmp_path):
    recording = path_of(tmp_path, 2)
    with pytest.raises(DockingRunError):
        recording.add(2 * STEP, (0.0, 0.0, 0.0))
    recording.finish(None)
    assert len(read_tum(tmp_path / "truth.tum")) == 2


@pytest.mark.parametrize(
    ("robot", "distance", "lateral", "yaw"),
    [
        ((3.44, 0.0, 0.0), 0.0, 0.0, 0.0),
        ((3.43, 0.0, 0.0), 0.01, 0.0, 0.0),
        ((3.44, 0.02, 0.0), 0.0, 0.02, 0.0),
        ((3.44, 0.0, 0.1), 0.16 * (1.0 - math.cos(0.1)), 0.0, math.degrees(0.1)),
    ],
)
def test_errors_of_a_docked_robot(robot, distance, lateral, yaw):
    found = docking_errors(robot, DOCK, camera_ahead=0.16, docked_distance=0.4)
    assert found["distance_error_m"] == pytest.approx(distance, abs=1e-12)
    assert found["lateral_error_m"] == pytest.approx(lateral, abs=1e-12)
    assert found["yaw_error_deg"] == pytest.approx(yaw, abs=1e-12)


def test_errors_are_those_seen_from_the_dock_wherever_it_stands():
    dock = (1.0, 2.0, math.pi / 2)
    found = docking_errors((0.98, 1.43, math.pi / 2 + 0.01), dock, 0.16, 0.4)
    assert found["lateral_error_m"] == pytest.approx(0.02)
    assert found["distance_error_m"] == pytest.approx(0.01, abs=1e-4)
    assert found["yaw_error_deg"] == pytest.approx(math.degrees(0.01))


@pytest.mark.parametrize("seen", [0, 1, 3, 8, 9, 31, 32, 33, 500])
def test_keepsakes_are_spread_over_all_and_end_with_the_last(seen):
    keepsakes = Keepsakes(8)
    for number in range(seen):
        keepsakes.add(number)
    chosen = keepsakes.chosen()
    assert len(chosen) == min(seen, 8)
    if seen:
        assert (chosen[0], chosen[-1]) == (0, seen - 1)
    if seen > 8:
        assert max(np.diff(chosen)) <= 2.1 * seen / 7
    assert len(keepsakes._kept) <= 32


def test_the_path_has_a_colour_for_each_state(tmp_path):
    truth = path_of(tmp_path, 40).until(None)
    states = [(0.5, "searching"), (1.0, "staging"), (1.5, "approaching")]
    walls = [((3.0, 0.5), (2.0, 0.5), (2.0, 0.7), (3.0, 0.7))]
    figure = docking_figure(truth, states, [(0.0, 0.0), (3.0, 0.0)], walls, DOCK, "title")
    (axes,) = figure.axes
    drawn = {line.get_label(): line for line in axes.lines}
    assert {"plan", "searching", "staging", "approaching", "marker"} <= set(drawn)
    assert drawn["staging"].get_color() == STATES["staging"]
    assert drawn["staging"].get_xdata()[0] == pytest.approx(2.0)
    # Wall, start and end.
    assert len(axes.patches) == 3
    save(figure, tmp_path / "path.png")


def test_a_docking_that_has_not_begun_is_drawn_too(tmp_path):
    save(docking_figure(None, [], [], [], DOCK, "nothing"), tmp_path / "path.png")


@pytest.mark.parametrize("count", [1, 4, 8])
def test_the_strip_shows_each_picture(tmp_path, count):
    picture = np.full((24, 32, 3), 100, dtype=np.uint8)
    figure = strip_figure([(1.5 * number, "searching", picture) for number in range(count)])
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[0] == "0.0 s, searching"
    assert len(titles) == count
    save(figure, tmp_path / "camera.png")
