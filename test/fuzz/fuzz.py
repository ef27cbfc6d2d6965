"""Mutates what comes in from outside and looks at what becomes of it; see scripts/fuzz.sh.

Ways are taken by turns, each mutant in a worker that may die of it. A failure leaves its input
in the results' folder, beside the command that repeats it.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import queue
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Sequence, Tuple

from mutations import generator, mutant
from tqdm import tqdm
from ways import WAYS

HERE = Path(__file__).resolve().parent
# Wall seconds for one mutant, and for a worker to come up; a busy machine is not a hang.
PATIENCE = 60.0
# Mutants of a way's share in a round.
ROUND = 10


@dataclass(frozen=True)
class Failure:
    """A mutant that has failed, why, and how to see it again."""

    way: str
    seed: int
    number: int
    why: str

    @property
    def command(self) -> str:
        """Return the command that repeats it."""
        which = f"--way {self.way} --seed {self.seed} --first {self.number}"
        return f"scripts/fuzz.sh {which} --mutants 1"


@dataclass(frozen=True)
class Batch:
    """So many mutants of one way, from a number on."""

    way: str
    first: int
    count: int

    def after(self, number: int) -> Tuple[Batch, ...]:
        """Return what is left after the mutant of a number: nothing, or one batch."""
        end = self.first + self.count
        return (Batch(self.way, number + 1, end - number - 1),) if number + 1 < end else ()


def try_all(batches: Sequence[Batch], seed: int, folder: Path) -> List[Failure]:
    """Try batches of mutants, in as many workers as it takes."""
    failures: List[Failure] = []
    left = list(batches)
    while left:
        place, number, found = _one_worker(left, seed, folder)
        failures += found
        if number < 0:
            raise SystemExit(f"fuzz: {found[-1].why}")
        left = [*left[place].after(number), *left[place + 1 :]]
    return failures


def _one_worker(
    batches: Sequence[Batch], seed: int, folder: Path
) -> Tuple[int, int, List[Failure]]:
    """Return the place of the batch and the number of the last mutant, and the failures."""
    words = [f"{one.way}:{one.first}:{one.count}" for one in batches]
    process = subprocess.Popen(
        [sys.executable, str(HERE / "worker.py"), str(seed), str(folder), *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
    )
    lines: queue.Queue[str] = queue.Queue()
    errors: List[str] = []
    readers = [
        threading.Thread(target=lambda: [lines.put(line) for line in process.stdout]),
        threading.Thread(target=lambda: errors.extend(process.stderr)),
    ]
    for reader in readers:
        reader.start()
    place, number, failures, why = 0, -1, [], ""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            line = lines.get(timeout=0.1)
        except queue.Empty:
            if process.poll() is not None and not readers[0].is_alive() and lines.empty():
                break
            if time.monotonic() > deadline:
                why = f"no end after {PATIENCE:g} s"
                process.kill()
                deadline = float("inf")
            continue
        deadline = time.monotonic() + PATIENCE
        if line.startswith("!"):
            failures.append(Failure(batches[place].way, seed, number, line[2:].strip()))
        else:
            way, number = line.split()[0], int(line.split()[1])
            place = next(at for at, one in enumerate(batches) if at >= place and one.way == way)
    status = process.wait()
    for reader in readers:
        reader.join()
    if status and not why:
        said = errors[-1].strip() if errors else ""
        why = f"signal {-status}" if status < 0 else f"status {status}: {said}"
    if why:
        failures.append(Failure(batches[place].way, seed, number, why))
    return place, number, failures


def keep(failure: Failure, folder: Path) -> None:
    """Leave the input of a failure, and how to repeat it."""
    way = WAYS[failure.way]
    data = mutant(list(way.seeds()), generator(failure.seed, failure.way, failure.number))
    name = f"{failure.way}-{failure.seed}-{failure.number}"
    (folder / f"{name}{way.suffix}").write_bytes(data)
    with (folder / "failures.txt").open("a") as file:
        file.write(f"{failure.command}\n    {failure.why}\n")


def rounds(wanted: argparse.Namespace) -> Iterator[List[Batch]]:
    """Return which mutants to try, without end."""
    ways = [wanted.way] if wanted.way else list(WAYS)
    for number in itertools.count():
        counts = {way: wanted.each * WAYS[way].share for way in ways}
        yield [Batch(way, wanted.first + number * counts[way], counts[way]) for way in ways]


def shortened(batches: Sequence[Batch], most: int) -> List[Batch]:
    """Return batches with so many mutants at most."""
    kept: List[Batch] = []
    for batch in batches:
        count = min(batch.count, most - sum(one.count for one in kept))
        if count > 0:
            kept.append(Batch(batch.way, batch.first, count))
    return kept


def fuzz(wanted: argparse.Namespace, folder: Path) -> Dict[str, object]:
    """Fuzz for as long as is wanted; return the summary."""
    tried = dict.fromkeys(WAYS, 0)
    failures: List[Failure] = []
    lock = threading.Lock()
    start = time.monotonic()
    todo = rounds(wanted)
    bar = tqdm(total=wanted.mutants or None, unit=" mutants", disable=not sys.stderr.isatty())

    def work() -> None:
        while True:
            with lock:
                left = (wanted.mutants or math.inf) - sum(tried.values())
                late = wanted.minutes and time.monotonic() - start > 60.0 * wanted.minutes
                if left <= 0 or late:
                    return
                batches = shortened(next(todo), left)
                for batch in batches:
                    tried[batch.way] += batch.count
            found = try_all(batches, wanted.seed, folder)
            with lock:
                bar.update(sum(batch.count for batch in batches))
                for failure in found:
                    failures.append(failure)
                    keep(failure, folder)
                    tqdm.write(f"{failure.way} {failure.number}: {failure.why}")

    with bar, ThreadPoolExecutor(wanted.workers) as pool:
        for one in [pool.submit(work) for _ in range(wanted.workers)]:
            one.result()
    return {
        "seed": wanted.seed,
        "mutants": sum(tried.values()),
        "by_way": tried,
        "failures": [{**asdict(one), "command": one.command} for one in failures],
        "seconds": round(time.monotonic() - start, 1),
    }


def main() -> None:
    """Fuzz, print and write results/fuzz/summary.json; status 1 where something failed."""
    parser = argparse.ArgumentParser(prog="fuzz.sh", description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=0.0, help="so long; or")
    parser.add_argument("--mutants", type=int, default=0, help="so many; 1000 if neither is given")
    parser.add_argument("--way", choices=sorted(WAYS), help="this way in only")
    parser.add_argument("--first", type=int, default=0, help="number of the first mutant")
    parser.add_argument(
        "--each", type=int, default=ROUND, help="mutants of a way's share before the next one"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("results/fuzz"))
    wanted = parser.parse_args()
    if not wanted.minutes and not wanted.mutants:
        wanted.mutants = 1000
    wanted.out.mkdir(parents=True, exist_ok=True)
    summary = fuzz(wanted, wanted.out.absolute())
    (wanted.out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    failures = len(summary["failures"])
    print(f"{summary['mutants']} mutants, {failures} failures; see {wanted.out}")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
