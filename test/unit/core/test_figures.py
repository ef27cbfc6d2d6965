import numpy as np
import pytest

from bullet_lab.core.figures import save
from bullet_lab.core.files import FileError
from bullet_lab.core.se2 import wrap
from bullet_lab.core.trajectory import Trajectory
from bullet_lab.reports.squares import noise_figure


def trajectory(count, shift=0.0):
    stamps = np.arange(1, count + 1) / 20
    poses = np.column_stack([stamps + shift, np.sin(stamps), wrap(3.0 + 0.1 * stamps)])
    return Trajectory(stamps, poses)


def drawn(figure):
    """Return the number of points of each curve that has any, per axes."""
    return [
        [len(line.get_xdata()) for line in axes.lines if len(line.get_xdata())]
        for axes in figure.axes
    ]


def saved(figure, path):
    save(figure, path)
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG")
    return data


def test_a_perfect_path_alone(tmp_path):
    figure = noise_figure(trajectory(30), None, title="only one")
    paths, *coordinates, error = drawn(figure)
    assert paths == [30, 1, 1]
    assert coordinates == [[30], [30], [30]]
    assert error == []
    saved(figure, tmp_path / "a.png")


@pytest.mark.parametrize("count", [1, 400])
def test_both_paths_their_ends_and_their_error(tmp_path, count):
    pairs = trajectory(count), trajectory(count, shift=0.3)
    figure = noise_figure(trajectory(count + 5), pairs)
    paths, *coordinates, error = drawn(figure)
    assert sorted(paths) == sorted([count + 5, count, 1, 1, 1])
    assert coordinates == [[count, count + 5]] * 3
    assert error == [count]
    axes = figure.axes[0]
    assert axes.get_aspect() == 1.0
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["Noisy odom", "Perfect odom", "start", "ends"]
    assert figure.axes[-1].lines[0].get_ydata() == pytest.approx([0.3] * count)
    saved(figure, tmp_path / "a.png")


def test_the_same_figure_is_the_same_file(tmp_path):
    pairs = trajectory(30), trajectory(30, shift=0.3)
    first = saved(noise_figure(pairs[0], pairs), tmp_path / "a.png")
    assert saved(noise_figure(pairs[0], pairs), tmp_path / "b.png") == first


def test_a_heading_that_passes_half_a_turn_is_drawn_without_a_jump():
    figure = noise_figure(trajectory(400), None)
    heading = figure.axes[3].lines[0].get_ydata()
    assert np.abs(np.diff(heading)).max() < 1.0
    assert heading[-1] > 180.0


def test_a_figure_that_cannot_be_written(tmp_path):
    with pytest.raises(FileError, match="^cannot write "):
        save(noise_figure(None, None), tmp_path / "nix" / "a.png")


def test_ellipses_are_drawn_around_the_noisy_path():
    outline = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    plain = noise_figure(None, None)
    figure = noise_figure(None, None, ellipses=[outline, outline + 2.0])
    added = len(figure.axes[0].lines) - len(plain.axes[0].lines)
    assert added == 2
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_xydata(), outline)
