"""From where the marker is found: closest, farthest, and how well, by distance, bearing, light.

Example:
    python3 -m bullet_lab.studies.detection_range.study results/detection_range
    python3 -m bullet_lab.studies.detection_range.study results/panel --worlds marker_panel \
        --frames 100
"""

from __future__ import annotations

import argparse
import functools
import re
import sys
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
from bullet_lab.simulation.rendering.graphics import AUTO, CHOICES, check_choice, driver_name
from bullet_lab.studies.detection_range.figures import heat_map, range_figure
from bullet_lab.studies.detection_range.results import describe, detection_summary, write_cells
from bullet_lab.studies.detection_range.tasks import (
    RangeError,
    RangeSettings,
    Result,
    do_task,
    tasks,
)
from bullet_lab.studies.interruption import interrupt_once
from bullet_lab.studies.workers import TaskLostError, completed, dask_client

SUMMARY, TABLE, PICTURE = "summary.json", "cells.csv", "detection_range.png"
LINES = 10
MOST_WORKERS = 1024
STATUS_BAD_INPUT = 2
STATUS_INTERRUPTED = 130

Workers = Callable[[Callable[[int], Result], Sequence[int]], Iterable[Tuple[int, Result]]]


def workers(count: int = 0) -> Workers:
    """Return what has tasks done by so many processes of this machine; 0: one per core."""

    def run(task: Callable[[int], Result], numbers: Sequence[int]) -> Iterator[Tuple[int, Result]]:
        with dask_client(count) as client:
            yield from completed(client, task, numbers)

    return run


def this_process(
    task: Callable[[int], Result], numbers: Sequence[int]
) -> Iterator[Tuple[int, Result]]:
    """Do the tasks here, one after the other."""
    for number in numbers:
        yield number, task(number)


def run_detection_range(
    folder: Path,
    settings: RangeSettings,
    run: Workers = this_process,
    tell: Callable[[str], None] = lambda _: None,
) -> Dict[str, Any]:
    """Try all cells and leave table, heat maps, picture and summary.

    The same settings give the same files, whoever does the work.

    Args:
        folder: where the files go; made if need be.
        settings: what is tried.
        run: has a task done for numbers and yields these and the results as they come.
        tell: gets a line of text now and then, where there is no terminal.

    Returns:
        What summary.json says.

    Raises:
        LabError: nothing can be drawn, the folder cannot be written to, or nobody works.
    """
    make_folder(folder)
    results = _run_all(settings, run, tell)
    of_cells = [r for r, task in zip(results, tasks(settings)) if task.cell is not None]
    of_dots = [r for r, task in zip(results, tasks(settings)) if task.cell is None]
    rows = [result.row() for result in of_cells]
    summary = {
        "job": "detection_range",
        "seed": settings.seed,
        "renderer": driver_name(),
        "frames_per_cell": settings.frames,
        **detection_summary(rows),
        "dots": {
            "frames": settings.dots,
            "false_detections": sum(false for false, _ in of_dots),
            "frames_with_the_marker_found": sum(found for _, found in of_dots),
        },
    }
    write_cells(folder / TABLE, rows)
    for world in settings.worlds:
        of_world = [row for row in rows if row["world"] == world]
        save(heat_map(world, of_world), folder / f"heat_map_{world}.png")
    pictures = {
        (result.cell.world, result.cell.distance): result.snapshot
        for result in of_cells
        if result.snapshot is not None
    }
    save(range_figure(rows, summary, pictures), folder / PICTURE)
    write_json(folder / SUMMARY, summary)
    return summary


def _run_all(settings: RangeSettings, run: Workers, tell: Callable[[str], None]) -> List[Result]:
    count = len(tasks(settings))
    results: Dict[int, Result] = {}
    with tqdm(total=count, unit="cell", desc="detection_range", disable=None) as bar:
        for number, result in run(functools.partial(do_task, settings), range(count)):
            if isinstance(result, TaskLostError):
                raise RangeError(f"task {number}: {result}")
            results[number] = result
            bar.update()
            # Without a terminal there is no bar.
            if bar.disable and len(results) * LINES // count > (len(results) - 1) * LINES // count:
                tell(f"{len(results)} of {count} cells done")
    return [results[number] for number in range(count)]


class _Parser(argparse.ArgumentParser):
    """A parser that complains in one line."""

    def error(self, message: str) -> NoReturn:
        _end(message, STATUS_BAD_INPUT)


def _parser() -> argparse.ArgumentParser:
    default = RangeSettings()
    parser = _Parser(prog="detection_range", description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for the results")
    parser.add_argument("--worlds", nargs="+", default=default.worlds, metavar="WORLD")
    parser.add_argument("--lights", nargs="+", default=default.lights, metavar="LIGHT")
    parser.add_argument("--distances", type=float, nargs="+", default=default.distances, help="m")
    parser.add_argument("--bearings", type=float, nargs="+", default=default.bearings, help="deg")
    parser.add_argument("--frames", type=int, default=default.frames, help="in each cell")
    parser.add_argument("--dots", type=int, default=default.dots, help="pictures of the dots")
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--renderer", choices=CHOICES, default=AUTO, help="passed over")
    parser.add_argument("--every-light", action="store_true", help="try all worlds in all lights")
    parser.add_argument("--workers", type=int, default=0, help="processes; 0: one per core")
    return parser


def main(arguments: Optional[Sequence[str]] = None) -> NoReturn:
    """Run from the command line, and exit: 0 done, 2 bad input, 130 interrupted."""
    words = sys.argv[1:] if arguments is None else arguments
    # roslaunch adds its own: __name:=… and __log:=…
    words = [word for word in words if not re.match(r"__\w+:=", word)]
    try:
        interrupt_once()
        _run(_parser().parse_args(words))
    except LabError as error:
        _end(str(error), STATUS_BAD_INPUT)
    except KeyboardInterrupt:
        sys.exit(STATUS_INTERRUPTED)
    sys.exit(0)


def _run(values: argparse.Namespace) -> None:
    if not 0 <= values.workers <= MOST_WORKERS:
        raise RangeError(f"workers must be from 0 to {MOST_WORKERS}, not {values.workers}")
    settings = RangeSettings(
        tuple(values.worlds),
        tuple(values.lights),
        tuple(sorted(values.distances)),
        tuple(sorted(values.bearings)),
        values.frames,
        values.dots,
        values.seed,
        values.every_light,
    )
    check_choice(values.renderer)
    # Better known now than after the work.
    make_folder(values.out)
    run = workers(values.workers)
    for line in describe(run_detection_range(values.out, settings, run, _tell)):
        _tell(line)


def _tell(line: str) -> None:
    print(f"detection_range: {line}", flush=True)


def _end(line: str, status: int) -> NoReturn:
    print(f"detection_range: {line}", file=sys.stderr, flush=True)
    sys.exit(status)


if __name__ == "__main__":
    main()
