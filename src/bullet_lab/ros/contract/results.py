"""What came of the rows: verdicts, the table for people, JUnit's XML for machines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterable, List, Mapping, Sequence
from xml.etree import ElementTree

from bullet_lab.core.files import replace_file
from bullet_lab.ros.contract.rows import COMMIT, Contract, Deviation, Row

PASSED, DEVIATES, FAILED = "passed", "deviates", "FAILED"


@dataclass(frozen=True)
class Verdict:
    """What came of a row; `detail` says what was found, or why it deviates."""

    row: Row
    status: str
    detail: str = ""


def verdict(row: Row, complaint: str, deviation: Deviation = None, instead: str = "") -> Verdict:
    """Return what comes of a row.

    A row that is known to deviate has to: in the way that was said, where that was.

    Args:
        row: the row.
        complaint: what is wrong by Gazebo; empty where nothing is.
        deviation: that is known of.
        instead: what is wrong by what the deviation says; empty where nothing is.
    """
    if deviation is None:
        return Verdict(row, FAILED if complaint else PASSED, complaint)
    if not complaint:
        return Verdict(row, FAILED, "deviates no longer: take it from the table of deviations")
    if instead:
        return Verdict(row, FAILED, f"deviates otherwise than the table says: {instead}")
    return Verdict(row, DEVIATES, f"{complaint}: {deviation.reason}")


def table(verdicts: Sequence[Verdict]) -> str:
    """Return a line for each row, and at the end how many there were of which kind."""
    width = max((len(entry.row.name) for entry in verdicts), default=0)
    lines = [line_of(entry, width) for entry in verdicts]
    counts = dict.fromkeys((PASSED, DEVIATES, FAILED), 0)
    for entry in verdicts:
        counts[entry.status] += 1
    total = ", ".join(f"{number} {status}" for status, number in counts.items())
    return "\n".join([*lines, f"{total}; by gazebo_ros_pkgs {COMMIT[:12]}"])


def line_of(entry: Verdict, width: int) -> str:
    """Return a row's line."""
    detail = f"  {entry.detail}" if entry.detail else ""
    return f"{entry.status:8}  {entry.row.name:{width}}  {short(entry.row.source)}{detail}"


def short(source: str) -> str:
    """Return a source as file:line, without folders."""
    return source.rpartition("/")[2]


def listing(rows: Sequence[Row], deviations: Mapping[str, Deviation]) -> str:
    """Return a line for each row that would be checked, and the deviations with their reasons."""
    width = max((len(row.name) for row in rows), default=0)
    lines: List[str] = []
    for row in rows:
        deviation = deviations.get(row.name)
        lines.append(f"{row.name:{width}}  {row.word:9}  {short(row.source)}")
        if deviation is not None:
            lines.append(f"{'':{width}}  deviates: {deviation.reason}")
    return "\n".join(lines)


def write_junit(path: Path, verdicts: Sequence[Verdict], seconds: float) -> None:
    """Write the verdicts as JUnit's XML; deviations are skipped tests with their reasons."""
    counts = {status: sum(v.status == status for v in verdicts) for status in (FAILED, DEVIATES)}
    suite = ElementTree.Element(
        "testsuite",
        name="gazebo_contract",
        tests=str(len(verdicts)),
        failures=str(counts[FAILED]),
        errors="0",
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
            kind = "failure" if entry.status == FAILED else "skipped"
            ElementTree.SubElement(case, kind, message=entry.detail)
    text = ElementTree.tostring(suite, encoding="unicode")
    replace_file(path, lambda part: part.write_text(text, encoding="utf-8"))


def deviations_table(contract: Contract) -> str:
    """Return the deviations as a table in Markdown."""
    sources = {row.name: row.source for row in contract.rows}
    lines = ["| rows | where Gazebo says so | here, and why |", "|---|---|---|"]
    for entry in contract.deviations:
        names = ", ".join(f"`{name}`" for name in entry.rows)
        lines.append(f"| {names} | {_joined(map(sources.get, entry.rows))} | {entry.reason} |")
    return "\n".join(lines)


def _joined(sources: Iterable[str]) -> str:
    """Return sources with each file named once."""
    files: Dict[str, List[str]] = {}
    for source in sources:
        file, _, lines = short(source).partition(":")
        files.setdefault(file, []).append(lines)
    return ", ".join(f"{file}:{','.join(dict.fromkeys(ls))}" for file, ls in files.items())
