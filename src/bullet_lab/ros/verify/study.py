"""Runs every job twice at its smallest size and compares both results, also with references.

Example:
    scripts/run.sh verify jobs:="squares dock"
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Mapping, NoReturn, Optional, Sequence, Tuple

from bullet_lab.core.files import write_json
from bullet_lab.core.parameters import boolean, choice, integer, name_list
from bullet_lab.errors import LabError
from bullet_lab.ros.launcher.jobs import Job, choose_job, find_jobs, read_assignments
from bullet_lab.ros.launcher.output import tied
from bullet_lab.ros.verify.fingerprints import WALL_CLOCK_KEYS, Fingerprint
from bullet_lab.simulation.world.resources import package_share
from bullet_lab.studies.study import (
    SUMMARY,
    Settings,
    Tell,
    UnfinishedError,
    progress,
    run_from,
    whole_results,
    write_table,
)

NAME = "verify"
TABLE = "verify.csv"
REFERENCES = "data/verify.json"
TOLERANCE = 1e-6
"""Largest `Fingerprint.difference` from a reference that counts as WITHIN."""

PICTURE_TOLERANCE = 1.0
"""The same for pictures: grey levels, in mean and standard deviation of each channel."""

TOLERANCES = {"published_noise": 0.0}
"""Jobs with a tolerance that differs; 0: the bytes must be the same, except in pictures."""

LEFT_OUT = {"save_world": ("path", "saving_s")}
"""Jobs with JSON keys that are not compared, besides WALL_CLOCK_KEYS: a path, a wall time."""

LONGEST = 900.0
"""Wall seconds after which a job is killed."""

PROCESSORS: Dict[str, Dict[str, str]] = {
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

_ROS_PACKAGES = ("ROS_PACKAGE_PATH", "ROS_ROOT", "ROS_ETC_DIR", "ROS_VERSION", "ROS_DISTRO")
_POLL_PERIOD = 0.05
# Wall seconds; the launcher needs as long to stop its nodes.
_STOP_TIMEOUT = 5.0

Results = Mapping[str, Fingerprint]
"""The results of one run of a job: fingerprints by the names of the files."""


class ReferencesError(LabError):
    """The file of references cannot be read."""


@dataclass(frozen=True)
class VerifySettings(Settings):
    """Parameters of the job."""

    jobs: Tuple[str, ...] = name_list("jobs with spaces between them; empty: all of them")
    processor: str = choice(
        "this",
        "computes as this processor does, or as a plain one without AVX and FMA would",
        tuple(PROCESSORS),
    )
    renew: bool = boolean(False, "make what comes out the references, instead of comparing")
    workers: int = integer(0, "jobs at a time; 0: one for each core", 0, 64)


@dataclass(frozen=True)
class References:
    """Results from another machine or another day.

    Attributes:
        machine: processor and library versions there, as `this_machine` returns them.
        files: results by the name of the job.
    """

    machine: Mapping[str, str]
    files: Mapping[str, Results]

    @staticmethod
    def read(path: Path) -> References:
        """Read a file of references; raise ReferencesError."""
        try:
            kept = json.loads(path.read_text())
            files = {
                job: {name: Fingerprint(**entry) for name, entry in results.items()}
                for job, results in kept["files"].items()
            }
            return References(kept["machine"], files)
        except (OSError, ValueError, TypeError, LookupError, AttributeError) as error:
            raise ReferencesError(f"cannot use {path}: {error}") from error

    def write(self, path: Path) -> None:
        """Write the file; raise FileError."""
        files = {
            job: {name: asdict(entry) for name, entry in sorted(results.items())}
            for job, results in sorted(self.files.items())
        }
        write_json(path, {"machine": self.machine, "files": files})

    def elsewhere(self) -> List[str]:
        """Return a line for each property in which this machine differs from the reference's."""
        return [
            f"{name}: {mine} (reference: {self.machine.get(name, 'unknown')})"
            for name, mine in this_machine().items()
            if self.machine.get(name) != mine
        ]


@dataclass(frozen=True)
class Row:
    """The comparison of one result file.

    Attributes:
        job: its job.
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
    difference: Optional[float] = None
    where: str = ""

    @property
    def good(self) -> bool:
        """Whether the result repeats; a missing reference is no failure."""
        return self.twice and self.reference != DIFFERS


@dataclass(frozen=True)
class Run:
    """One run of a job, with arguments such as n:=2, into a folder."""

    job: str
    arguments: Sequence[str]
    folder: Path

    @property
    def log(self) -> Path:
        """The file with the output of the job."""
        return self.folder.with_suffix(".log")

    def start(self, processor: str) -> subprocess.Popen:
        """Start the job; it ends when this process ends."""
        # `verify` itself is a node, whose master the job must not join.
        kept = {n: v for n, v in os.environ.items() if n[:4] != "ROS_" or n in _ROS_PACKAGES}
        launcher = (sys.executable, "-m", "bullet_lab.ros.launcher")
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("wb") as log:
            return subprocess.Popen(
                tied(*launcher, self.job, *self.arguments, f"out:={self.folder}"),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**kept, **PROCESSORS[processor]},
            )

    def last_line(self) -> str:
        """Return the last line of the job's output that is not empty."""
        lines = self.log.read_text(errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), "")


def run_all(
    runs: Sequence[Run], at_once: int, processor: str, note: Callable[[], None]
) -> List[int]:
    """Run jobs, calling `note` at each end; return their exit statuses in the order of `runs`."""
    waiting = list(reversed(runs))
    running: Dict[Path, Tuple[subprocess.Popen, float]] = {}
    statuses: Dict[Path, int] = {}
    try:
        while waiting or running:
            while waiting and len(running) < at_once:
                run = waiting.pop()
                running[run.folder] = run.start(processor), time.monotonic() + LONGEST
            time.sleep(_POLL_PERIOD)
            for folder, (process, deadline) in list(running.items()):
                if time.monotonic() > deadline:
                    process.kill()
                    process.wait()
                if process.poll() is not None:
                    del running[folder]
                    statuses[folder] = process.returncode
                    note()
    finally:
        _stop([process for process, _ in running.values()])
    return [statuses[run.folder] for run in runs]


def _stop(processes: Sequence[subprocess.Popen]) -> None:
    for process in processes:
        process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + _STOP_TIMEOUT
    for process in processes:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(max(0.0, deadline - time.monotonic()))
        process.kill()
        process.wait()


def _run(out: Path, settings: VerifySettings, tell: Tell) -> None:
    package = package_share()
    known = find_jobs(package)
    jobs = [choose_job(known, name) for name in settings.jobs or known if name != NAME]
    references = References.read(package / REFERENCES)
    with whole_results(out) as part:
        found, rows = _run_twice(jobs, settings, part, tell)
        for name, (first, second) in found.items():
            rows += compared(name, first, second, references.files.get(name, {}))
        _write(part, settings, rows, references)
    for line in [*table(rows), *references.elsewhere()]:
        print(line, flush=True)
    if settings.renew:
        _renew(package / REFERENCES, references, {n: first for n, (first, _) in found.items()})
        tell(f"new references written to {REFERENCES}")
    bad = [row for row in rows if not row.good and not (settings.renew and row.twice)]
    if bad:
        raise UnfinishedError(
            f"{len(bad)} of {len(rows)} results differ between two runs or from the reference"
        )
    tell(f"all {len(rows)} results repeat")


def _run_twice(
    jobs: Sequence[Job], settings: VerifySettings, part: Path, tell: Tell
) -> Tuple[Dict[str, Tuple[Results, Results]], List[Row]]:
    """Run each job twice; return both results of each job, and a row for each that failed."""
    runs = []
    for job in jobs:
        arguments = shlex.split(job.smallest)
        read_assignments(job, arguments)
        for which in ("first", "second"):
            runs.append(Run(job.name, arguments, part / "runs" / job.name / which))
    at_once = settings.workers or len(os.sched_getaffinity(0))
    with progress("verifying", len(runs), tell, unit="run", things=" runs") as note:
        statuses = run_all(runs, at_once, settings.processor, note)
    found: Dict[str, Tuple[Results, Results]] = {}
    failed = []
    for first, second, *status in zip(runs[::2], runs[1::2], statuses[::2], statuses[1::2]):
        if any(status):
            line = (first if status[0] else second).last_line()
            failed.append(Row(first.job, f"status {max(status, key=abs)}: {line}", False))
        else:
            found[first.job] = _results(first), _results(second)
    return found, failed


def _results(run: Run) -> Results:
    shutil.rmtree(run.folder / "log", ignore_errors=True)
    run.log.unlink()
    keys = (*WALL_CLOCK_KEYS, *LEFT_OUT.get(run.job, ()))
    files = sorted(path for path in run.folder.rglob("*") if path.is_file())
    return {str(path.relative_to(run.folder)): Fingerprint.of(path, keys) for path in files}


def compared(job: str, first: Results, second: Results, references: Results) -> Iterator[Row]:
    """Compare the results of two runs with each other, and those of the first with references."""
    for name in sorted({*first, *second, *references}):
        mine, theirs = first.get(name), references.get(name)
        twice = mine is not None and mine == second.get(name)
        if mine is None or theirs is None:
            yield Row(job, name, twice, NONE if mine else DIFFERS)
            continue
        difference, where = mine.difference(theirs)
        is_picture = name.endswith(".png")
        tolerance = PICTURE_TOLERANCE if is_picture else TOLERANCES.get(job, TOLERANCE)
        near = tolerance > 0.0 and mine.numbers and difference <= tolerance
        reference = SAME if mine.hash == theirs.hash else WITHIN if near else DIFFERS
        yield Row(job, name, twice, reference, difference, where)


def table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the lines of the table that is printed."""
    cells = [("job", "file", "twice", "reference", "largest difference")]
    for row in rows:
        twice = "same" if row.twice else "DIFFERS"
        reference = DIFFERS.upper() if row.reference == DIFFERS else row.reference
        off = f"{row.difference:.1e} of {row.where}" if row.difference else ""
        cells.append((row.job, row.file, twice, reference, off))
    widths = [max(len(line[i]) for line in cells) for i in range(4)]
    for *line, off in cells:
        padded = (cell.ljust(width) for cell, width in zip(line, widths))
        yield "  ".join([*padded, off]).rstrip()


def _write(part: Path, settings: VerifySettings, rows: Sequence[Row], known: References) -> None:
    entries = [asdict(row) for row in rows]
    write_table(part / TABLE, [Row.__annotations__, *(entry.values() for entry in entries)])
    for entry in entries:
        # JSON has no infinity.
        if entry["difference"] == math.inf:
            entry["difference"] = None
    summary = {
        "job": NAME,
        "processor": settings.processor,
        "as_promised": all(row.good for row in rows),
        "results": len(rows),
        "differ_between_two_runs": sum(not row.twice for row in rows),
        "reference": dict(Counter(row.reference for row in rows)),
        "machine": this_machine(),
        "machine_of_references": known.machine,
        "rows": entries,
    }
    write_json(part / SUMMARY, summary)


def _renew(path: Path, old: References, found: Mapping[str, Results]) -> None:
    """Write new references; keep those of other jobs if they are from a machine like this one."""
    machine = this_machine()
    kept = old.files if machine == old.machine else {}
    References(machine, {**kept, **found}).write(path)


def this_machine() -> Dict[str, str]:
    """Return the properties of this machine that results may depend on, by their names."""
    return {
        "architecture": platform.machine(),
        **_processor(),
        "libc": " ".join(platform.libc_ver()),
        "python": platform.python_version(),
        **{name: _version(name) for name in _LIBRARIES},
    }


def _processor() -> Dict[str, str]:
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return {}
    model = re.search(r"^model name\s*: (.*)", text, re.MULTILINE)
    flags = re.search(r"^flags\s*: (.*)", text, re.MULTILINE)
    known = flags[1].split() if flags else ()
    features = " ".join(one for one in _FEATURES if one in known)
    return {"processor": model[1] if model else "unknown", "features": features or "none"}


def _version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "not installed"


def main(words: Optional[Sequence[str]] = None) -> NoReturn:
    """Run the study from the command line; see `run_from`."""
    run_from(NAME, __doc__, (VerifySettings,), _run, words)


if __name__ == "__main__":
    main()
