"""Runs jobs, injects a fault into each, and checks how it ends; see scripts/faults.sh.

results/faults/faults.jsonl lists the faults that were tried; they are not tried again with the
same seed. A failure leaves its folder there, and the command that repeats it.
--count N: number of faults, from the index --first on.
"""

import json
import shutil
import signal
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from kinds import JOBS, KINDS, PACKAGE, drawn
from tqdm import tqdm
from trial import Trial

from bullet_lab.core.files import write_json

sys.path.append(str(PACKAGE / "test"))
from lab_nodes import parser_of  # noqa: E402

RECORD = "faults.jsonl"


def known(record, seed):
    """Return the outcomes of the faults that were tried with a seed before, by their index."""
    if not record.is_file():
        return {}
    rows = map(json.loads, record.read_text().splitlines())
    return {row["index"]: row for row in rows if row["seed"] == seed}


def tried(fault, out):
    """Try a fault and return its outcome; keep its folder if something is wrong."""
    folder = out / f"{fault.seed}-{fault.index}"
    shutil.rmtree(folder, ignore_errors=True)
    outcome = Trial(fault, folder).run()
    if not outcome.wrong:
        shutil.rmtree(folder)
    command = f"scripts/faults.sh --seed {fault.seed} --only {fault.index}"
    return {**asdict(fault), **asdict(outcome), "command": command}


def summary_of(rows):
    """Count the faults that were tried; those that came after the end of the job do not count."""
    struck = [row for row in rows if row["struck"]]
    return {
        "tried": len(rows),
        "struck": len(struck),
        "by_job": Counter(row["job"] for row in struck),
        "by_kind": Counter(row["kind"] for row in struck),
        "failures": [row["command"] for row in rows if row["wrong"]],
    }


def main():
    """Try faults, print and write results/faults/summary.json; exit with status 1 on a failure."""
    out = Path("results/faults")
    parser = parser_of("faults.sh", __doc__, count=200, seed=1, first=0, out=out)
    parser.add_argument("--only", type=int, help="the fault of this index, even if it was tried")
    parser.add_argument("--job", choices=JOBS, help="this job only")
    parser.add_argument("--kind", choices=sorted(KINDS), help="this kind only")
    wanted = parser.parse_args()
    # A shell ignores it in background jobs, and the processes started here would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    out = wanted.out.absolute()
    out.mkdir(parents=True, exist_ok=True)
    # An index means the same fault, whichever others are left out.
    indices = range(wanted.first, wanted.first + wanted.count)
    before = known(out / RECORD, wanted.seed)
    if wanted.only is not None:
        indices, before = range(wanted.only, wanted.only + 1), {}
    faults = [drawn(wanted.seed, index) for index in indices]
    faults = [f for f in faults if wanted.job in (None, f.job) and wanted.kind in (None, f.kind)]
    rows = [before[fault.index] for fault in faults if fault.index in before]
    left = [fault for fault in faults if fault.index not in before]
    bar = tqdm(left, unit=" faults", initial=len(rows), total=len(faults), disable=None)
    for fault in bar:
        row = tried(fault, out)
        rows.append(row)
        with (out / RECORD).open("a") as file:
            file.write(json.dumps(row) + "\n")
        if row["wrong"]:
            tqdm.write(f"{fault}: {'; '.join(row['wrong'])}\n    {row['command']}")
    summary = summary_of(rows)
    write_json(out / "summary.json", summary)
    failed = len(summary["failures"])
    print(f"{summary['tried']} faults, {summary['struck']} in time, {failed} failures; see {out}")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
