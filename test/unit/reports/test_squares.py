import itertools
import math

import numpy as np
import pytest
from alike import lines_of, lines_of_figure
from recorded_paths import read_paths_csv
from shared import cases, refuses

from bullet_lab.core import se2
from bullet_lab.core.figures import new_figure, save
from bullet_lab.core.files import FileError
from bullet_lab.core.trajectory import Trajectory, read_tum
from bullet_lab.reports import Reading
from bullet_lab.reports.squares import (
    SquaresReport,
    analyse,
    noise_figure,
    settings_line,
)

TICK = 50_000_000
RNG = np.random.default_rng(3)
POSES = [tuple(pose) for pose in RNG.uniform(-3, 3, (40, 3)).tolist()]


@pytest.fixture
def recording(tmp_path):
    return SquaresReport(tmp_path / "out")


def lines(recording, name):
    return (recording.folder / name).read_text().splitlines()


def fill(recording):
    for index in range(20):
        recording.take("odom", Reading((index + 1) * TICK, POSES[index]))
        if index < 15:
            recording.take("noisy_odom", Reading((index + 1) * TICK, POSES[-index - 1]))


@cases("finish: [false, true]")
def test_what_was_recorded_is_read_back_bit_for_bit(recording, finish):
    fill(recording)
    if finish:
        recording.finish()
    assert read_tum(recording.folder / "odom.tum").poses == pytest.approx(np.array(POSES[:20]))
    assert len(read_tum(recording.folder / "noisy_odom.tum")) == 15
    paths = read_paths_csv(recording.folder / "paths.csv")
    for path, held, poses in zip(paths, recording.pairs(), (POSES, POSES[::-1])):
        assert path.poses.tolist() == held.poses.tolist() == [list(pose) for pose in poses[:15]]
        assert path.stamps.tolist() == held.stamps.tolist()


def test_what_is_left_and_measured_is_as_before(tmp_path, as_before):
    told = []
    for name, until in (("empty", None), ("whole", None), ("cut off", 12 * TICK), ("driven", None)):
        recording = SquaresReport(tmp_path / name)
        if name in ("whole", "cut off"):
            fill(recording)
        for number in range(1, 81) if name == "driven" else ():
            pose = (0.0125 * number, 0.0, 0.0)
            recording.take("odom", Reading(number * TICK, pose))
            noisy = Reading(number * TICK, np.add(pose, (0.3, 0.4, 0.1)))
            recording.take("noisy_odom", noisy)
        recording.finish(until)
        for path in sorted(recording.folder.iterdir()):
            told.append(f"{name}: {len(path.read_text().splitlines())} lines in {path.name}")
        paths = recording.perfect(), *(recording.pairs() or ())
        told += lines_of([path and len(path) for path in paths], f"{name}: poses")
        told += lines_of(recording.measured(), name)
    as_before(told, "recorded.txt")


@cases("about, shown: [[{}, 1], [{as_published: true}, 0]]")
def test_ellipses_are_those_of_the_noise_that_covariances_describe(tmp_path, about, shown):
    report = SquaresReport(tmp_path)
    covariance = ((0.01, 0.0), (0.0, 0.01))
    for k, topic in itertools.product(range(5), ("odom", "noisy_odom")):
        assert report.take(topic, Reading((k + 1) * TICK, POSES[k], covariance))
    report.about = {"std": 0.1, **about}
    figure = report.figures({})["paths.png"]
    assert "\nstd = 0.1" in figure._suptitle.get_text()
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert sum("ellipses" in label for label in labels) == shown


@cases(r"""
about, line:
  - [{}, ""]
  - - {std: 0.1, alpha1: 0.3, alpha4: 0.0, model: probabilistic}
    - "\nalpha1 = 0.3, alpha4 = 0.0, model = probabilistic"
  - - {std: 0.1, alpha1: 0.3, model: probabilistic, as_published: true}
    - "\nstd = 0.1, model = probabilistic, as published"
  - - {std: 0.1, scale_error: 0.0, base_error: -0.02, wheel_base: 0.38}
    - "\nstd = 0.1, base_error = -0.02"
""")
def test_the_title_has_the_settings_that_act(about, line):
    assert settings_line(about) == line


def trajectory(count, shift=0.0):
    stamps = np.arange(1, count + 1) / 20
    poses = np.column_stack([stamps + shift, np.sin(stamps), se2.wrap(3.0 + 0.1 * stamps)])
    return Trajectory(stamps, poses)


def test_the_figure_is_as_before(as_before):
    paths = trajectory(400), trajectory(400, shift=0.3)
    told = lines_of_figure(noise_figure(trajectory(405), paths))
    as_before(told, "squares.txt")


def test_the_same_figure_is_the_same_file(tmp_path):
    for name in ("a.png", "b.png"):
        figure = new_figure(2.0, 1.0)
        figure.subplots().plot([1.0, 3.0], label="a")
        save(figure, tmp_path / name)
    first, second = (path.read_bytes() for path in tmp_path.iterdir())
    assert first == second and first.startswith(b"\x89PNG")
    with refuses("^cannot write ", FileError):
        save(figure, tmp_path / "nix" / "a.png")


SIDE = [(0.0095, 0.0, 0.0)] * 200
TURN = [(0.0, 0.0, -math.radians(1.5))] * 60
LEGS = {
    "side": SIDE,
    "half side": SIDE[:100],
    "slow side": [(0.0005, 0.0, 0.0)] * 20,
    "turn": TURN,
    "half turn": TURN[:30],
    "slow turn": [(0.0, 0.0, -math.radians(0.1))] * 20,
    "rest": [(0.0, 0.0, 0.0)] * 15,
    "both": [(0.004, 0.0, -math.radians(0.7))],
    "stray": [TURN[0], SIDE[0]],
    "stray back": [SIDE[0], TURN[0]],
    "tremble": np.random.default_rng(1).normal(0.0, 1e-6, (60, 3)).tolist(),
    "wobble": [(0.0095, 0.0, sway) for sway in [0.12, -0.12, 0.0, 0.0] * 50],
    "curve": [(0.01, 0.0, 0.01)] * 600,
}


def path(*legs, start=(0.0, 0.0, 0.0)):
    poses = [np.array(start)]
    for step in (step for leg in legs for step in leg):
        poses.append(se2.compose(poses[-1], step))
    return Trajectory(np.arange(len(poses)) / 20, poses)


@cases("""
lap, side, turn:
  - [[side, turn], [1.9, 1.0e-9], [90.0, 1.0e-9]]
  - - [half side, rest, half side, rest, half turn, rest, half turn]
    - [1.9, 1.0e-9]
    - [90.0, 1.0e-9]
  - [[tremble, side, tremble, turn], [1.9, 1.0e-4], [90.0, 1.0e-2]]
  # A slow end belongs to its segment.
  - [[side, slow side, turn, slow turn], [1.91, 1.0e-6], [92.0, 1.0e-4]]
  # Stray messages at a corner do not split.
  - [[side, stray, turn, stray back], [1.9, 0.02], [93.0, 1.6]]
  # A message with both gives its share to both.
  - [[side, both, turn], [1.904, 1.0e-4], [90.7, 1.0e-4]]
  - [[wobble, turn], [1.9, 0.2], [90.0, 7.0]]
""")
def test_a_square(lap, side, turn):
    lap = [LEGS[leg] for leg in lap]
    square = analyse(path(*lap * 4, start=(3.0, -2.0, 2.9)))
    assert square.side_lengths_m == pytest.approx([side[0]] * 4, abs=side[1])
    assert square.turns_deg == pytest.approx([turn[0]] * 4, abs=turn[1])
    # The turning direction does not matter.
    left = [[(dx, dy, -dyaw) for dx, dy, dyaw in leg] for leg in lap]
    other = analyse(path(*left * 4))
    assert other.turns_deg == pytest.approx(square.turns_deg)
    assert other.closure_error_m == pytest.approx(square.closure_error_m, abs=1e-12)


def test_a_turning_message_with_some_drive_gives_its_share_to_the_side():
    turning = [(0.002, 0.0, -math.radians(1.5))]
    square = analyse(path(*[turning, SIDE, turning, TURN] * 4))
    assert square.side_lengths_m == pytest.approx([1.904] * 4, abs=1e-5)
    assert square.turns_deg == pytest.approx([93.0] * 3 + [91.5])


def test_a_path_that_stops_half_way_has_what_it_has():
    square = analyse(path(SIDE, TURN, SIDE[:100]))
    assert square.side_lengths_m == pytest.approx([1.9, 0.95])
    assert square.turns_deg == pytest.approx([90.0])
    assert square.closure_error_m == pytest.approx(math.hypot(1.9, 0.95))
    assert analyse(path(TURN, SIDE)).turns_deg == []


@cases("legs: [[], [rest], [turn], [curve]]")
def test_no_side_gives_empty_lists(legs):
    square = analyse(path(*map(LEGS.get, legs)))
    assert (square.side_lengths_m, square.turns_deg) == ([], [])


@cases("sides, turns: [[3, 2], [1, 0]]")
def test_less_than_a_side_is_none(sides, turns):
    square = analyse(path(SIDE[:sides], TURN[:turns]))
    assert (square.side_lengths_m, square.turns_deg) == ([], [])
