import math

import pytest

from bullet_lab.core.files import Join, PathSeries, Series, SeriesError
from bullet_lab.core.trajectory import read_tum

STEP = 50_000_000


def test_each_pose_is_in_the_file_at_once(tmp_path):
    series = PathSeries(tmp_path / "new" / "a.tum")
    for number in (1, 2, 3):
        series.add(STEP * number, (0.1 * number, 0.01 * number, 0.5))
    found = read_tum(tmp_path / "new" / "a.tum")
    assert found.stamps.tolist() == [0.05, 0.1, 0.15]
    assert found.poses[2, 1] == 0.01 * 3
    assert series.path().poses[:, :2].tolist() == found.poses[:, :2].tolist()


def test_what_came_after_the_end_is_left_out(tmp_path):
    series = PathSeries(tmp_path / "a.tum")
    for number in range(1, 11):
        series.add(STEP * number, (0.0, 0.0, 0.0))
    assert series.last == 10 * STEP
    series.finish(4 * STEP)
    assert len(read_tum(tmp_path / "a.tum")) == len(series) == len(series.path()) == 4
    series.finish(0)
    assert series.path() is None


@pytest.mark.parametrize("kind", [PathSeries, lambda path: Series(path, "abc")])
@pytest.mark.parametrize("stamp", [0, STEP])
def test_time_does_not_go_back(tmp_path, kind, stamp):
    series = kind(tmp_path / "a")
    series.add(STEP, (0.0, 0.0, 0.0))
    with pytest.raises(SeriesError, match=r"^time goes back from 0\.050000000 s to "):
        series.add(stamp, (0.0, 0.0, 0.0))
    assert len(series) == 1


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_poses_are_finite(tmp_path, bad):
    series = PathSeries(tmp_path / "a")
    with pytest.raises(SeriesError, match="^the pose is not finite"):
        series.add(STEP, (0.0, bad, 0.0))
    assert series.last is None
    assert (tmp_path / "a").read_text() == ""


def test_rows_in_any_order_are_put_in_order_at_the_end(tmp_path):
    series = Series(tmp_path / "a", ["x"], in_order=False)
    for stamp, value in ((2 * STEP, 1), (STEP, 2), (2 * STEP, 3)):
        series.add(stamp, [value])
    assert series.last == 2 * STEP
    assert len((tmp_path / "a").read_text().splitlines()) == 4
    series.finish()
    assert (tmp_path / "a").read_text() == "stamp,x\n0.050000000,2.0\n0.100000000,3.0\n"


def test_rows_are_joined_by_the_nanosecond_whatever_comes_first():
    whole = []
    join = Join(("a", "b"), lambda stamp, values: whole.append((stamp, values)))
    join.add("a", STEP, [1.0])
    join.add("b", STEP + 1, [2.0])
    join.add("b", STEP, [3.0])
    join.add("a", STEP + 1, [4.0])
    assert whole == [(STEP, {"a": [1.0], "b": [3.0]}), (STEP + 1, {"a": [4.0], "b": [2.0]})]
