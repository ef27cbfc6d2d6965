"""Mutates what comes in from outside and looks at what becomes of it; see scripts/fuzz.sh.

Ways are taken by turns, each mutant in a worker that may die of it. A failure leaves its input
in the results' folder, beside the command that repeats it.
--minutes N: so long; or --mutants N: so many, 1000 if neither is given. --first K: number of the
first mutant. --each N: mutants of a way's share before the next one.
"""

import itertools
import math
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from mutations import generator, mutant
from tqdm import tqdm
from ways import WAYS

from bullet_lab.core.files import write_json

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
from lab_nodes import parser_of  # noqa: E402

# Wall seconds for a worker to come up, and for each mutant on average, on a busy machine too.
PATIENCE, PATIENCE_EACH = 60.0, 1.0
# Mutants of a way's share in a round.
ROUND = 10


class Failure(NamedTuple):
    """A mutant that has failed, why, and how to see it again."""

    way: str
    seed: int
    number: int
    why: str

    @property
    def command(self):
        """Return the command that repeats it."""
        which = f"--way {self.way} --seed {self.seed} --first {self.number}"
        return f"scripts/fuzz.sh {which} --mutants 1"


class Batch(NamedTuple):
    """So many mutants of one way, from a number on."""

    way: str
    first: int
    count: int


def try_all(batches, seed, folder):
    """Try batches of mutants, in as many workers as it takes; return the failures."""
    failures = []
    left = list(batches)
    while left:
        place, number, found = _one_worker(left, seed, folder)
        failures += found
        if number < 0:
            raise SystemExit(f"fuzz: {found[-1].why}")
        way, first, count = left[place]
        rest = first + count - number - 1
        left = [Batch(way, number + 1, rest)] * (rest > 0) + left[place + 1 :]
    return failures


def _one_worker(batches, seed, folder):
    """Return the place of the batch and the number of the last mutant, and the failures."""
    words = [f"{way}:{first}:{count}" for way, first, count in batches]
    patience = PATIENCE + PATIENCE_EACH * sum(batch.count for batch in batches)
    why = ""
    try:
        done = subprocess.run(
            [sys.executable, str(HERE / "worker.py"), str(seed), str(folder), *words],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=patience,
        )
        out = done.stdout
        if done.returncode:
            said = done.stderr.decode(errors="replace").strip().split("\n")[-1]
            # Less than 0: the number of a signal.
            why = f"status {done.returncode}: {said}"
    except subprocess.TimeoutExpired as error:
        out, why = error.stdout or b"", f"no end after {patience:g} s"
    place, number, failures = 0, -1, []
    for line in out.decode(errors="replace").splitlines():
        if line.startswith("!"):
            failures.append(Failure(batches[place].way, seed, number, line[2:].strip()))
        else:
            place, number = map(int, line.split())
    if why:
        failures.append(Failure(batches[place].way, seed, number, why))
    return place, number, failures


def keep(failure, folder):
    """Leave the input of a failure, and how to repeat it."""
    way = WAYS[failure.way]
    data = mutant(list(way.seeds()), generator(failure.seed, failure.way, failure.number))
    name = f"{failure.way}-{failure.seed}-{failure.number}"
    (folder / f"{name}{way.suffix}").write_bytes(data)
    with (folder / "failures.txt").open("a") as file:
        file.write(f"{failure.command}\n    {failure.why}\n")


def rounds(wanted):
    """Yield which mutants to try, until there are as many as wanted, or without end."""
    ways = [wanted.way] if wanted.way else list(WAYS)
    left = wanted.mutants or math.inf
    for number in itertools.count():
        batches = []
        for way in ways:
            usual = wanted.each * WAYS[way].share
            count = int(min(usual, left))
            left -= count
            if count:
                batches.append(Batch(way, wanted.first + number * usual, count))
        if not batches:
            return
        yield batches


def fuzz(wanted, folder):
    """Fuzz for as long as is wanted; return the summary."""
    tried = dict.fromkeys(WAYS, 0)
    failures = []
    lock = threading.Lock()
    start = time.monotonic()
    todo = rounds(wanted)
    bar = tqdm(total=wanted.mutants or None, unit=" mutants", disable=not sys.stderr.isatty())

    def work():
        while True:
            with lock:
                late = wanted.minutes and time.monotonic() - start > 60.0 * wanted.minutes
                batches = () if late else next(todo, ())
            if not batches:
                return
            found = try_all(batches, wanted.seed, folder)
            with lock:
                for batch in batches:
                    tried[batch.way] += batch.count
                    bar.update(batch.count)
                failures.extend(found)
                for failure in found:
                    keep(failure, folder)
                    tqdm.write(f"{failure.way} {failure.number}: {failure.why}")

    with bar, ThreadPoolExecutor(wanted.workers) as pool:
        for one in [pool.submit(work) for _ in range(wanted.workers)]:
            one.result()
    return {
        "seed": wanted.seed,
        "mutants": sum(tried.values()),
        "by_way": tried,
        "failures": [{**one._asdict(), "command": one.command} for one in failures],
        "seconds": round(time.monotonic() - start, 1),
    }


def main():
    """Fuzz, print and write results/fuzz/summary.json; status 1 where something failed."""
    parser = parser_of(
        "fuzz.sh",
        __doc__,
        seed=1,
        minutes=0.0,
        mutants=0,
        first=0,
        each=ROUND,
        workers=os.cpu_count(),
        out=Path("results/fuzz"),
    )
    parser.add_argument("--way", choices=sorted(WAYS), help="this way in only")
    wanted = parser.parse_args()
    if not wanted.minutes and not wanted.mutants:
        wanted.mutants = 1000
    wanted.out.mkdir(parents=True, exist_ok=True)
    summary = fuzz(wanted, wanted.out.absolute())
    write_json(wanted.out / "summary.json", summary)
    failures = len(summary["failures"])
    print(f"{summary['mutants']} mutants, {failures} failures; see {wanted.out}")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
