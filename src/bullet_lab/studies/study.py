"""The program around a study: command line, exit status, progress and complete results.

A study consists of settings (frozen dataclasses, with parameters declared by `core.parameters`)
and a function that takes them. `run_from` makes a program of the two. `studies.workers` runs the
tasks of a study; `studies.results` writes its tables, figures and summary.
"""

from __future__ import annotations

import contextlib
import csv
import re
import signal
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, NoReturn, Optional, Sequence, Tuple, Type

from tqdm import tqdm

from bullet_lab.core.files import PART, file_errors, make_folder
from bullet_lab.core.parameters import ArgumentParser, add_options, check_parameters, read_options
from bullet_lab.entry import STATUS_INTERRUPTED
from bullet_lab.errors import LabError

SUMMARY = "summary.json"
STATUS_UNFINISHED = 1
STATUS_BAD_INPUT = 2
MOST_SEED = 2**63 - 1
LINES = 10
"""Number of lines that report the progress if there is no terminal."""

Tell = Callable[[str], None]
"""Prints a line for the user."""


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


def silent(line: str) -> None:
    """Print nothing."""


def run_from(
    name: str,
    about: Optional[str],
    settings: Sequence[Type],
    run: Callable[..., Optional[Iterable[str]]],
    words: Optional[Sequence[str]] = None,
    short: Sequence[Tuple[str, str]] = (),
) -> NoReturn:
    """Run a study from the command line, and exit: 0 done, 1 unfinished, 2 bad input, 130 stopped.

    Args:
        name: of the program; each line that it prints begins with it.
        about: description of the program; the help prints its first line.
        settings: dataclasses with the parameters; each parameter becomes an option.
        run: gets the folder for the results, which exists, an instance of each of `settings`, and
            a function that prints a line; may return lines to print; raises LabError.
        words: of the command line; those of this process by default.
        short: short options, such as -n, each with the name of its parameter.
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
        for option, parameter in short:
            parser.add_argument(option, dest=parameter, metavar=parameter.upper())
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


@contextlib.contextmanager
def progress(
    title: str,
    total: int,
    tell: Tell,
    done: int = 0,
    unit: str = "cell",
    things: str = "",
    counts: Callable[[], str] = str,
) -> Iterator[Callable[[], None]]:
    """Show the progress of work: a bar on a terminal, at most `LINES` lines elsewhere.

    Yields a function to call after each unit of work.

    Args:
        title: of the bar.
        total: number of units.
        tell: prints a line.
        done: number of units that were done before.
        unit: name of a unit, for the bar.
        things: name of the units in the lines, with a space before it; may be empty.
        counts: returns a summary of the units that are done.
    """
    with tqdm(total=total, initial=done, unit=unit, desc=title, disable=None) as bar:

        def note() -> None:
            nonlocal done
            done += 1
            bar.update()
            if not bar.disable:
                bar.set_postfix_str(counts())
            elif done * LINES // total > (done - 1) * LINES // total:
                tell(", ".join(filter(None, (f"{done} of {total}{things} done", counts()))))

        if not bar.disable:
            bar.set_postfix_str(counts())
        yield note


@contextlib.contextmanager
def whole_results(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder; move the files from it into `folder` when all are written.

    If anything fails before that, `folder` keeps its earlier results.

    Raises:
        FileError: a file cannot be written.
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


def write_table(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write rows, the header first, as CSV; None becomes an empty entry."""
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
