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


@pytest.mark.parametrize("count", [1, 400])
def test_both_paths_their_ends_and_their_error(count):
    pairs = trajectory(count), trajectory(count, shift=0.3)
    figure = noise_figure(trajectory(count + 5), pairs)
    paths, *coordinates, error = drawn(figure)
    assert sorted(paths) == sorted([count + 5, count, 1, 1, 1])
    assert coordinates == [[count, count + 5]] * 3
    assert error == [count]
    assert figure.axes[0].get_aspect() == 1.0
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == ["Noisy odom", "Perfect odom", "start", "ends"]
    assert figure.axes[-1].lines[0].get_ydata() == pytest.approx([0.3] * count)


def test_the_same_figure_is_the_same_file(tmp_path):
    pairs = trajectory(30), trajectory(30, shift=0.3)
    first = saved(noise_figure(pairs[0], pairs), tmp_path / "a.png")
    assert saved(noise_figure(pairs[0], pairs), tmp_path / "b.png") == first


def test_a_figure_that_cannot_be_written(tmp_path):
    with pytest.raises(FileError, match="^cannot write "):
        save(noise_figure(None, None), tmp_path / "nix" / "a.png")
