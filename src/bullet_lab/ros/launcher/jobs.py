"""The jobs of the lab: what the launch files say about themselves."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from pathlib import Path
from xml.dom import minidom
from xml.parsers.expat import ExpatError

import defusedxml.minidom
from defusedxml import DefusedXmlException

from bullet_lab.ros.launcher.values import UsageError, Values, read_values


@dataclass(frozen=True)
class Argument:
    """An argument of a job; the default is as written in the launch file, unresolved."""

    name: str
    default: str | None
    doc: str
    values: Values


@dataclass(frozen=True)
class Job:
    """A launch file that can be run by its name."""

    name: str
    path: Path
    summary: str
    arguments: tuple[Argument, ...]

    def default_of(self, name: str) -> str | None:
        """The unresolved default of an argument, None where there is none."""
        return next((a.default for a in self.arguments if a.name == name), None)


def find_jobs(folder: Path) -> dict[str, Job]:
    """All jobs of a folder of launch files by name, in alphabetical order."""
    return {path.stem: read_job(path) for path in sorted(folder.glob("*.launch"))}


def read_job(path: Path) -> Job:
    """Read what a launch file says about its job.

    Raises:
        UsageError: the file is no launch file, or the doc of an argument is wrong.
    """
    try:
        document = defusedxml.minidom.parse(str(path))
    except (OSError, ExpatError, DefusedXmlException) as error:
        raise UsageError(f"{path}: {error}") from error
    try:
        arguments = tuple(_arguments(document.documentElement))
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from error
    return Job(path.stem, path, _first_sentence(document), arguments)


def _arguments(root: minidom.Element):
    for node in root.childNodes:
        # An <arg> with a value is a constant, which roslaunch lets nobody change.
        if node.nodeName == "arg" and not node.hasAttribute("value"):
            default = node.getAttribute("default") if node.hasAttribute("default") else None
            doc = " ".join(node.getAttribute("doc").split())
            yield Argument(node.getAttribute("name"), default, doc, read_values(doc))


def _first_sentence(document: minidom.Document) -> str:
    """The first sentence of the leading comment, before or inside the root element."""
    nodes = [*document.childNodes, *document.documentElement.childNodes]
    comment = next((node.data for node in nodes if node.nodeName == "#comment"), "")
    text = " ".join(comment.split())
    end = text.find(". ")
    return text if end < 0 else text[: end + 1]


def choose_job(jobs: dict[str, Job], name: str) -> Job:
    """The job of that name.

    Raises:
        UsageError: there is none.
    """
    if name not in jobs:
        raise UsageError(f"there is no job {name!r}{_hint(name, jobs)}; jobs: {', '.join(jobs)}")
    return jobs[name]


def read_assignments(job: Job, words: list[str]) -> dict[str, str]:
    """The checked values from words like ``std:=0.1``; the last of a name counts.

    Raises:
        UsageError: a word is no assignment, or its name or value is not one of the job's.
    """
    known = {argument.name: argument for argument in job.arguments}
    values = {}
    for word in words:
        name, assigned, value = word.partition(":=")
        if not assigned:
            raise UsageError(f"{word!r} is not of the form name:=value")
        if name not in known:
            raise UsageError(
                f"{job.name} has no argument {name!r}{_hint(name, known)}; "
                f"its arguments: {', '.join(known)}"
            )
        known[name].values.check(name, value)
        values[name] = value
    missing = [a.name for a in job.arguments if a.default is None and a.name not in values]
    if missing:
        raise UsageError(f"{job.name} needs a value for {', '.join(missing)}")
    return values


def _hint(name: str, known) -> str:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def list_of_jobs(jobs: dict[str, Job]) -> str:
    """The overview that is printed when no job is named."""
    width = max((len(name) for name in jobs), default=0)
    lines = [f"  {job.name:{width}}  {job.summary}" for job in jobs.values()]
    return "\n".join(
        [
            "usage: scripts/run.sh <job> [name:=value ...]",
            "       scripts/run.sh <job> --help lists the arguments of a job",
            "",
            "jobs:",
            *lines,
        ]
    )


def help_on(job: Job, defaults: dict[str, str]) -> str:
    """The help on a job; defaults are the resolved ones by the argument's name."""
    left = {a.name: f"{a.name}:={defaults.get(a.name, a.default or '')}" for a in job.arguments}
    width = max((len(text) for text in left.values()), default=0)
    lines = [f"  {left[a.name]:{width}}  {a.doc}".rstrip() for a in job.arguments]
    return "\n".join([f"{job.name}: {job.summary}", "", "arguments and defaults:", *lines])
