from dataclasses import replace

import numpy as np
import pytest
from alike import lines_of, lines_of_figure
from shared import cases

from bullet_lab.core.trajectory import Trajectory, read_tum
from bullet_lab.docking.database import Dock, DockMarker, DockTolerance, DockUncertainty
from bullet_lab.docking.types import DockingError, DockingResult
from bullet_lab.reports import Reading
from bullet_lab.reports.dock import (
    DockReport,
    EvenSample,
    Station,
    docking_figure,
)

DOCK = (4.0, 0.0, 0.0)
ENTRY = Dock(
    "dock",
    "odom",
    (4.1, -0.1, 0.1),
    DockMarker("DICT_APRILTAG_36h10", 0, 0.2, 0.5),
    None,
    3.0,
    0.4,
    DockTolerance(0.005, 0.003, 0.007),
    DockUncertainty(0.3, 0.17),
)
STATION = Station([], DOCK, 0.16, ENTRY)
DOCKED = (3.441, 0.002, 0.0)
STEP = 50_000_000


RUN = {"sim_time_s": 1.0, "wall_time_s": 0.1, "real_time_factor": 10.0, "refused_messages": 0}


@pytest.fixture
def report(tmp_path):
    return DockReport(tmp_path, STATION)


def drive(report, count, end=DOCKED):
    """Send a path past its beginning, at which nothing is recorded."""
    for number in range(1, count + 1):
        pose = (0.1 * number, 0.0, 0.0) if number < 20 else end
        report.take("odom", Reading(STEP * number, pose))


def test_reports_of_dockings_are_as_before(tmp_path, as_before):
    told = []
    for name, end, touched, error in (
        ("docked", DOCKED, {}, "NONE"),
        ("not within the tolerance", (3.44, 0.0031, 0.0), {}, "NONE"),
        ("touched", DOCKED, {"wall": 1}, "NONE"),
        ("failed", DOCKED, {}, "BLOCKED"),
        ("broken off", DOCKED, {}, None),
    ):
        report = DockReport(tmp_path / name, STATION)
        drive(report, 40, end)
        if error:
            report.take("dock/finished", Reading(20 * STEP))
            report.take("bullet_lab/touched", Reading(30 * STEP, (), touched))
            told += lines_of([report.until, report.is_complete()], f"{name}, no result yet")
            report.result = DockingResult(DockingError[error], "why", 1)
            # After the end, and no part of it.
            report.take("bullet_lab/touched", Reading(31 * STEP, (), {"wall": 3}))
        told += lines_of(report.is_complete(), name)
        report.finish(report.until)
        summary = report.summary(bool(error), RUN)
        told += lines_of([report.line(summary), report.has_failed(summary)], f"{name}: line")
        told += lines_of(summary, name)
        told += lines_of(read_tum(report.folder / "truth.tum").stamps[[0, -1]], f"{name}, s")
    as_before(told, "docks.txt")


def test_pictures_are_those_of_the_docking_each_with_its_state(report):
    picture = np.zeros((48, 64, 3), dtype=np.uint8)

    def see(*numbers):
        for number in numbers:
            report.take("aruco/image_annotated", Reading(number * STEP, (), picture))

    see(11)
    report.sent = True
    # The first one was seen before the goal, and is late.
    see(8, 12)
    report.take("dock/feedback", Reading(13 * STEP, (), "staging"))
    report.take("dock/finished", Reading(15 * STEP))
    # Late, and after the end.
    see(14, 16)
    summary = report.summary(True, RUN)
    assert summary["images"] == 2
    titles = [axes.get_title() for axes in report.figures(summary)["camera.png"].axes]
    assert titles == ["0.6 s, at rest", "0.7 s, staging"]


@cases("seen: [0, 8, 9, 33, 500]")
def test_sampler_are_spread_over_all_and_end_with_the_last(seen):
    sampler = EvenSample(8)
    for number in range(seen):
        sampler.add(number)
    chosen = sampler.chosen()
    if seen <= 8:
        assert chosen == list(range(seen))
    else:
        assert (len(chosen), chosen[0], chosen[-1]) == (8, 0, seen - 1)
        assert max(np.diff(chosen)) <= 2.1 * seen / 7
    assert sampler.seen == seen
    assert len(sampler._kept) <= 32


def test_the_figure_is_as_before(as_before):
    along = np.arange(0.05, 2.01, 0.05)
    truth = Trajectory(along, np.column_stack([2.0 * along, 0.2 * along, 0.0 * along]))
    states = [(0.5, "searching"), (1.0, "staging"), (1.5, "approaching")]
    walls, plan = [((3.0, 0.5), (2.0, 0.5), (2.0, 0.7), (3.0, 0.7))], [(0.0, 0.0), (3.0, 0.0)]
    station = Station(walls, DOCK, 0.16, replace(ENTRY, pose=DOCK))
    figure = docking_figure(truth, states, plan, station, "title")
    as_before(lines_of_figure(figure), "dock.txt")
