"""The program around a study: command line, exit status, workers, progress, complete results.

A study consists of settings (frozen dataclasses, with parameters declared by `core.parameters`)
and a function that takes them. `run_from` makes a program of the two. `workers` runs the tasks of
a study on processes of this machine; `write_results` writes its tables, figures and summary.
"""

from __future__ import annotations

import contextlib
import csv
import logging
import os
import re
import signal
import sys
import tempfile
import threading
from collections import Counter
from dataclasses import dataclass
from functools import partial
from multiprocessing import connection, get_context, parent_process, resource_tracker
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, Mapping, NoReturn, Sequence, Tuple, TypeVar

from scipy.special import betaincinv
from tqdm import tqdm

from bullet_lab.core.files import PART, Summary, file_errors, make_folder, write_json
from bullet_lab.core.parameters import (
    ArgumentParser,
    add_options,
    check_parameters,
    integer,
    read_options,
)
from bullet_lab.entry import STATUS_INTERRUPTED
from bullet_lab.errors import LabError

SUMMARY = "summary.json"
STATUS_UNFINISHED = 1
STATUS_BAD_INPUT = 2
MOST_SEED = 2**63 - 1
LINES = 10
"""Number of lines that report the progress if there is no terminal."""

Record = Mapping[str, Any]
"""A row of a table by the names of its columns."""

T = TypeVar("T")
Tell = Callable[[str], None]
"""Prints a line for the user."""

# Number of processes that may die on a task; another task may have been the cause.
LIVES = 3
MOST_WORKERS = 1024

_SPAWN = get_context("spawn")

Task = Callable[[int], Any]
Results = Iterator[Tuple[int, Any]]
Run = Callable[[Task, Sequence[int]], Iterable[Tuple[int, Any]]]
"""Runs a task for each of some numbers; yields numbers and results in the order of completion.

If every process that ran the task has died, the result is a TaskLostError, which is not raised.
"""


@dataclass(frozen=True)
class Settings:
    """Parameters of a study.

    Raises:
        ParameterError: a value is invalid, also if it was given in Python.
    """

    def __post_init__(self) -> None:  # noqa: D105 - see the class
        check_parameters(self)


class UnfinishedError(LabError):
    """The request is valid, but was not completed."""


class TaskLostError(UnfinishedError):
    """Every process that ran a task has died."""


def run_from(
    name: str,
    about: str | None,
    settings: Sequence[type],
    run: Callable[..., Iterable[str] | None],
    words: Sequence[str] | None = None,
) -> NoReturn:
    """Run a study from the command line, and exit: 0 done, 1 unfinished, 2 bad input, 130 stopped.

    Args:
        name: of the program; each line that it prints begins with it.
        about: description of the program; the help prints its first line.
        settings: dataclasses with the parameters; each parameter becomes an option.
        run: gets the folder for the results, which exists, an instance of each of `settings`, and
            a function that prints a line; may return lines to print; raises LabError.
        words: of the command line; those of this process by default.
    """
    words = sys.argv[1:] if words is None else words

    def tell(line: str) -> None:
        print(f"{name}: {line}", flush=True)

    status = 0
    try:
        interrupt_once()
        parser = ArgumentParser(prog=name, description=(about or "").split("\n")[0])
        parser.add_argument("out", type=Path, help="folder for the results")
        for kind in settings:
            add_options(parser, kind)
        # roslaunch adds __name:=… and __log:=…
        values = vars(parser.parse_args([w for w in words if not re.match(r"__\w+:=", w)]))
        read = [read_options(kind, values) for kind in settings]
        # A folder that cannot be written to shows here, instead of after the work.
        folder = make_folder(values["out"])
        for line in run(folder, *read, tell) or ():
            tell(line)
    except LabError as error:
        print(f"{name}: {error}", file=sys.stderr, flush=True)
        status = STATUS_UNFINISHED if isinstance(error, UnfinishedError) else STATUS_BAD_INPUT
    except KeyboardInterrupt:
        status = STATUS_INTERRUPTED
    # Python removes signal handlers before it exits: a signal after that would change the status.
    _ignore_interrupts()
    sys.exit(status)


def interrupt_once() -> None:
    """Have the first SIGINT or SIGTERM raise KeyboardInterrupt, and ignore those that follow.

    A job may get both signals, one right after the other: the second must not interrupt the
    clean-up.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)


def _interrupt(_number: int, _frame: Any) -> None:
    _ignore_interrupts()
    raise KeyboardInterrupt


def _ignore_interrupts() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def progress(
    items: Iterable[T],
    things: str,
    total: int,
    tell: Tell,
    done: int = 0,
    counts: Callable[[], str] = str,
) -> Iterator[T]:
    """Yield items, and show the progress: a bar on a terminal, at most `LINES` lines elsewhere.

    Args:
        items: of which the next one is asked for when the work on one is done.
        things: name of the items.
        total: number of all items.
        tell: prints a line.
        done: number of items that were done before.
        counts: returns a summary of the items that are done.
    """
    with tqdm(total=total, initial=done, desc=things, disable=None) as bar:
        for item in items:
            yield item
            done += 1
            bar.update()
            if not bar.disable:
                bar.set_postfix_str(counts())
            elif done * LINES // total > (done - 1) * LINES // total:
                tell(", ".join(filter(None, (f"{done} of {total} {things} done", counts()))))


@dataclass(frozen=True)
class WorkerSettings(Settings):
    """Number of processes on this machine."""

    workers: int = integer(0, "processes; 0: one for each core", 0, MOST_WORKERS)


def this_process(task: Task, numbers: Sequence[int]) -> Results:
    """Run the tasks here, one after the other: the simplest `Run`."""
    return ((number, task(number)) for number in numbers)


def run_tasks(task: Task, count: int, run: Run, tell: Tell, things: str) -> list[Any]:
    """Run a task for the numbers from 0 on and return the results in this order.

    `things` is the name of the tasks for the user. Raises TaskLostError if every process that ran
    one of the tasks has died.
    """
    results: dict[int, Any] = {}
    for number, result in progress(run(task, range(count)), things, count, tell):
        if isinstance(result, TaskLostError):
            raise TaskLostError(f"number {number} of {things}: {result}")
        results[number] = result
    return [results[number] for number in range(count)]


def workers(count: int = 0) -> Run:
    """Return a function that runs tasks on so many processes of this machine; 0: one for each core.

    If a process dies, another one runs its task again. The function raises UnfinishedError if the
    tasks cannot be run. The processes share nothing, and end with this one, however it ends.
    """
    return partial(_on_processes, count)


def _on_processes(count: int, task: Task, numbers: Sequence[int]) -> Results:
    # Each process uses one core: its libraries must not start a thread per core.
    for library in ("MKL", "OMP", "OPENBLAS"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    most = count or len(os.sched_getaffinity(0))
    left, deaths = list(reversed(numbers)), Counter()
    busy: dict[Any, _Worker] = {}
    try:
        while left or busy:
            while left and len(busy) < most:
                worker = _Worker(task)
                busy[worker.pipe] = worker
                worker.give(left.pop())
            for pipe in connection.wait(list(busy)):
                number, found = busy[pipe].number, busy[pipe].result()
                has_died = isinstance(found, TaskLostError)
                if left and not has_died:
                    busy[pipe].give(left.pop())
                else:
                    busy.pop(pipe).end()
                deaths[number] += has_died
                if has_died and deaths[number] < LIVES:
                    left.append(number)
                elif isinstance(found, UnfinishedError) and not has_died:
                    raise found
                else:
                    yield number, found
    finally:
        for worker in busy.values():
            worker.end()


class _Worker:
    """A process that runs tasks, one at a time."""

    def __init__(self, task: Task):
        self.pipe, theirs = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=_work, args=(task, theirs), daemon=True)
        # It ignores Ctrl-C from its start on: this process ends it. The resource tracker, which
        # starts with the first process, would unblock the signal.
        resource_tracker.ensure_running()
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        self._process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        theirs.close()

    def give(self, number: int) -> None:
        """Send the number of a task."""
        self.number = number
        # If the process has died, `result` tells it.
        with contextlib.suppress(OSError):
            self.pipe.send(number)

    def result(self) -> Any:
        """Return what `_work` sends, or a TaskLostError if the process has died."""
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            return TaskLostError("each worker process that ran the task has died")

    def end(self) -> None:
        """Kill the process, even while it runs a task."""
        self._process.kill()
        self._process.join()
        self.pipe.close()


def _work(task: Task, pipe: connection.Connection) -> None:
    """Run the tasks of the numbers that arrive; send the results, or why one failed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # Not before: the program itself may need no images.
    import cv2

    cv2.setNumThreads(1)
    # Each process would repeat them.
    logging.disable(logging.WARNING)
    with contextlib.suppress(EOFError):
        while True:
            number = pipe.recv()
            try:
                pipe.send(task(number))
            except Exception as error:  # of the task, or of a result that cannot be pickled
                known = isinstance(error, LabError)
                reason = f"a worker process failed: {type(error).__name__}: {error}"
                pipe.send(UnfinishedError(str(error) if known else reason))


def _end_with_parent() -> None:
    parent: Any = parent_process()
    parent.join()
    os._exit(1)


@contextlib.contextmanager
def whole_results(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder; move the files from it into `folder` when all are written.

    If anything fails before that, `folder` keeps its earlier results. Raises FileError.
    """
    make_folder(folder)
    with file_errors(f"cannot write to {folder}"), tempfile.TemporaryDirectory(
        dir=folder, prefix=PART
    ) as name:
        part = Path(name)
        yield part
        files = [path.relative_to(part) for path in sorted(part.rglob("*")) if path.is_file()]
        # The summary comes last: it shows that the results are complete.
        for file in sorted(files, key=lambda path: path.name == SUMMARY):
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (part / file).replace(folder / file)


def write_table(path: Path, records: Iterable[Record]) -> None:
    """Write records, all with the same names, as CSV; None becomes empty, a bool true or false."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        for number, record in enumerate(records):
            if number == 0:
                writer.writerow(record)
            entries = record.values()
            writer.writerow(str(e).lower() if isinstance(e, bool) else e for e in entries)


def write_results(
    folder: Path,
    summary: Summary,
    tables: Mapping[str, Iterable[Record]],
    figures: Mapping[str, Any],
    texts: Mapping[str, str],
    name: str = SUMMARY,
) -> Summary:
    """Write all results of a study, or none of them, and return the summary; raises FileError.

    Args:
        folder: for the files.
        summary: content of a JSON file.
        tables: records of CSV files, by the names of the files.
        figures: of matplotlib, by the names of PNG files.
        texts: content of other files by their names, which may begin with a folder.
        name: of the file with the summary.
    """
    # Each worker process imports this module, and none of them draws.
    from bullet_lab.core.figures import save

    with whole_results(folder) as part:
        for file, records in tables.items():
            write_table(part / file, records)
        for file, figure in figures.items():
            save(figure, part / file)
        for file, text in texts.items():
            (part / file).parent.mkdir(exist_ok=True)
            (part / file).write_text(text)
        write_json(part / name, summary)
    return summary


def clopper_pearson(hits: int, trials: int, tail: float) -> tuple[float, float]:
    """Return Clopper and Pearson's interval of the probability of a hit.

    Each end is the probability for which at least so many hits, or at most so many, have the
    probability `tail`: a quantile of the beta distribution. The true probability, whatever its
    value, is beyond an end in at most that share of all experiments.
    (C. J. Clopper and E. S. Pearson, Biometrika 26, 1934.)

    >>> [round(end, 3) for end in clopper_pearson(95, 100, 0.025)]
    [0.887, 0.984]
    """
    low = betaincinv(hits, trials - hits + 1, tail) if hits else 0.0
    high = betaincinv(hits + 1, trials - hits, 1.0 - tail) if hits < trials else 1.0
    return float(low), float(high)


def text_table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return lines with the words of each row in columns."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
