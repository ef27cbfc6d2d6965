"""The program that checks whether a simulator keeps the promises of Gazebo's ROS interface.

Usage: rosrun bullet_lab gazebo_contract.py [--only TEXT] [--junit FILE] [--list]

It needs a ROS master with a simulator: this package's bridge, or a Gazebo.

:ROS Service clients: those of /gazebo
:ROS Subscribers, publishers: the topics of the probes that it spawns
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterable, List, Mapping, Sequence
from xml.etree import ElementTree

import rospy
from contract_rows import COMMIT, Contract, Deviation, Row, read_contract
from contract_run import DEVIATES, FAILED, NOT_JUDGED, PASSED, ContractRun, Verdict
from contract_simulator import Simulator

from bullet_lab.core import parameters
from bullet_lab.core.files import replace_file
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
    contract: str = parameters.text("", "folder with another contract; the package's if empty")


def main() -> None:
    """Run the program.

    The status is 0 if all rows hold, 1 if one fails, 2 for wrong options, and STATUS_NOT_JUDGED.
    """
    try:
        options = read_command(rospy.myargv(sys.argv)[1:])
        folder = Path(options.contract) if options.contract else ROWS
        contract = read_contract(folder, f"{time.time_ns() // 1_000_000:x}_")
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


def read_command(words: Sequence[str]) -> ContractParameters:
    """Read the options; raise LabError."""
    parser = ArgumentParser(prog=f"{NAME}.py", description=(__doc__ or "").split("\n")[0])
    add_options(parser, ContractParameters)
    return read_options(ContractParameters, vars(parser.parse_args(list(words))))


def check(contract: Contract, rows: List[Row], options: ContractParameters) -> None:
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


def table(verdicts: Sequence[Verdict]) -> str:
    """Return a line for each row, and one with the number of rows of each status."""
    width = max((len(entry.row.name) for entry in verdicts), default=0)
    lines: List[str] = []
    for entry in verdicts:
        detail = f"  {entry.detail}" if entry.detail else ""
        source = _short(entry.row.source)
        lines.append(f"{entry.status:10}  {entry.row.name:{width}}  {source}{detail}")
    counts = Counter(entry.status for entry in verdicts)
    total = ", ".join(f"{counts[status]} {status}" for status in STATUSES)
    return "\n".join([*lines, f"{total}; by gazebo_ros_pkgs {COMMIT[:12]}"])


def _short(source: str) -> str:
    """Return a source as file:line, without folders."""
    return source.rpartition("/")[2]


def listing(rows: Sequence[Row], deviations: Mapping[str, Deviation]) -> str:
    """Return a line for each row, and a line with the reason for each deviation."""
    width = max((len(row.name) for row in rows), default=0)
    lines: List[str] = []
    for row in rows:
        deviation = deviations.get(row.name)
        lines.append(f"{row.name:{width}}  {row.word:9}  {_short(row.source)}")
        if deviation is not None:
            lines.append(f"{'':{width}}  deviates: {deviation.reason}")
    return "\n".join(lines)


def write_junit(path: Path, verdicts: Sequence[Verdict], seconds: float) -> None:
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
        case = ElementTree.SubElement(suite, "testcase", classname=chapter, name=name)
        case.set("file", entry.row.source)
        if entry.status != PASSED:
            kind = {FAILED: "failure", NOT_JUDGED: "error"}.get(entry.status, "skipped")
            ElementTree.SubElement(case, kind, message=entry.detail)
    text = ElementTree.tostring(suite, encoding="unicode")
    replace_file(path, lambda part: part.write_text(text, encoding="utf-8"))


def deviations_table(contract: Contract) -> str:
    """Return the deviations as a Markdown table."""
    sources = {row.name: row.source for row in contract.rows}
    lines = ["| rows | source in Gazebo | here, and why |", "|---|---|---|"]
    for entry in contract.deviations:
        names = ", ".join(f"`{name}`" for name in entry.rows)
        lines.append(f"| {names} | {_joined(map(sources.get, entry.rows))} | {entry.reason} |")
    return "\n".join(lines)


def _joined(sources: Iterable[str]) -> str:
    """Join sources, naming each file once."""
    files: Dict[str, List[str]] = {}
    for source in sources:
        file, _, lines = _short(source).partition(":")
        files.setdefault(file, []).append(lines)
    return ", ".join(f"{file}:{','.join(dict.fromkeys(ls))}" for file, ls in files.items())
