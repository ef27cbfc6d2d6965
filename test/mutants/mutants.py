"""Puts mistakes into the library, one at a time, and looks whether a unit test fails.

results/mutants/mutants.csv has a row for each; those that no test notices have survived.
--count N mutants of the library's folders --rooms, --jobs at a time; --known: by the coverage that
the last run has measured. A mutant whose tests take longer than --seconds is tried with the nearest
and shortest of them.
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import os
import random
import signal
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Dict, List, Set

from coverage import CoverageData
from mutations import mutants_of
from tqdm import tqdm

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path.append(str(ROOT / "test"))
from lab_nodes import parser_of  # noqa: E402

LIBRARY = "src/bullet_lab"
ROOMS = ("core", "noise", "drive.py", "docking", "vision", "simulation/world")
UNIT_TESTS = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not long")
# s that a mutant's tests may take beyond three times their usual time: a loop may not end.
PATIENCE = 90.0
OUTCOMES = {0: "survived", 1: "killed", 2: "killed", 5: "not run by any test"}


@dataclass
class Tests:
    """The unit tests: which lines each runs, and how long it takes.

    Attributes:
        of_line: names of tests by file and line of the library.
        of_file: names of all tests by their file.
        seconds: s by name.
    """

    of_line: Dict[str, Dict[int, Set[str]]] = field(default_factory=dict)
    of_file: Dict[str, List[str]] = field(default_factory=lambda: defaultdict(list))
    seconds: Dict[str, float] = field(default_factory=dict)

    def of(self, mutant, longest):
        """Return the tests that may notice a mutant, in the order to run them, in `longest` s."""
        lines = self.of_line.get(mutant.file, {})
        covering = set(lines.get(mutant.line, ()))
        if not covering:
            # It runs when the module is imported.
            covering = set().union(*lines.values())
        # What runs in a fixture counts for the first test only that uses it, and what runs when
        # a module of tests is imported for none.
        near = f"unit/{'/'.join(Path(mutant.file).relative_to(LIBRARY).parts[:-1])}/"
        files = {name.split("::")[0] for name in covering}
        files |= {file for file in self.of_file if near in file}

        def place(name):
            return (near not in name, name not in covering, self.seconds[name])

        names = sorted((name for file in files for name in self.of_file[file]), key=place)
        totals = itertools.accumulate(self.seconds[name] for name in names)
        return [name for name, total in zip(names, totals) if total <= longest]


def run_all(folder):
    """Run the unit tests once with coverage, into a folder."""
    command = [sys.executable, *UNIT_TESTS, "test/unit", "-n", "auto", "--dist", "loadfile"]
    command += [f"--cov={LIBRARY}", "--cov-context=test", "--cov-report="]
    command += [f"--junitxml={folder / 'tests.xml'}", "-o", "junit_family=xunit1"]
    environment = dict(os.environ, COVERAGE_FILE=str(folder / "coverage"))
    run = subprocess.run(command, cwd=ROOT, env=environment)
    if run.returncode:
        sys.exit("mutants: the unit tests fail without a mutant")


def read_tests(folder):
    """Read what `run_all` left."""
    tests = Tests()
    for case in ElementTree.parse(str(folder / "tests.xml")).iter("testcase"):
        parts = case.get("classname").split(".")
        name = "::".join([case.get("file"), *parts[len(Path(case.get("file")).parts) :]])
        name += "::" + case.get("name")
        tests.of_file[case.get("file")].append(name)
        tests.seconds[name] = float(case.get("time"))
    data = CoverageData(str(folder / "coverage"))
    data.read()
    for path in data.measured_files():
        lines = {
            line: {name for name in (c.rpartition("|")[0] for c in contexts) if name}
            for line, contexts in data.contexts_by_lineno(path).items()
        }
        known = {line: names & tests.seconds.keys() for line, names in lines.items()}
        tests.of_line[str(Path(path).resolve().relative_to(ROOT))] = known
    return tests


def drawn(rooms, count, seed):
    """Draw mutants of the modules of some rooms."""
    files = []
    for room in rooms:
        path = ROOT / LIBRARY / room
        files += [path] if path.is_file() else path.rglob("*.py")
    names = sorted(str(path.relative_to(ROOT)) for path in files)
    everything = [mutant for name in names for mutant in mutants_of(ROOT, name)]
    return random.Random(seed).sample(everything, min(count, len(everything)))


def outcome(mutant, tests, longest):
    """Run the tests of a mutant until one fails, for `longest` s."""
    names = tests.of(mutant, longest)
    if not names:
        return OUTCOMES[5]
    *folders, file = Path(mutant.file).relative_to("src").with_suffix("").parts
    module = ".".join(folders if file == "__init__" else [*folders, file])
    site = f"{module};{ROOT / mutant.file};{mutant.node};{mutant.choice}"
    with tempfile.TemporaryDirectory() as folder:
        chosen = Path(folder) / "tests"
        chosen.write_text("\n".join(names))
        path = os.pathsep.join([str(HERE / "hook"), str(HERE), os.environ.get("PYTHONPATH", "")])
        environment = dict(
            os.environ, LAB_MUTANT=site, LAB_CHOSEN_TESTS=str(chosen), PYTHONPATH=path
        )
        files = sorted({name.split("::")[0] for name in names})
        run = subprocess.Popen(
            [sys.executable, *UNIT_TESTS, "-x", "-p", "chosen_tests", *files],
            cwd=ROOT,
            env=dict(environment, TMPDIR=folder),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            status = run.wait(PATIENCE + 3 * sum(tests.seconds[name] for name in names))
            return OUTCOMES.get(status, "killed")
        except subprocess.TimeoutExpired:
            return "killed"
        finally:
            # What a test has started as well.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGKILL)
            run.wait()


def room_of(mutant, rooms):
    """Return the room that a mutant is in."""
    return next(room for room in rooms if mutant.file.startswith(f"{LIBRARY}/{room}"))


def show(rows, rooms):
    """Print the table, and the mutants that survived."""
    by_room = {room: Counter() for room in rooms}
    for mutant, found in rows.items():
        by_room[room_of(mutant, rooms)][found] += 1
    by_room["all"] = sum(by_room.values(), Counter())
    print(f"{'':20}{'mutants':>9}{'killed':>9}{'':>9}")
    for room, counts in by_room.items():
        total = sum(counts.values())
        share = f"{100 * counts['killed'] / total:.1f} %" if total else ""
        print(f"{room:20}{total:9}{counts['killed']:9}{share:>9}")
    for mutant, found in sorted(rows.items(), key=lambda row: (row[0].file, row[0].line)):
        if found != "killed":
            print(f"{mutant.file}:{mutant.line}: {mutant.text}: {found}")


def main():
    """Draw mutants, try them, print and write what came of each."""
    parser = parser_of(
        "mutants.sh",
        __doc__,
        count=300,
        seed=1,
        rooms=",".join(ROOMS),
        jobs=os.cpu_count(),
        known=False,
        seconds=60.0,
        out=Path("results/mutants"),
    )
    wanted = parser.parse_args()
    out = wanted.out.absolute()
    out.mkdir(parents=True, exist_ok=True)
    if not wanted.known:
        run_all(out)
    tests = read_tests(out)
    rooms = wanted.rooms.split(",")
    mutants = drawn(rooms, wanted.count, wanted.seed)
    with ThreadPoolExecutor(wanted.jobs) as pool:
        found = pool.map(lambda mutant: outcome(mutant, tests, wanted.seconds), mutants)
        rows = dict(zip(mutants, tqdm(found, total=len(mutants), desc="mutants", unit="mutant")))
    with (out / "mutants.csv").open("w") as file:
        writer = csv.DictWriter(file, [*asdict(mutants[0]), "outcome"])
        writer.writeheader()
        writer.writerows({**asdict(mutant), "outcome": came} for mutant, came in rows.items())
    show(rows, rooms)


if __name__ == "__main__":
    main()
