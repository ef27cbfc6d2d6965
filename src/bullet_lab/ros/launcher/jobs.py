"""The jobs of the lab, as their launch files and the nodes in them describe themselves.

An argument that is handed to a node is described by the node's declaration of that parameter:
what is allowed and, where the launch file's default is empty, the default and the sentence. For
any other argument, the bracket that ends its ``doc`` says what is allowed::

    [text]               anything; the same as no bracket
    [folder]             a path, relative to the caller's folder
    [file]               likewise, of what exists; or package://; or empty
    [true|false]         one of the words; two or more, or true or false alone
    [integer >= 0]       a whole number, with or without bounds: >= <=
    [number > 0 <= 1]    a finite number, with or without bounds: > >= <=
"""

from __future__ import annotations

import difflib
import importlib
import os
import re
from dataclasses import MISSING, is_dataclass
from pathlib import Path
from typing import Any, Iterable, NamedTuple
from xml.dom import minidom
from xml.parsers.expat import ExpatError

import defusedxml.minidom
from defusedxml import DefusedXmlException

from bullet_lab.core import parameters
from bullet_lab.core.parameters import Declaration, declarations, declared
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.resources import ResourceFinder

_PACKAGE = "bullet_lab"
FILE = "file"
_DOC = re.compile(r"(.*?)(\s*\[([^\[\]]+)\])?")
_NUMERIC = re.compile(r"(number|integer)((?: (?:>=|<=) [-+.\d]+| > [-+.\d]+)*)")
_BOUND = re.compile(r"(>=|<=|>) ([-+.\d]+)")
_BOUNDS = {">=": "minimum", "<=": "maximum", ">": "above"}
_WORDS = re.compile(r"true|false|[\w.-]+(\|[\w.-]+)+")
_ARGUMENT = re.compile(r"\$\(arg (\w+)\)")
_OPTION = re.compile(r"--?([\w-]+)[= ]'?\$\(arg (\w+)\)")
_MODULE = re.compile(r"""\brun\(["']([\w.]+)(?::\w+)?["']\)""")


class UsageError(LabError):
    """The command line asks for something that does not exist or cannot be."""


class Target(NamedTuple):
    """A parameter of a node that an argument is handed to: its name, and the node's module."""

    module: str
    parameter: str

    def declaration(self) -> Declaration | None:
        """How the node declares it; None where the node cannot be asked."""
        try:
            found = vars(importlib.import_module(self.module)).values()
        except ImportError:
            # The node will say so itself, and better.
            return None
        kinds = (entry for entry in found if isinstance(entry, type) and is_dataclass(entry))
        known = (declarations(kind).get(self.parameter) for kind in kinds)
        return next((declaration for declaration in known if declaration), None)


class Argument(NamedTuple):
    """An argument of a job.

    Attributes:
        name: in the launch file.
        default: as written there, unresolved; empty for the node's own, None where there is none.
        doc: what the launch file says of it, without the bracket at the end.
        bracket: what stands in that.
        own: the check that the bracket describes, if any.
        targets: the parameters that it is handed to.
    """

    name: str
    default: str | None
    doc: str
    bracket: str
    own: Declaration | None
    targets: tuple[Target, ...]

    def declarations(self) -> list[Declaration]:
        """All that a value has to suit; imports the nodes in question, if any."""
        if self.own is not None:
            return [self.own]
        found = (target.declaration() for target in self.targets)
        return [entry for entry in found if entry is not None]

    def resolved(self, value: str) -> str:
        """Return a value as the launch file takes it: that of a file with its whole path."""
        if self.bracket != FILE or not value:
            return value
        return str(ResourceFinder.anywhere().find(value))

    def check(self, value: str) -> None:
        """Raise ParameterError, with one line that says what is allowed, for a wrong value."""
        for declaration in self.declarations():
            declaration.read(value, self.name)

    def help(self, default: str) -> tuple[str, str]:
        """The argument with its default, and what it is; `default` is the resolved one."""
        doc, allowed = self.doc, self.bracket
        declarations = [] if allowed else self.declarations()
        if declarations:
            check = declarations[0].check
            allowed = check.allowed
            if not self.default:
                default = declarations[0].default_text
                # A sentence may begin with a unit.
                doc = check.doc
                if doc[1:2].isalpha():
                    doc = doc[:1].upper() + doc[1:]
        limits = f" [{allowed}]" if allowed not in ("", "text") else ""
        return f"{self.name}:={default}", doc + limits


class Job(NamedTuple):
    """A launch file that can be run by its name; its arguments by theirs."""

    name: str
    path: Path
    summary: str
    arguments: dict[str, Argument]


def find_jobs(package: Path) -> dict[str, Job]:
    """All jobs of a package by name, in alphabetical order."""
    paths = sorted((package / "launch").glob("*.launch"))
    return {path.stem: read_job(path, package) for path in paths}


def read_job(path: Path, package: Path) -> Job:
    """Read what a launch file of a package says about its job; raise UsageError if wrong."""
    document = _parse(path)
    targets = _targets(path, package)
    arguments = {}
    for node in document.documentElement.childNodes:
        # An <arg> with a value is a constant, which roslaunch lets nobody change.
        if node.nodeName == "arg" and not node.hasAttribute("value"):
            name = node.getAttribute("name")
            default = node.getAttribute("default") if node.hasAttribute("default") else None
            doc, _, bracket = _DOC.fullmatch(" ".join(node.getAttribute("doc").split())).groups()
            try:
                own = _bracket_check(name, bracket or "")
            except UsageError as error:
                raise UsageError(f"{path}: {error}") from error
            handed = tuple(targets.get(name, ()))
            arguments[name] = Argument(name, default, doc, bracket or "", own, handed)
    return Job(path.stem, path, _first_sentence(document), arguments)


def _parse(path: Path) -> minidom.Document:
    try:
        return defusedxml.minidom.parse(str(path))
    except (OSError, ExpatError, DefusedXmlException) as error:
        raise UsageError(f"{path}: {error}") from error


def _bracket_check(name: str, bracket: str) -> Declaration | None:
    """What a bracket allows; None for anything. Raises UsageError for an unknown bracket."""
    try:
        return _declared_by(name, bracket)
    except ValueError as error:
        raise UsageError(f"the doc of {name} ends with [{bracket}]: {error}") from None


def _declared_by(name: str, bracket: str) -> Declaration | None:
    missing: Any = MISSING
    numeric = _NUMERIC.fullmatch(bracket)
    if bracket in ("", "text"):
        return None
    if bracket == "folder":

        def filled(value: str) -> str:
            if not value:
                raise ValueError
            return value

        entry = parameters.checked(missing, "", "a folder", filled)
    elif bracket == FILE:

        def existing(value: str) -> str:
            # A Path raises OSError where a name is too long.
            if value and "://" not in value and not os.path.isfile(value):
                raise ValueError
            return value

        entry = parameters.checked(missing, "", "a file that exists", existing)
    elif numeric:
        kind: Any = {"number": (parameters.number, float), "integer": (parameters.integer, int)}
        declare, convert = kind[numeric[1]]
        bounds = {_BOUNDS[sign]: convert(limit) for sign, limit in _BOUND.findall(numeric[2])}
        entry = declare(missing, "", **bounds)
    elif _WORDS.fullmatch(bracket):
        entry = parameters.choice(missing, "", bracket.split("|"))
    else:
        raise UsageError(f"the doc of {name} ends with an unknown kind of values: [{bracket}]")
    return declared(name, entry)


def _targets(path: Path, package: Path, seen: tuple[Path, ...] = ()) -> dict[str, list[Target]]:
    """The parameters that each argument of a launch file is handed to, by the argument's name."""
    found: dict[str, list[Target]] = {}
    root = _parse(path).documentElement
    for node in root.getElementsByTagName("node"):
        module = _module_of(node.getAttribute("type"), package)
        if node.getAttribute("pkg") != _PACKAGE or module is None:
            continue
        handed = [
            (p.getAttribute("name"), _argument(p)) for p in node.getElementsByTagName("param")
        ]
        handed += [(o.replace("-", "_"), a) for o, a in _OPTION.findall(node.getAttribute("args"))]
        for parameter, argument in handed:
            found.setdefault(argument, []).append(Target(module, parameter))
    for include in root.getElementsByTagName("include"):
        file = Path(include.getAttribute("file").replace(f"$(find {_PACKAGE})", str(package)))
        # One that includes itself hands on the same.
        if file in (path, *seen) or not os.path.isfile(file):
            continue
        inner = _targets(file, package, (path, *seen))
        for node in include.getElementsByTagName("arg"):
            found.setdefault(_argument(node), []).extend(inner.get(node.getAttribute("name"), []))
    return found


def _argument(node: minidom.Element) -> str:
    """The argument whose value an element hands on as it is; empty for none."""
    whole = _ARGUMENT.fullmatch(node.getAttribute("value"))
    return whole[1] if whole else ""


def _module_of(executable: str, package: Path) -> str | None:
    """The module that an executable of the package runs, None for an executable of others."""
    # Where it is in the sources, and where it is installed.
    for folder in (package / "scripts", package.parent.parent / "lib" / _PACKAGE):
        if (folder / executable).is_file():
            found = _MODULE.search((folder / executable).read_text())
            return found[1] if found else None
    return None


def _first_sentence(document: minidom.Document) -> str:
    """The first sentence of the leading comment, before or inside the root element."""
    nodes = [*document.childNodes, *document.documentElement.childNodes]
    comment = next((node.data for node in nodes if node.nodeName == "#comment"), "")
    text = " ".join(comment.split())
    end = text.find(". ")
    return text if end < 0 else text[: end + 1]


def choose_job(jobs: dict[str, Job], name: str) -> Job:
    """The job of that name; raises UsageError where there is none."""
    if name not in jobs:
        raise UsageError(f"there is no job {name!r}{_hint(name, jobs)}; jobs: {', '.join(jobs)}")
    return jobs[name]


def read_assignments(job: Job, words: list[str]) -> dict[str, str]:
    """The checked values from words like ``std:=0.1``; the last of a name counts.

    Raises UsageError for a word that is no assignment or a name that the job does not have, and
    LabError for a value that is not allowed.
    """
    known = job.arguments
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
        known[name].check(value)
        values[name] = known[name].resolved(value)
    missing = [a.name for a in known.values() if a.default is None and a.name not in values]
    if missing:
        raise UsageError(f"{job.name} needs a value for {', '.join(missing)}")
    return values


def _hint(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {close[0]!r}?)" if close else ""


def list_of_jobs(jobs: dict[str, Job]) -> str:
    """The overview that is printed when no job is named."""
    width = max((len(name) for name in jobs), default=0)
    usage = (
        "usage: scripts/run.sh <job> [name:=value ...]\n"
        "       scripts/run.sh <job> --help lists the arguments of a job\n\njobs:"
    )
    return "\n".join([usage, *(f"  {job.name:{width}}  {job.summary}" for job in jobs.values())])


def help_on(job: Job, defaults: dict[str, str]) -> str:
    """The help on a job; defaults are the launch file's by the argument's name, resolved."""
    rows = [a.help(defaults.get(a.name, a.default or "")) for a in job.arguments.values()]
    width = max((len(left) for left, _ in rows), default=0)
    lines = [f"  {left:{width}}  {doc}".rstrip() for left, doc in rows]
    return "\n".join([f"{job.name}: {job.summary}", "", "arguments and defaults:", *lines])
