"""The program that checks whether a simulator keeps the promises of Gazebo's ROS interface.

Usage: rosrun bullet_lab gazebo_contract.py [--only TEXT] [--junit FILE] [--list]

It needs a ROS master with a simulator: this package's bridge, or a Gazebo.

:ROS Service clients: those of /gazebo
:ROS Subscribers, publishers: the topics of the probes that it spawns
"""

import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import rospy
from contract_rows import COMMIT, read_contract
from contract_run import DEVIATES, FAILED, NOT_JUDGED, PASSED, ContractRun
from contract_simulator import Simulator

from bullet_lab.core import parameters
from bullet_lab.core.files import write_text
from bullet_lab.core.parameters import ArgumentParser, ArgumentsError, add_options, read_options
from bullet_lab.errors import LabError
from bullet_lab.ros.node.node import STATUS_BAD_PARAMETER, NodeError, run_node

NAME = "gazebo_contract"
ROWS = Path(__file__).resolve().parent / "rows"
BRIDGE = "/bullet_lab/step"
"""A service that only this package's bridge offers."""

AUTO, NONE = "auto", "none"
STATUSES = (PASSED, DEVIATES, FAILED, NOT_JUDGED)
STATUS_NOT_JUDGED = 3
"""The program's status if the simulator died, and some rows were not judged."""


@dataclass(frozen=True)
class ContractParameters:
    """Options of the program."""

    only: str = parameters.text("", "check the rows with this in their names; all if empty")
    list: bool = parameters.boolean(False, "list the rows, and check nothing")
    deviations: str = parameters.choice(
        AUTO, "accept the bridge's known deviations: if it is the bridge, or never", (AUTO, NONE)
    )
    markdown: bool = parameters.boolean(False, "print the deviations as a Markdown table")
    restart: float = parameters.number(
        10.0, "wall seconds to wait for a simulator that died to start again", 0.0, maximum=3600.0
    )
    junit: str = parameters.text("", "file for the results as JUnit XML; none if empty")


def main():
    """Run the program.

    The status is 0 if all rows hold, 1 if one fails, 2 for wrong options, and STATUS_NOT_JUDGED.
    """
    try:
        options = read_command(rospy.myargv(sys.argv)[1:])
        contract = read_contract(ROWS, f"{time.time_ns() // 1_000_000:x}_")
        rows = [row for row in contract.rows if options.only in row.name]
        if not rows:
            raise ArgumentsError(f"no row has '{options.only}' in its name; --list shows all")
    except LabError as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        sys.exit(STATUS_BAD_PARAMETER)
    if options.markdown:
        print(deviations_table(contract))
    elif options.list:
        print(listing(rows, contract.known))
    else:
        run_node(NAME, lambda: check(contract, rows, options))


def read_command(words):
    """Read the options; raise LabError."""
    parser = ArgumentParser(prog=f"{NAME}.py", description=(__doc__ or "").split("\n")[0])
    add_options(parser, ContractParameters)
    return read_options(ContractParameters, vars(parser.parse_args(list(words))))


def check(contract, rows, options):
    """Check rows, print the table and write the file.

    Raises NodeError if a row fails, and SystemExit if one could not be judged.
    """
    start = time.monotonic()
    simulator = Simulator()
    is_bridge = options.deviations == AUTO and BRIDGE in simulator.offered()
    known = contract.known if is_bridge else {}
    verdicts = ContractRun(contract, simulator, rows, known, options.restart).verdicts()
    print(table(verdicts))
    if options.junit:
        write_junit(Path(options.junit), verdicts, time.monotonic() - start)
    if any(entry.status == NOT_JUDGED for entry in verdicts):
        sys.exit(STATUS_NOT_JUDGED)
    failed = sum(entry.status == FAILED for entry in verdicts)
    if failed:
        raise NodeError(f"{failed} of {len(verdicts)} rows do not hold")


def table(verdicts):
    """Return a line for each row, and one with the number of rows of each status."""
    width = _width(entry.row for entry in verdicts)
    lines = []
    for entry in verdicts:
        line = f"{entry.status:10}  {entry.row.name:{width}}  {_short(entry.row.source)}"
        lines.append(f"{line}  {entry.detail}" if entry.detail else line)
    counts = Counter(entry.status for entry in verdicts)
    total = ", ".join(f"{counts[status]} {status}" for status in STATUSES)
    return "\n".join([*lines, f"{total}; by gazebo_ros_pkgs {COMMIT[:12]}"])


def _width(rows):
    return max((len(row.name) for row in rows), default=0)


def _short(source):
    """Return a source as file:line, without folders."""
    return source.rpartition("/")[2]


def listing(rows, deviations):
    """Return a line for each row, and a line with the reason for each deviation."""
    width = _width(rows)
    lines = []
    for row in rows:
        lines.append(f"{row.name:{width}}  {row.word:9}  {_short(row.source)}")
        if row.name in deviations:
            lines.append(f"{'':{width}}  deviates: {deviations[row.name].reason}")
    return "\n".join(lines)


KINDS = {FAILED: "failure", NOT_JUDGED: "error", DEVIATES: "skipped"}
"""The words of JUnit for what has not passed."""


def write_junit(path, verdicts, seconds):
    """Write the verdicts as JUnit XML; deviations are skipped tests with their reasons."""
    counts = Counter(entry.status for entry in verdicts)
    suite = ElementTree.Element(
        "testsuite",
        name="gazebo_contract",
        tests=str(len(verdicts)),
        failures=str(counts[FAILED]),
        errors=str(counts[NOT_JUDGED]),
        skipped=str(counts[DEVIATES]),
        time=f"{seconds:.3f}",
    )
    properties = ElementTree.SubElement(suite, "properties")
    ElementTree.SubElement(properties, "property", name="gazebo_ros_pkgs", value=COMMIT)
    for entry in verdicts:
        chapter, _, name = entry.row.name.partition("/")
        source = {"classname": chapter, "name": name, "file": entry.row.source}
        case = ElementTree.SubElement(suite, "testcase", source)
        if entry.status in KINDS:
            ElementTree.SubElement(case, KINDS[entry.status], message=entry.detail)
    text = ElementTree.tostring(suite).decode()
    write_text(path, text)


def deviations_table(contract):
    """Return the deviations as a Markdown table."""
    sources = {row.name: _short(row.source).partition(":") for row in contract.rows}
    lines = ["| rows | source in Gazebo | here, and why |", "|---|---|---|"]
    for entry in contract.deviations:
        names = ", ".join(f"`{name}`" for name in entry.rows)
        # Each file once.
        files = {}
        for file, _, numbers in map(sources.get, entry.rows):
            files.setdefault(file, {})[numbers] = None
        joined = ", ".join(f"{file}:{','.join(numbers)}" for file, numbers in files.items())
        lines.append(f"| {names} | {joined} | {entry.reason} |")
    return "\n".join(lines)
