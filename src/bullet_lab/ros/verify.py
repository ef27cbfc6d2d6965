"""Runs every job twice at its smallest size and compares both results, also with references.

Results are compared by fingerprints: each file as a hash and a few numbers, small enough for a
repository.

Example:
    scripts/run.sh verify jobs:="squares dock"
"""

from __future__ import annotations

import contextlib
import csv
import functools
import hashlib
import json
import math
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Iterable, Iterator, Mapping, Sequence

import numpy as np
from PIL import Image

from bullet_lab.core.files import write_json
from bullet_lab.core.parameters import boolean, choice, integer, name_list
from bullet_lab.errors import LabError
from bullet_lab.jobs.declaration import Job, choose_job, find_jobs
from bullet_lab.ros.launcher.output import environment_without_ros, tied
from bullet_lab.simulation.world.resources import package_share
from bullet_lab.studies.study import (
    SUMMARY,
    Settings,
    Tell,
    UnfinishedError,
    progress,
    run_from,
    text_table,
    whole_results,
    write_table,
)

NAME = "verify"
TABLE = "verify.csv"
REFERENCES = "data/verify.json"
TOLERANCE = 1e-6
"""Largest `difference` from a reference that counts as WITHIN."""

PICTURE_TOLERANCE = 1.0
"""The same for pictures: grey levels, in mean and standard deviation of each channel."""

TOLERANCES = {"published_noise": 0.0}
"""Jobs with a tolerance that differs; 0: the bytes must be the same, except in pictures."""

UNREPEATABLE = (NAME, "grade")
"""Jobs that are not run: itself, and submissions, which are not in lock step."""

LEFT_OUT = {"save_world": ("path", "saving_s")}
"""Jobs with JSON keys that are not compared, besides WALL_CLOCK_KEYS: a path, a wall time."""

WALL_CLOCK_KEYS = ("wall_time_s", "real_time_factor")
"""Keys of JSON files whose values depend on the speed of the run; they are left out."""

MOST_COLUMNS = 100
"""A table with more columns, such as a laser's, is summarized as one column."""

LONGEST = 900.0
"""Wall seconds after which a job is killed."""

PROCESSORS: dict[str, dict[str, str]] = {
    "this": {},
    # An x86-64 of 2006: libraries that look at the processor believe that it has no more.
    "plain": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable,-FMA4_Usable",
        "NPY_DISABLE_CPU_FEATURES": "SSE41 POPCNT SSE42 AVX F16C FMA3 AVX2 AVX512F AVX512CD"
        " AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR",
        "OPENBLAS_CORETYPE": "Prescott",
        "OPENCV_CPU_DISABLE": "SSE4.1,SSE4.2,AVX,FP16,FMA3,AVX2,AVX512-SKX",
        "OPENCV_IPP": "disabled",
        "LP_NATIVE_VECTOR_WIDTH": "128",
        "GALLIUM_OVERRIDE_CPU_CAPS": "sse3",
    },
}
"""Environment variables that make libraries compute as they do on another processor."""

SAME, WITHIN, DIFFERS, NONE = "same", "within", "differs", "none"
_FEATURES = ("avx", "avx2", "avx512f", "fma")
_LIBRARIES = (
    *("matplotlib", "numpy", "opencv-python-headless", "panda3d", "Pillow", "pybullet"),
    *("scipy", "trimesh"),
)

_DIGITS = 9
_HASH_DIGITS = 16
_TUM = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")



Fingerprint = Mapping[str, Any]
"""A summary of a result file, as in the file of references.

It has the "hash" of the bytes (of JSON, without the keys that are left out), and "numbers" by their
names, to nine digits. For tables: row count, mean and standard deviation of each column. For JSON:
each number, and each list as a column. For pictures: width, height, mean and standard deviation of
each channel. For other files: all their numbers as one column.
"""


def fingerprint(path: Path, left_out: Sequence[str] = WALL_CLOCK_KEYS) -> Fingerprint:
    """Return the fingerprint of a file; LabError: it cannot be read, or does not fit its suffix."""
    try:
        content, columns = _content(path, left_out)
    except (OSError, ValueError, csv.Error) as error:
        raise LabError(f"cannot read {path}: {error}") from error
    numbers = _summary(columns).items()
    rounded = {name: float(f"{value:.{_DIGITS}g}") for name, value in numbers}
    return {"hash": hashlib.sha256(content).hexdigest()[:_HASH_DIGITS], "numbers": rounded}


def difference(numbers: Mapping[str, float], reference: Mapping[str, float]) -> tuple[float, str]:
    """Return the largest difference from the numbers of a reference, and that number's name.

    Differences are relative for numbers beyond 1, absolute below, and infinite for a number that
    only one of the two has.

    >>> difference({"x": 2.5, "y": 0.1}, {"x": 2.0, "y": 0.0})
    (0.25, 'x')
    >>> difference({"x": 2.5, "y": 0.1}, {"x": 2.5})
    (inf, 'y')
    """
    differences = [(0.0, "")]
    for name in {*numbers, *reference}:
        off = math.inf
        if name in numbers and name in reference:
            off = abs(numbers[name] - reference[name]) / max(1.0, abs(reference[name]))
        differences.append((off, name))
    return max(differences)


def _content(path: Path, left_out: Sequence[str]) -> tuple[bytes, dict[str, Iterable[Any]]]:
    """Return the bytes of a file that are hashed, and its columns by their names."""
    data = path.read_bytes()
    if path.suffix == ".png":
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB"), dtype=float).reshape(-1, 3)
            size = {"width": [image.width], "height": [image.height]}
        return data, {**size, **dict(zip(("red", "green", "blue"), pixels.T))}
    text = data.decode(errors="replace")
    if path.suffix == ".csv":
        header, *rows = csv.reader(text.splitlines())
        return data, dict(zip(header, zip(*rows)))
    if path.suffix == ".tum":
        return data, dict(zip(_TUM, zip(*map(str.split, text.splitlines()))))
    if path.suffix not in (".json", ".jsonl"):
        return data, {"numbers": _NUMBER.findall(text)}

    def without(value: dict[str, Any]) -> dict[str, Any]:
        return {key: entry for key, entry in value.items() if key not in left_out}

    texts = text.splitlines() if path.suffix == ".jsonl" else [text]
    values = [json.loads(entry, object_hook=without) for entry in texts]
    columns: dict[str, list[float]] = {}
    for name, number in _leaves(values, ""):
        columns.setdefault(name, []).append(number)
    return json.dumps(values).encode(), columns


def _leaves(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _leaves(entry, f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        for entry in value:
            yield from _leaves(entry, name)
    elif isinstance(value, (int, float)):
        yield name, float(value)


def _summary(columns: Mapping[str, Iterable[Any]]) -> dict[str, float]:
    """Summarize columns by their names; ignore entries that are not finite numbers."""
    if len(columns) > MOST_COLUMNS:
        columns = {"all columns": [entry for column in columns.values() for entry in column]}
    numbers: dict[str, float] = {}
    for name, column in columns.items():
        entries = [number for number in map(_number, column) if math.isfinite(number)]
        if len(entries) == 1:
            numbers[name] = entries[0]
        elif entries:
            numbers[f"{name} count"] = len(entries)
            numbers[f"{name} mean"] = float(np.mean(entries))
            numbers[f"{name} std"] = float(np.std(entries))
    return numbers


def _number(entry: Any) -> float:
    try:
        return float(entry)
    except ValueError:
        return math.nan


Results = Mapping[str, Fingerprint]
"""The results of one run of a job: fingerprints by the names of the files."""


@dataclass(frozen=True)
class VerifySettings(Settings):
    """Parameters of the job."""

    jobs: tuple[str, ...] = name_list("jobs with spaces between them; empty: all of them")
    processor: str = choice(
        "this",
        "computes as this processor does, or as a plain one without AVX and FMA would",
        tuple(PROCESSORS),
    )
    renew: bool = boolean(False, "make what comes out the references, instead of comparing")
    workers: int = integer(0, "jobs at a time; 0: one for each core", 0, 64)


def read_references(path: Path) -> tuple[Mapping[str, str], dict[str, Results]]:
    """Return the machine of the references, as `this_machine`, and their results by job.

    Raises LabError for a file that cannot be used.
    """
    try:
        kept = json.loads(path.read_text())
        return kept["machine"], kept["files"]
    except (OSError, ValueError, TypeError, LookupError) as error:
        raise LabError(f"cannot use {path}: {error}") from error


@dataclass(frozen=True)
class FileRow:
    """The comparison of one result file.

    Attributes:
        file: its name; for a job that failed, its status and the last line of its output.
        twice: whether both runs wrote the same bytes.
        reference: SAME bytes, WITHIN the tolerance, DIFFERS, or NONE: there is no reference.
        difference: largest difference from the numbers of the reference, if there is one.
        where: the name of the number with that difference.
    """

    job: str
    file: str
    twice: bool
    reference: str = NONE
    difference: float | None = None
    where: str = ""

    @property
    def good(self) -> bool:
        """Whether the result repeats; a missing reference is no failure."""
        return self.twice and self.reference != DIFFERS


def run_job(job: Job, folder: Path, environment: Mapping[str, str]) -> Results | str:
    """Run a job; return its results, or its status and its last line if it failed."""
    # It ends when this process ends, and gets the signals of this process group.
    command = tied(sys.executable, "-m", "bullet_lab.ros.launcher", job.name)
    log = folder.with_suffix(".log")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as output, contextlib.suppress(subprocess.TimeoutExpired):
        status: Any = f"none after {LONGEST:g} s"
        status = subprocess.run(
            [*command, *shlex.split(job.smallest), f"out:={folder}"],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=environment,
            timeout=LONGEST,
        ).returncode
    if status != 0:
        lines = log.read_text(errors="replace").split("\n")
        last = next((line for line in reversed(lines) if line.strip()), "")
        return f"status {status}: {last}"
    shutil.rmtree(folder / "log", ignore_errors=True)
    log.unlink()
    keys = (*WALL_CLOCK_KEYS, *LEFT_OUT.get(job.name, ()))
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): fingerprint(path, keys) for path in paths}


def _run(out: Path, settings: VerifySettings, tell: Tell) -> None:
    package = package_share()
    known = {name: job for name, job in find_jobs(package).items() if name not in UNREPEATABLE}
    jobs = [choose_job(known, name) for name in settings.jobs or known]
    machine, references = read_references(package / REFERENCES)
    with whole_results(out) as part:
        todo = [(job, part / "runs" / job.name / w) for job in jobs for w in ("first", "second")]
        environment = {**environment_without_ros(), **PROCESSORS[settings.processor]}
        with ThreadPoolExecutor(settings.workers or len(os.sched_getaffinity(0))) as pool:
            runs = pool.map(lambda one: run_job(*one, environment), todo)
            found = list(progress(runs, "runs", len(todo), tell))
        rows: list[FileRow] = []
        results: dict[str, Results] = {}
        for job, *both in zip(jobs, found[::2], found[1::2]):
            failures = [FileRow(job.name, one, False) for one in both if isinstance(one, str)]
            if not failures:
                results[job.name] = both[0]
            rows += failures[:1] or compared(job.name, *both, references.get(job.name, {}))
        _write(part, settings.processor, rows, machine)
    here = this_machine()
    for line in table(rows):
        print(line, flush=True)
    for name in [name for name, mine in here.items() if machine.get(name) != mine]:
        print(f"{name}: {here[name]} (reference: {machine.get(name, 'unknown')})", flush=True)
    if settings.renew:
        # Those of other jobs are kept if they are from a machine like this one.
        files = {**(references if machine == here else {}), **results}
        write_json(package / REFERENCES, {"machine": here, "files": dict(sorted(files.items()))})
        tell(f"new references written to {REFERENCES}")
    bad = [row for row in rows if not row.good and not (settings.renew and row.twice)]
    if bad:
        raise UnfinishedError(
            f"{len(bad)} of {len(rows)} results differ between two runs or from the reference"
        )
    tell(f"all {len(rows)} results repeat")


def compared(job: str, first: Results, second: Results, references: Results) -> Iterator[FileRow]:
    """Compare the results of two runs with each other, and those of the first with references."""
    for name in sorted({*first, *second, *references}):
        mine, theirs = first.get(name), references.get(name)
        twice = mine is not None and mine == second.get(name)
        if mine is None or theirs is None:
            yield FileRow(job, name, twice, NONE if mine else DIFFERS)
            continue
        off, where = difference(mine["numbers"], theirs["numbers"])
        is_picture = name.endswith(".png")
        tolerance = PICTURE_TOLERANCE if is_picture else TOLERANCES.get(job, TOLERANCE)
        near = tolerance > 0.0 and mine["numbers"] and off <= tolerance
        reference = SAME if mine["hash"] == theirs["hash"] else WITHIN if near else DIFFERS
        yield FileRow(job, name, twice, reference, off, where)


def table(rows: Sequence[FileRow]) -> list[str]:
    """Return the lines of the table that is printed."""
    cells = [("job", "file", "twice", "reference", "largest difference")]
    for row in rows:
        twice = "same" if row.twice else "DIFFERS"
        reference = DIFFERS.upper() if row.reference == DIFFERS else row.reference
        off = f"{row.difference:.1e} of {row.where}" if row.difference else ""
        cells.append((row.job, row.file, twice, reference, off))
    return text_table(cells)


def _write(
    part: Path, processor: str, rows: Sequence[FileRow], machine: Mapping[str, str]
) -> None:
    entries = [asdict(row) for row in rows]
    write_table(part / TABLE, entries)
    for entry in entries:
        # JSON has no infinity.
        if entry["difference"] == math.inf:
            entry["difference"] = None
    summary = {
        "job": NAME,
        "processor": processor,
        "as_promised": all(row.good for row in rows),
        "results": len(rows),
        "differ_between_two_runs": sum(not row.twice for row in rows),
        "reference": dict(Counter(row.reference for row in rows)),
        "machine": this_machine(),
        "machine_of_references": machine,
        "rows": entries,
    }
    write_json(part / SUMMARY, summary)


def this_machine() -> dict[str, str]:
    """Return the properties of this machine that results may depend on, by their names."""
    found = {"architecture": platform.machine()}
    with contextlib.suppress(OSError):
        text = Path("/proc/cpuinfo").read_text()
        model, flags = (
            re.search(rf"^{name}\s*: (.*)", text, re.MULTILINE) for name in ("model name", "flags")
        )
        flags = flags[1].split() if flags else ()
        found["processor"] = model[1] if model else "unknown"
        found["features"] = " ".join(one for one in _FEATURES if one in flags) or "none"
    found.update(libc=" ".join(platform.libc_ver()), python=platform.python_version())
    for name in _LIBRARIES:
        found[name] = "not installed"
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


main = functools.partial(run_from, NAME, __doc__, (VerifySettings,), _run)


if __name__ == "__main__":
    main()
