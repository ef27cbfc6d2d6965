"""Runs every job twice at a small size; compares the results with each other, and with references.

Example:
    scripts/run.sh verify jobs:="squares dock"
"""

from __future__ import annotations

import math
import os
import shlex
import shutil
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, NoReturn, Optional, Sequence, Tuple

from bullet_lab.core.files import write_json
from bullet_lab.core.parameters import boolean, choice, integer, name_list
from bullet_lab.ros.launcher.jobs import Job, choose_job, find_jobs, read_assignments
from bullet_lab.ros.verify.fingerprints import OF_THE_CLOCK, Fingerprint
from bullet_lab.ros.verify.references import REFERENCES, Plan, References, this_machine
from bullet_lab.ros.verify.runs import PROCESSORS, Run, run_all
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
TIMES = ("first", "second")
PICTURE_TOLERANCE = 1.0
"""Grey levels that a channel of a picture may be off in its mean or standard deviation."""

SAME, WITHIN, DIFFERS, NONE = "same", "within", "differs", "none"


@dataclass(frozen=True)
class VerifySettings(Settings):
    """What is verified."""

    jobs: Tuple[str, ...] = name_list("jobs with spaces between them; empty: all of them")
    processor: str = choice(
        "this",
        "computes as this processor does, or as a plain one without AVX and FMA would",
        tuple(PROCESSORS),
    )
    renew: bool = boolean(False, "make what comes out the references, instead of comparing")
    workers: int = integer(0, "jobs at a time; 0: one for each core", 0, 64)


@dataclass(frozen=True)
class Row:
    """What became of a result.

    Attributes:
        job: that it is of.
        file: its name; for a job that failed, what it said last.
        twice: whether both runs have the same bytes.
        reference: SAME bytes, WITHIN the tolerance, DIFFERS, or there is NONE.
        difference: largest one from the reference's numbers; None where none are compared.
        where: the number that is of.
    """

    job: str
    file: str
    twice: bool
    reference: str = NONE
    difference: Optional[float] = None
    where: str = ""

    @property
    def good(self) -> bool:
        """Whether it is as promised; what has no reference yet cannot break that."""
        return self.twice and self.reference != DIFFERS


def _run(out: Path, settings: VerifySettings, tell: Tell) -> None:
    package = package_share()
    known = find_jobs(package)
    jobs = [choose_job(known, name) for name in settings.jobs or known if name != NAME]
    plans = {job.name: Plan.of(job.name, package) for job in jobs}
    references = References.read(package / REFERENCES)
    with whole_results(out) as part:
        found, failed = _run_twice(jobs, plans, settings, part, tell)
        rows = [*failed]
        for name, (first, second) in found.items():
            rows += compared(name, plans[name], first, second, references.files.get(name, {}))
        _write(part, settings, rows, references)
    for line in [*table(rows), *references.elsewhere()]:
        print(line, flush=True)
    if settings.renew:
        _renew(package / REFERENCES, references, {n: first for n, (first, _) in found.items()})
        tell(f"{REFERENCES} is written anew")
    bad = [row for row in rows if not row.good and not (settings.renew and row.twice)]
    if bad:
        raise UnfinishedError(f"{len(bad)} of {len(rows)} results are not as promised")
    tell(f"all of {len(rows)} results are as promised")


Found = Dict[str, Fingerprint]


def _run_twice(
    jobs: Sequence[Job],
    plans: Mapping[str, Plan],
    settings: VerifySettings,
    part: Path,
    tell: Tell,
) -> Tuple[Dict[str, Tuple[Found, Found]], List[Row]]:
    """Run each job twice; return what came out by the job, and rows for those that failed."""
    runs = []
    for job in jobs:
        words = shlex.split(plans[job.name].words)
        read_assignments(job, words)
        runs += [Run(job.name, words, part / "runs" / job.name / time) for time in TIMES]
    at_once = settings.workers or len(os.sched_getaffinity(0))
    with progress("verifying", len(runs), tell, unit="run", things=" runs") as note:
        statuses = run_all(runs, at_once, settings.processor, note)
    found: Dict[str, Tuple[Found, Found]] = {}
    failed = []
    for first, second, *status in zip(runs[::2], runs[1::2], statuses[::2], statuses[1::2]):
        if any(status):
            said = (first if status[0] else second).last_line()
            failed.append(Row(first.job, f"status {max(status, key=abs)}: {said}", False))
        else:
            keys = (*OF_THE_CLOCK, *plans[first.job].left_out)
            found[first.job] = (_results(first, keys), _results(second, keys))
    return found, failed


def _results(run: Run, keys: Sequence[str]) -> Found:
    shutil.rmtree(run.folder / "log", ignore_errors=True)
    run.log.unlink()
    files = sorted(path for path in run.folder.rglob("*") if path.is_file())
    return {str(path.relative_to(run.folder)): Fingerprint.of(path, keys) for path in files}


def compared(
    job: str, plan: Plan, first: Found, second: Found, references: Mapping[str, Fingerprint]
) -> Iterator[Row]:
    """Compare the results of two runs with each other, and those of the first with references."""
    for name in sorted({*first, *second, *references}):
        mine, theirs = first.get(name), references.get(name)
        twice = mine is not None and mine == second.get(name)
        if mine is None or theirs is None:
            yield Row(job, name, twice, NONE if mine else DIFFERS)
            continue
        difference, where = mine.difference(theirs)
        tolerance = PICTURE_TOLERANCE if name.endswith(".png") else plan.tolerance
        near = tolerance > 0.0 and mine.numbers and difference <= tolerance
        reference = SAME if mine.hash == theirs.hash else WITHIN if near else DIFFERS
        yield Row(job, name, twice, reference, difference, where)


def table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the lines of a table for people."""
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
    write_table(part / TABLE, [Row.__annotations__, *(asdict(row).values() for row in rows)])
    summary = {
        "job": NAME,
        "processor": settings.processor,
        "as_promised": all(row.good for row in rows),
        "results": len(rows),
        "differ_between_two_runs": sum(not row.twice for row in rows),
        "reference": dict(Counter(row.reference for row in rows)),
        "machine": this_machine(),
        "machine_of_references": known.machine,
        "rows": [_for_json(row) for row in rows],
    }
    write_json(part / SUMMARY, summary)


def _for_json(row: Row) -> Dict[str, Any]:
    # JSON has no infinity.
    off = row.difference
    return {**asdict(row), "difference": off if off is None or math.isfinite(off) else None}


def _renew(path: Path, old: References, found: Mapping[str, Found]) -> None:
    """Write references anew; those of jobs that were not run stay if they are of this machine."""
    machine = this_machine()
    kept = old.files if machine == old.machine else {}
    References(machine, {**kept, **found}).write(path)


def main(words: Optional[Sequence[str]] = None) -> NoReturn:
    """Run the study from the command line; see `run_from`."""
    run_from(NAME, __doc__, (VerifySettings,), _run, words)


if __name__ == "__main__":
    main()
