"""Hundreds of dockings from random starts, on all cores, without ROS.

Example:
    bullet_lab dock_campaign n:=200 seed:=1
    bullet_lab dock_campaign stress:=each
"""

from __future__ import annotations

import contextlib
import functools
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bullet_lab.core.files import make_folder
from bullet_lab.core.parameters import ParameterError, integer, part_of, text
from bullet_lab.docking.database import DOCKED, ERRORS
from bullet_lab.studies.dock_campaign.compare import compare
from bullet_lab.studies.dock_campaign.results import (
    LOG,
    QUANTITIES,
    DockLog,
    campaign_figure,
    campaign_summary,
    read_log,
    stress_row,
)
from bullet_lab.studies.dock_campaign.stress import STRESSES
from bullet_lab.studies.dock_campaign.trial import (
    ALL,
    EACH,
    NONE,
    DrawSettings,
    crashed_record,
    draw_scenario,
    obstacles,
    run_trial,
)
from bullet_lab.studies.study import (
    Record,
    Run,
    Summary,
    TaskLostError,
    Tell,
    WorkerSettings,
    progress,
    run_from,
    workers,
    write_results,
)

MOST_DOCKINGS = 1_000_000


@dataclass(frozen=True)
class DockCampaignSettings(DrawSettings):
    """Dockings of the indices from 0 on."""

    dockings: int = integer(200, "number of dockings", 1, MOST_DOCKINGS)

    beside: str = text("", f"{LOG} of the same dockings by another controller; empty: none")

    def drawn_from(self) -> dict[str, Any]:
        """Return the parameters that determine the outcome of each docking, by name."""
        return vars(part_of(DrawSettings, self))


def run_campaign(
    folder: Path, settings: DockCampaignSettings, run: Run, tell: Tell = print
) -> Summary:
    """Run the dockings that a campaign's log lacks; write log, table, figure and summary.json.

    The same settings give the same files, with any workers and after any interruptions, except
    for "run" in summary.json, which is returned: it describes this run.

    Raises:
        LabError: the folder holds another campaign or cannot be written to, or no worker is left.
    """
    with contextlib.closing(DockLog(make_folder(folder) / LOG, settings.drawn_from())) as log:
        seconds, new = _run_missing(log, settings, run, tell)
        log.sort()
    records = [log.records[index] for index in range(settings.dockings)]
    simulated = sum(record["sim_time_s"] or 0.0 for record in new)
    summary = {
        "job": "dock_campaign",
        **settings.drawn_from(),
        **campaign_summary(records),
        "run": {
            "dockings": len(new),
            "sim_time_s": simulated,
            "wall_time_s": seconds,
            "real_time_factor": simulated / seconds if new and seconds > 0.0 else None,
        },
    }
    title = (
        f"{summary['docked']} of {len(records)} dockings succeeded "
        f"(seed {settings.seed}; success rate over "
        f"{100.0 * summary['success_rate_lower_95']:.2f} % at 95 % confidence)"
    )
    boxes = [box for world in settings.worlds for box in obstacles(world)]
    figure = campaign_figure(records, boxes, title)
    tables = {"campaign.csv": records}
    return write_results(folder, summary, tables, {"campaign.png": figure}, {})


def _run_missing(
    log: DockLog, settings: DockCampaignSettings, run: Run, tell: Tell
) -> tuple[float, list[Record]]:
    """Run the dockings that the log lacks; return the seconds it took, and the new records."""
    count = settings.dockings
    missing = [index for index in range(count) if index not in log.records]
    if not missing:
        return 0.0, []
    done = count - len(missing)
    if done:
        tell(f"continuing after {done} of {count} dockings")
    results = Counter(r["result"] == DOCKED for i, r in log.records.items() if i < count)

    def counts() -> str:
        return f"docked {results[True]}, failed {results[False]}"

    start = time.monotonic()
    # A worker that gets these imports no more than a docking needs, without figures.
    found = run(functools.partial(run_trial, part_of(DrawSettings, settings)), missing)
    for index, result in progress(found, "dockings", count, tell, done, counts):
        if isinstance(result, TaskLostError):
            result = crashed_record(settings, index, str(result))
        log.append(result)
        results[result["result"] == DOCKED] += 1
    return time.monotonic() - start, [log.records[index] for index in missing]


def describe(summary: Summary) -> list[str]:
    """Return the main figures of a campaign as lines for the user."""
    lines = [
        f"{summary['docked']} of {summary['dockings']} docked within their dock's tolerance"
        f"{'' if summary['stress'] == (NONE,) else ' plus the cost of the stress'} "
        f"(success rate over {100.0 * summary['success_rate_lower_95']:.2f} % at 95 % confidence), "
        f"{summary['dockings_with_contact']} with wall contact"
    ]
    if summary["failures"]:
        reasons = ", ".join(f"{name} {count}" for name, count in summary["failures"].items())
        lines.append(f"failures: {reasons} (indices {summary['failed_indices']})")
    errors = []
    for column in ERRORS:
        name, unit, factor = QUANTITIES[column]
        if summary[column]["max"] is not None:
            values = (f"{factor * summary[column][part]:.2f}" for part in ("median", "p99", "max"))
            errors.append(f"{name} {' / '.join(values)} {unit}")
    if errors:
        lines.append("median / 99 % / max: " + "; ".join(errors))
    factor = summary["run"]["real_time_factor"]
    if factor is not None:
        lines.append(
            f"{summary['run']['sim_time_s']:.0f} s simulated in "
            f"{summary['run']['wall_time_s']:.0f} s, {factor:.1f} times real time"
        )
    return lines


def run_each(
    folder: Path, settings: DockCampaignSettings, run: Run, tell: Tell = print
) -> list[str]:
    """Run a campaign without stress, under each stress, and under all, each in its own folder.

    An index has the same start in all of them. Writes a table and summary.json of all; returns
    lines for the user on each.

    Raises:
        LabError: as `run_campaign`.
    """
    summaries = {}
    for name in (NONE, *STRESSES, ALL):
        tell(f"stress {name}")
        one = replace(settings, stress=(name,))
        summaries[name] = run_campaign(folder / name, one, run, tell)
    rows = [stress_row(name, one) for name, one in summaries.items()]
    summary = {"job": "dock_campaign", **settings.drawn_from(), "by_stress": summaries}
    write_results(folder, summary, {"stresses.csv": rows}, {}, {})
    return [f"{name}: {line}" for name, one in summaries.items() for line in describe(one)]


def _run(
    folder: Path, settings: DockCampaignSettings, work: WorkerSettings, tell: Tell
) -> list[str]:
    # A missing file shows here, instead of in each worker or after the campaign.
    draw_scenario(settings, 0)
    if settings.beside:
        if EACH in settings.stress:
            raise ParameterError("beside: it takes the campaign under one stress, not under each")
        read_log(Path(settings.beside))
    run = workers(work.workers)
    if EACH in settings.stress:
        return run_each(folder, settings, run, tell=tell)
    lines = describe(run_campaign(folder, settings, run, tell=tell))
    if settings.beside:
        lines += compare(folder, Path(settings.beside), settings.dockings)
    return lines


SETTINGS = (DockCampaignSettings, WorkerSettings)
main = functools.partial(run_from, "dock_campaign", __doc__, SETTINGS, _run)
