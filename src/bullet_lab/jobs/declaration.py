"""Jobs: each is declared by its launch file, and by the nodes whose parameters that sets.

This is the one declaration of a job. The launcher, the command without ROS, the help, `verify` and
`scripts/faults.sh` read it here; roslaunch reads the same file::

    <!-- This sentence is shown in the list of jobs. -->
    <arg name="x" default="2.5" doc="Goal in m [number]"/>
    <arg name="std" default=""/>
    <arg name="smallest" value="x:=1 std:=0"/>

An argument that becomes a parameter of a node is described by the node's declaration of that
parameter: it gives the allowed values and, if the default here is empty, also the default and the
sentence. For other arguments, the bracket at the end of ``doc`` gives the allowed values::

    [text]               anything; the same as no bracket
    [folder]             a path, relative to the caller's folder
    [file]               an existing file, or a package:// URI, or empty
    [true|false]         one of the words; two or more, or true or false alone
    [integer]            a whole number
    [number]             a finite number

The constant ``smallest`` holds the arguments of the smallest useful run.

A node that runs a program in `bullet_lab.studies` is all that the job needs without ROS. If the job
needs more nodes with ROS, that one has ``if="false"``.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import os
import re
import runpy
import shlex
from dataclasses import MISSING, is_dataclass
from pathlib import Path
from typing import Any, Iterable, Iterator, Mapping, NamedTuple, get_type_hints
from xml.etree.ElementTree import Element

from bullet_lab.core import parameters
from bullet_lab.core.parameters import Declaration, declarations, declared
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.xml import parse_text, read_text

_PACKAGE = "bullet_lab"
_WITHOUT_ROS = f"{_PACKAGE}.studies."
FILE = "file"
SMALLEST = "smallest"
_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)
_DOC = re.compile(r"(.*?)(\s*\[([^\[\]]+)\])?")
_WORDS = re.compile(r"true|false|[\w.-]+(\|[\w.-]+)+")
_ARGUMENT = re.compile(r"\$\(arg (\w+)\)")
_OPTION = re.compile(r"--?([\w-]+)[= ]'?\$\(arg (\w+)\)")
_SUBSTITUTION = re.compile(r"\$\((arg|find|optenv) (\w+) ?([^()]*)\)")


class UsageError(LabError):
    """A wrong command line or a wrong launch file."""


def parameter_kinds(main: str) -> list[type]:
    """Return the dataclasses with the parameters of a program, "module" or "module:function".

    Raises ImportError if a library is missing.
    """
    module, _, function = main.partition(":")
    members = vars(importlib.import_module(module))
    program = members.get(function or "main")
    if isinstance(program, functools.partial):
        # `studies.study.run_from` with the name, the description and the settings of a study.
        return list(program.args[2])
    if hasattr(program, "__wrapped__"):
        return [get_type_hints(program.__wrapped__)["parameters"]]
    return [kind for kind in members.values() if isinstance(kind, type) and is_dataclass(kind)]


class Target(NamedTuple):
    """A parameter that an argument sets: its name, and the program that has it."""

    main: str
    parameter: str

    def declarations(self) -> list[Declaration]:
        """Return the node's declaration; nothing if the node cannot be imported or has none."""
        try:
            kinds = parameter_kinds(self.main)
        except ImportError:
            # The node reports that itself, with the library that is missing.
            return []
        known = (declarations(kind).get(self.parameter) for kind in kinds)
        return [declaration for declaration in known if declaration][:1]


class Argument(NamedTuple):
    """An argument of a job.

    Attributes:
        default: its default in the launch file, not resolved; None if it has none.
        doc: its sentence in the launch file, without the bracket.
        bracket: the text in the bracket.
        own: the check that the bracket declares, if any.
        targets: the parameters that it sets.
    """

    name: str
    default: str | None
    doc: str
    bracket: str
    own: Declaration | None
    targets: tuple[Target, ...]

    def declarations(self) -> list[Declaration]:
        """Return all declarations that a value must satisfy; imports the nodes, if any."""
        if self.own is not None:
            return [self.own]
        return [entry for target in self.targets for entry in target.declarations()]

    def check(self, value: str) -> None:
        """Raise ParameterError if a value is not allowed."""
        for declaration in self.declarations():
            declaration.read(value, self.name)

    def resolved(self, value: str) -> str:
        """Return a value as roslaunch gets it: the name of a file as an absolute path."""
        if self.bracket != FILE or not value:
            return value
        return str(ResourceFinder.anywhere().find(value))

    def help(self, default: str) -> tuple[str, str]:
        """Return "name:=default" and the sentence with the allowed values."""
        doc, allowed = self.doc, self.bracket
        declarations = [] if allowed else self.declarations()
        if declarations:
            first = declarations[0]
            allowed = first.allowed
            if not self.default:
                default, doc = first.default_text, first.doc
                # A sentence may begin with a unit, such as m.
                if doc[1:2].isalpha():
                    doc = doc[:1].upper() + doc[1:]
        limits = f" [{allowed}]" if allowed not in ("", "text") else ""
        return f"{self.name}:={default}", doc + limits


class Job(NamedTuple):
    """A launch file.

    Attributes:
        summary: its first sentence.
        smallest: the arguments of the smallest useful run.
        program: runs the job without ROS, "module" or "module:function"; empty if it needs ROS.
        command: the arguments of that program, not resolved.
    """

    name: str
    path: Path
    summary: str
    arguments: dict[str, Argument]
    smallest: str
    program: str = ""
    command: str = ""

    def without_ros(self) -> Job:
        """Return the job with only the arguments that its program has."""
        names = set(_ARGUMENT.findall(self.command))
        kept = {}
        for name in [one for one in self.arguments if one in names]:
            targets = [one for one in self.arguments[name].targets if one.main == self.program]
            kept[name] = self.arguments[name]._replace(targets=tuple(targets))
        return self._replace(arguments=kept)

    def resolve(self, text: str, values: Mapping[str, str]) -> str:
        """Return a text of the launch file as roslaunch resolves it, but for `$(eval …)`.

        Arguments without a value have their defaults.
        """

        def replacement(found: re.Match) -> str:
            kind, name, default = found.groups()
            if kind == "arg":
                known = self.arguments[name].default or ""
                return values[name] if name in values else self.resolve(known, values)
            package = str(self.path.parent.parent)
            return package if kind == "find" else os.environ.get(name, default)

        return _SUBSTITUTION.sub(replacement, text)

    def words(self, values: Mapping[str, str]) -> list[str]:
        """Return the command line of the program."""
        # Resolved word by word: a value may have spaces and quotes.
        return [self.resolve(word, values) for word in shlex.split(self.command)]


def find_jobs(package: Path) -> dict[str, Job]:
    """Return all jobs of a package by name, in alphabetical order."""
    paths = sorted((package / "launch").glob("*.launch"))
    return {path.stem: read_job(path, package) for path in paths}


def read_job(path: Path, package: Path) -> Job:
    """Read the declaration of a job from a launch file of a package; raise UsageError."""
    text, root = _parsed(path)
    targets: dict[str, list[Target]] = {}
    for argument, target in _targets(root, package, (path,)):
        targets.setdefault(argument, []).append(target)
    own = ((_main_of(node, package), node.get("args", "")) for node in root.iter("node"))
    alone = next((one for one in own if one[0].startswith(_WITHOUT_ROS)), ())
    arguments = {}
    smallest = ""
    for element in root.findall("arg"):
        name = element.get("name", "")
        # An <arg> with a value is a constant.
        if "value" not in element.attrib:
            handed = tuple(targets.get(name, ()))
            arguments[name] = _argument(name, element, handed, path)
        elif name == SMALLEST:
            smallest = element.get("value", "")
    return Job(path.stem, path, _first_sentence(text), arguments, smallest, *alone)


def _parsed(path: Path) -> tuple[str, Element]:
    try:
        text = read_text(path)
        return text, parse_text(text, str(path))
    except LabError as error:
        raise UsageError(str(error)) from error


def _first_sentence(text: str) -> str:
    """Return the first sentence of the first comment of a launch file."""
    comment = _COMMENT.search(text)
    sentence, end, _ = " ".join(comment[1].split() if comment else ()).partition(". ")
    return f"{sentence}{end}".strip()


def _argument(name: str, element: Element, targets: tuple[Target, ...], path: Path) -> Argument:
    doc, _, bracket = _DOC.fullmatch(" ".join(element.get("doc", "").split())).groups("")
    try:
        own = declared(name, _bracket_check(bracket)) if bracket not in ("", "text") else None
    except LookupError as error:
        raise UsageError(
            f"{path}: the doc of {name} ends with [{bracket}]; a bracket is text, folder, file, "
            "number, integer, or words with | between them"
        ) from error
    return Argument(name, element.get("default"), doc, bracket, own, targets)


def _bracket_check(bracket: str) -> Any:
    """Return what a bracket declares; raise LookupError if it is unknown."""
    missing: Any = MISSING
    if _WORDS.fullmatch(bracket):
        return parameters.choice(missing, "", bracket.split("|"))
    return {
        "folder": parameters.checked(missing, "", "a folder", _filled),
        FILE: parameters.checked(missing, "", "a file that exists", _existing),
        "number": parameters.number(missing, ""),
        "integer": parameters.integer(missing, ""),
    }[bracket]


def _filled(value: str) -> str:
    if not value:
        raise ValueError
    return value


def _existing(value: str) -> str:
    # Of a Path, `is_file` raises OSError for a name that is too long.
    if value and "://" not in value and not os.path.isfile(value):
        raise ValueError
    return value


def _targets(root: Element, package: Path, files: tuple[Path, ...]) -> Iterator[tuple[str, Target]]:
    """Yield each argument of a launch file with each parameter that it sets.

    `files` are this file and those that include it: one that includes itself adds nothing.
    """
    for node in root.iter("node"):
        main = _main_of(node, package)
        if main:
            for param in node.iter("param"):
                yield _argument_of(param), Target(main, param.get("name", ""))
            for option, argument in _OPTION.findall(node.get("args", "")):
                yield argument, Target(main, option.replace("-", "_"))
    for include in root.iter("include"):
        path = Path(include.get("file", "").replace(f"$(find {_PACKAGE})", str(package)))
        if path not in files and os.path.isfile(path):
            inner = list(_targets(_parsed(path)[1], package, (path, *files)))
            for handed in include.iter("arg"):
                for name, target in inner:
                    if name == handed.get("name"):
                        yield _argument_of(handed), target


def _argument_of(element: Element) -> str:
    """Return the argument whose value an element hands on unchanged; empty if there is none."""
    whole = _ARGUMENT.fullmatch(element.get("value", ""))
    return whole[1] if whole else ""


def _main_of(node: Element, package: Path) -> str:
    """Return what a node of the package runs; empty for other nodes."""
    executable = node.get("type", "") if node.get("pkg") == _PACKAGE else ""
    # In the sources, and where it is installed.
    for folder in (package / "scripts", package.parent.parent / "lib" / _PACKAGE):
        path = folder / os.path.basename(executable)
        # Of a Path, `is_file` raises OSError for a name that is too long.
        if path.suffix == ".py" and os.path.isfile(path):
            return runpy.run_path(str(path)).get("MAIN", "")
    return ""


def choose_job(jobs: dict[str, Job], name: str) -> Job:
    """Return the job with that name; raise UsageError if there is none."""
    if name not in jobs:
        raise UsageError(f"there is no job {name!r}{_hint(name, jobs)}; jobs: {', '.join(jobs)}")
    return jobs[name]


def read_assignments(job: Job, words: list[str]) -> dict[str, str]:
    """Return the checked values from words such as ``std:=0.1``; the last of a name counts.

    Raises LabError; UsageError for a word that is no assignment, or an unknown argument.
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


def list_of_jobs(jobs: dict[str, Job], program: str = "scripts/run.sh") -> str:
    """Return the list of jobs that a program prints if no job is named."""
    width = max((len(name) for name in jobs), default=0)
    usage = (
        f"usage: {program} <job> [name:=value ...]\n"
        f"       {program} <job> --help lists the arguments of a job\n\njobs:"
    )
    return "\n".join([usage, *(f"  {job.name:{width}}  {job.summary}" for job in jobs.values())])


def help_on(job: Job, defaults: dict[str, str]) -> str:
    """Return the help on a job; `defaults` are those of its launch file, resolved."""
    rows = [a.help(defaults.get(a.name, a.default or "")) for a in job.arguments.values()]
    width = max((len(left) for left, _ in rows), default=0)
    lines = [f"  {left:{width}}  {doc}".rstrip() for left, doc in rows]
    return "\n".join([f"{job.name}: {job.summary}", "", "arguments and defaults:", *lines])
