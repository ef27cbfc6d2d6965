"""Lists the tests that did not pass in each of several runs of scripts/test.sh; status 1 if any.

Usage: outcomes.py FOLDER, which has a folder for each run with one of JUnit files, junit.
"""

import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter, defaultdict
from pathlib import Path


def outcomes_of(folder):
    """Yield the name of each test below a folder, and how it ended."""
    for path in (folder / "junit").rglob("*.xml"):
        for case in ElementTree.parse(str(path)).iter("testcase"):
            name = f"{case.get('classname')}::{case.get('name')}"
            kinds = {child.tag for child in case} & {"failure", "error", "skipped"}
            yield name, "passed" if not kinds else min(kinds)


def main():
    runs = [dict(outcomes_of(folder)) for folder in sorted(Path(sys.argv[1]).iterdir())]
    counts = defaultdict(Counter)
    for run in runs:
        for name in set().union(*runs):
            counts[name][run.get(name, "missing")] += 1
    wrong = {n: c for n, c in counts.items() if len(c) > 1 or not c.keys() & {"passed", "skipped"}}
    for name, counter in sorted(wrong.items()):
        print(f"{name}: " + ", ".join(f"{number} {kind}" for kind, number in counter.items()))
    print(f"{len(runs)} runs, {len(counts)} tests, {len(wrong)} did not pass each time")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
