"""One way for all studies: command line, exit status, progress and results that are whole.

A study has settings, frozen dataclasses whose parameters `core.parameters` declares, and a
function that takes them. `run_from` makes a program of the two.
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

from bullet_lab.core.files import PART, FileError, make_folder
from bullet_lab.core.parameters import ArgumentParser, add_options, check_parameters, read_options
from bullet_lab.entry import STATUS_INTERRUPTED
from bullet_lab.errors import LabError

SUMMARY = "summary.json"
STATUS_UNFINISHED = 1
STATUS_BAD_INPUT = 2
MOST_SEED = 2**63 - 1
LINES = 10
"""So many lines tell of the progress where there is no terminal."""

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Settings:
    """Parameters of a study; those made in Python are checked as well, with ParameterError."""

    def __post_init__(self) -> None:  # noqa: D105 - see the class
        check_parameters(self)


class UnfinishedError(LabError):
    """What was asked for makes sense, but has not been done."""


def silent(line: str) -> None:
    """Tell nobody."""


def run_from(
    name: str,
    about: Optional[str],
    settings: Sequence[Type],
    run: Callable[..., None],
    words: Optional[Sequence[str]] = None,
    short: Sequence[Tuple[str, str]] = (),
) -> NoReturn:
    """Run a study from the command line, and exit: 0 done, 1 unfinished, 2 bad input, 130 stopped.

    Args:
        name: of the program, in front of all that it says.
        about: its first line tells what it does.
        settings: dataclasses with the parameters; an option of the command line for each.
        run: gets the folder for the results, the settings, one for each of the classes, and
            what tells a line of text; raises LabError.
        words: of the command line; those of this process by default.
        short: other options, such as -n, and the parameters that they give.
    """
    words = sys.argv[1:] if words is None else words
    status = 0
    try:
        interrupt_once()
        parser = ArgumentParser(prog=name, description=(about or "").split("\n")[0])
        parser.add_argument("out", type=Path, help="folder for the results")
        for kind in settings:
            add_options(parser, kind)
        for option, parameter in short:
            parser.add_argument(option, dest=parameter, metavar=parameter.upper())
        # roslaunch adds its own: __name:=… and __log:=…
        values = vars(parser.parse_args([w for w in words if not re.match(r"__\w+:=", w)]))
        read = [read_options(kind, values) for kind in settings]
        run(values["out"], *read, lambda line: print(f"{name}: {line}", flush=True))
    except LabError as error:
        print(f"{name}: {error}", file=sys.stderr, flush=True)
        status = STATUS_UNFINISHED if isinstance(error, UnfinishedError) else STATUS_BAD_INPUT
    except KeyboardInterrupt:
        status = STATUS_INTERRUPTED
    # Python takes handlers away before it is at its end: what comes after that would kill it.
    _ignore_interrupts()
    sys.exit(status)


def interrupt_once() -> None:
    """Have the first SIGINT or SIGTERM raise KeyboardInterrupt, and ignore those that follow.

    What is cleared away then shall not be interrupted in its turn; whoever stops a job may send
    both, one right after the other.
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
    """Show how far work is: a bar on a terminal, some lines elsewhere. Call what it provides.

    Args:
        title: of the bar.
        total: how much there is to do.
        tell: gets the lines.
        done: how much of it has been done before.
        unit: of the work, for the bar.
        things: their name in the lines, with a space before it; may be empty.
        counts: says what came of those that are done.
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
    """Yield a folder for results, which are put into their place only when all are there.

    If anything fails meanwhile, the results that were there before still are.

    Raises:
        FileError: a file cannot be written.
    """
    make_folder(folder)
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=PART) as name:
            part = Path(name)
            yield part
            files = [path.relative_to(part) for path in sorted(part.rglob("*")) if path.is_file()]
            # The summary says that all is there.
            for file in sorted(files, key=lambda path: path.name == SUMMARY):
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                (part / file).replace(folder / file)
    except OSError as error:
        raise FileError(f"cannot write to {folder}: {error.strerror or error}") from error


def write_table(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write rows, the header among them, as CSV; an entry that is None is left empty."""
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
