"""Hundreds of dockings from random starts, on all cores, without ROS.

Example:
    python3 -m bullet_lab.studies.dock_campaign.study results/dock_campaign -n 200 --seed 1
    python3 -m bullet_lab.studies.dock_campaign.study results/far --scheduler tcp://host:8786
"""

from __future__ import annotations

import argparse
import functools
import re
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    NoReturn,
    Optional,
    Sequence,
    Tuple,
)

from tqdm import tqdm

from bullet_lab.core.figures import save
from bullet_lab.core.files import make_folder, write_json
from bullet_lab.errors import LabError
from bullet_lab.simulation.rendering.graphics import AUTO, CHOICES, check_choice
from bullet_lab.studies.dock_campaign.docking import MARKER_POSE
from bullet_lab.studies.dock_campaign.figures import campaign_figure
from bullet_lab.studies.dock_campaign.results import (
    DOCKED,
    DockLog,
    campaign_summary,
    write_campaign_csv,
)
from bullet_lab.studies.dock_campaign.scenarios import (
    LIGHTS,
    ODOMETRY,
    WORLDS,
    DrawSettings,
    draw_scenario,
    obstacles,
)
from bullet_lab.studies.dock_campaign.trial import Record, crashed_record, run_trial
from bullet_lab.studies.interruption import interrupt_once
from bullet_lab.studies.workers import (
    AddressError,
    TaskLostError,
    WorkersError,
    completed,
    dask_client,
)

LOG, TABLE, SUMMARY, PICTURE = "dockings.jsonl", "campaign.csv", "summary.json", "campaign.png"
MOST_DOCKINGS = 1_000_000
MOST_WORKERS = 1024
STATUS_CANNOT_GO_ON = 1
STATUS_BAD_INPUT = 2
STATUS_INTERRUPTED = 130

Trial = Callable[[int], Record]
Workers = Callable[[Trial, Sequence[int]], Iterable[Tuple[int, Any]]]


class CampaignError(LabError):
    """A campaign that cannot be run."""


@dataclass(frozen=True)
class CampaignSettings:
    """What is run.

    Attributes:
        draw: what scenarios are drawn from.
        dockings: how many, those of the indices from 0 on.
    """

    draw: DrawSettings = DrawSettings()
    dockings: int = 200

    def __post_init__(self):
        if not 1 <= self.dockings <= MOST_DOCKINGS:
            raise CampaignError(f"n must be from 1 to {MOST_DOCKINGS}, not {self.dockings}")


def dask_workers(workers: int = 0, scheduler: str = "") -> Workers:
    """Return what runs dockings on Dask; see `dask_client`. Each is tried until its end."""

    def run(trial: Trial, indices: Sequence[int]) -> Iterator[Tuple[int, Any]]:
        with dask_client(min(workers, len(indices)), scheduler) as client:
            yield from completed(client, trial, indices)

    return run


def run_campaign(
    folder: Path,
    settings: CampaignSettings,
    run: Workers,
    trial: Callable[[DrawSettings, int], Record] = run_trial,
    tell: Callable[[str], None] = lambda _: None,
) -> Dict[str, Any]:
    """Run a campaign, or what is missing of it, and leave log, table, picture and summary.

    The same settings give the same files, whatever the workers and interruptions; only "run" in
    summary.json says how this run went.

    Args:
        folder: where the files go; made if need be.
        settings: what is run.
        run: has `trial` done for indices, somewhere, and yields them and their records, or a
            TaskLostError for one that has crashed.
        trial: returns the record of a docking.
        tell: gets a line of text now and then.

    Returns:
        What summary.json says.

    Raises:
        LabError: the folder holds another campaign or cannot be written to, or nobody works.
    """
    log = DockLog(make_folder(folder) / LOG, asdict(settings.draw))
    try:
        seconds, new = _run_missing(log, settings, run, trial, tell)
    except BaseException:
        log.close()
        raise
    records = [log.records[index] for index in range(settings.dockings)]
    log.sort()
    return _write_results(folder, settings, records, _figures_of_run(new, seconds))


def _run_missing(
    log: DockLog,
    settings: CampaignSettings,
    run: Workers,
    trial: Callable[[DrawSettings, int], Record],
    tell: Callable[[str], None],
) -> Tuple[float, List[Record]]:
    """Run what the log has not; return the wall seconds it took, and the new records."""
    known = [log.records[i] for i in range(settings.dockings) if i in log.records]
    missing = [index for index in range(settings.dockings) if index not in log.records]
    new: List[Record] = []
    if not missing:
        return 0.0, new
    if known:
        tell(f"going on after {len(known)} of {settings.dockings} dockings")
    docked = sum(record["result"] == DOCKED for record in known)
    start = time.monotonic()
    with DockProgress(settings.dockings, docked, len(known) - docked, tell) as progress:
        for index, result in run(functools.partial(trial, settings.draw), missing):
            if isinstance(result, TaskLostError):
                result = crashed_record(settings.draw, index, str(result))
            log.append(result)
            new.append(result)
            progress.note(result["result"] == DOCKED)
    return time.monotonic() - start, new


def _figures_of_run(new: Sequence[Record], seconds: float) -> Dict[str, Any]:
    simulated = sum(record["sim_time_s"] or 0.0 for record in new)
    return {
        "dockings": len(new),
        "sim_time_s": simulated,
        "wall_time_s": seconds,
        "real_time_factor": simulated / seconds if new and seconds > 0.0 else None,
    }


def _write_results(
    folder: Path,
    settings: CampaignSettings,
    records: Sequence[Record],
    figures_of_run: Dict[str, Any],
) -> Dict[str, Any]:
    summary = {
        "job": "dock_campaign",
        **asdict(settings.draw),
        **campaign_summary(records),
        "run": figures_of_run,
    }
    write_campaign_csv(folder / TABLE, records)
    standing = {box.corners(): None for world in settings.draw.worlds for box in obstacles(world)}
    title = (
        f"{summary['docked']} of {len(records)} dockings succeeded "
        f"(seed {settings.draw.seed}; success rate over "
        f"{100.0 * summary['success_rate_lower_95']:.2f} % at 95 % confidence)"
    )
    save(campaign_figure(records, standing, MARKER_POSE, title), folder / PICTURE)
    write_json(folder / SUMMARY, summary)
    return summary


def describe(summary: Dict[str, Any]) -> List[str]:
    """Return the main figures of a campaign as lines for people."""
    lines = [
        f"{summary['docked']} of {summary['dockings']} docked "
        f"(success rate over {100.0 * summary['success_rate_lower_95']:.2f} % at 95 % confidence), "
        f"{summary['dockings_with_contact']} with wall contact"
    ]
    if summary["failures"]:
        reasons = ", ".join(f"{name} {count}" for name, count in summary["failures"].items())
        lines.append(f"failures: {reasons} (indices {summary['failed_indices']})")
    if summary["docked"]:
        lines.append("error, median / 95 % / max: " + "; ".join(_errors(summary)))
    factor = summary["run"]["real_time_factor"]
    if factor is not None:
        lines.append(
            f"{summary['run']['sim_time_s']:.0f} s simulated in "
            f"{summary['run']['wall_time_s']:.0f} s, {factor:.1f} times real time"
        )
    return lines


def _errors(summary: Dict[str, Any]) -> Iterator[str]:
    for name, title, scale, unit in (
        ("distance_error_m", "distance", 1000.0, "mm"),
        ("lateral_error_m", "lateral", 1000.0, "mm"),
        ("yaw_error_deg", "yaw", 1.0, "deg"),
    ):
        values = (scale * summary[name][part] for part in ("median", "p95", "max"))
        yield f"{title} {' / '.join(f'{value:.2f}' for value in values)} {unit}"


class _Parser(argparse.ArgumentParser):
    """A parser that complains in one line."""

    def error(self, message: str) -> NoReturn:
        _end(message, STATUS_BAD_INPUT)


def _parser() -> argparse.ArgumentParser:
    default = CampaignSettings()
    parser = _Parser(prog="dock_campaign", description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for the results; a stopped one goes on")
    parser.add_argument("-n", type=int, default=default.dockings, help="dockings")
    parser.add_argument("--seed", type=int, default=default.draw.seed)
    parser.add_argument("--worlds", nargs="+", default=WORLDS, metavar="WORLD")
    parser.add_argument("--lights", nargs="+", default=LIGHTS, metavar="LIGHT")
    parser.add_argument("--odom", nargs="+", default=ODOMETRY, metavar="TOPIC")
    parser.add_argument("--renderer", choices=CHOICES, default=AUTO, help="passed over")
    parser.add_argument("--workers", type=int, default=0, help="processes; 0: one per core")
    parser.add_argument("--scheduler", default="", help="of a Dask cluster, tcp://host:port")
    return parser


def main(arguments: Optional[Sequence[str]] = None) -> NoReturn:
    """Run from the command line, and exit: 0 done, 1 no workers, 2 bad input, 130 interrupted."""
    words = sys.argv[1:] if arguments is None else arguments
    # roslaunch adds its own: __name:=… and __log:=…
    words = [word for word in words if not re.match(r"__\w+:=", word)]
    try:
        interrupt_once()
        _run(_parser().parse_args(words))
    except LabError as error:
        nobody = isinstance(error, WorkersError) and not isinstance(error, AddressError)
        _end(str(error), STATUS_CANNOT_GO_ON if nobody else STATUS_BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(STATUS_INTERRUPTED)
    sys.exit(0)


def _run(values: argparse.Namespace) -> None:
    if not 0 <= values.workers <= MOST_WORKERS:
        raise CampaignError(f"workers must be from 0 to {MOST_WORKERS}, not {values.workers}")
    draw = DrawSettings(
        values.seed,
        tuple(values.worlds),
        tuple(values.lights),
        tuple(values.odom),
    )
    check_choice(values.renderer)
    settings = CampaignSettings(draw, values.n)
    # A world that is missing is better known now than from each worker.
    draw_scenario(draw, 0)
    run = dask_workers(values.workers, values.scheduler)
    for line in describe(run_campaign(values.out, settings, run, tell=_tell)):
        _tell(line)


def _tell(line: str) -> None:
    print(f"dock_campaign: {line}", flush=True)


def _end(line: str, status: int) -> NoReturn:
    print(f"dock_campaign: {line}", file=sys.stderr, flush=True)
    sys.exit(status)


if __name__ == "__main__":
    main()


_LINES = 10


class DockProgress:
    """Counts dockings and tells of them.

    Args:
        total: how many there will be.
        docked: how many of them have succeeded before.
        failed: how many of them have failed before.
        tell: gets a line of text now and then, where there is no terminal.
    """

    def __init__(self, total: int, docked: int, failed: int, tell: Callable[[str], None]):
        self._docked, self._failed = docked, failed
        self._tell = tell
        self._every = -(-total // _LINES)
        self._bar = tqdm(
            total=total, initial=docked + failed, unit="docking", desc="docking", disable=None
        )

    def __enter__(self) -> DockProgress:
        self._show()
        return self

    def __exit__(self, *_) -> None:
        self._bar.close()

    def note(self, docked: bool) -> None:
        """Count a docking that has succeeded, or has not."""
        if docked:
            self._docked += 1
        else:
            self._failed += 1
        self._bar.update()
        self._show()
        done = self._docked + self._failed
        if self._bar.disable and done % self._every == 0:
            self._tell(f"{done} of {self._bar.total} done, {self._counts()}")

    def _show(self) -> None:
        if not self._bar.disable:
            self._bar.set_postfix_str(self._counts())

    def _counts(self) -> str:
        return f"docked {self._docked}, failed {self._failed}"
