"""The rows of the contract, as the YAML files in config/contract hold them.

A chapter is a file: `source`, the file of gazebo_ros_pkgs that its rows stand on; `probes`, models
that are put into the world; and `rows`. A row has a `name`, the `line` of the source, and what is
expected, by one of the words in `judges.JUDGES`. It is about what a `probe` says on a `topic`, or
about what a service answers to a `call` `with` a request. Rows with a call, and those that let
time `run` (simulated s, perhaps with something to `publish`) or `wait` (wall s, while time
stands), are followed in their order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import yaml

from bullet_lab.errors import LabError
from bullet_lab.ros.contract.judges import JUDGES

# The commit of ros-simulation/gazebo_ros_pkgs, branch noetic-devel, that all lines are of.
COMMIT = "f9e1a4607842afa5888ef01de31cd64a1e3e297f"
DEVIATIONS = "deviations.yaml"
TYPES = "types.yaml"
# What stands in a row beside what is expected.
ABOUT = frozenset(
    ("name", "line", "source", "probe", "topic", "call", "with", "run", "publish", "wait")
)


class ContractError(LabError):
    """The contract's files make no sense."""


@dataclass(frozen=True)
class Probe:
    """A model that is put into the world to be looked at.

    Attributes:
        name: of the model, without what all of them begin with.
        robot: its file in config/contract/probes.
        plugin: file name of its plugin.
        tags: of the plugin.
        fill: what else is filled into the robot's file.
        namespace: for the spawn service; None for one of its own.
        tf_prefix: set in its namespace.
        parameters: of the master; `{file: …}` is a text in config/contract/probes.
        rpy: how it is turned at first, in rad.
        floor: whether there is a floor below it.
        publish: commands before time runs: topic, `type` and `message`.
        round: probes of different rounds are not in the world together.
    """

    name: str
    robot: str
    plugin: str
    tags: Mapping[str, Any] = field(default_factory=dict)
    fill: Mapping[str, Any] = field(default_factory=dict)
    namespace: Any = None
    tf_prefix: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    rpy: Sequence[float] = (0.0, 0.0, 0.0)
    floor: bool = True
    publish: Sequence[Mapping[str, Any]] = ()
    round: int = 1


@dataclass(frozen=True)
class Row:
    """A row: what is looked at, what is expected there, and where Gazebo says so.

    `word` is what kind of expectation it is; empty where nothing is checked and something is done.
    """

    name: str
    source: str
    word: str = ""
    expected: Any = None
    probe: str = ""
    topic: str = ""
    call: str = ""
    request: Mapping[str, Any] = field(default_factory=dict)
    run: float = 0.0
    wait: float = 0.0
    publish: Sequence[Mapping[str, Any]] = ()


@dataclass(frozen=True)
class Chapter:
    """A file of the contract: its probes by name, and its rows."""

    name: str
    probes: Mapping[str, Probe]
    rows: Tuple[Row, ...]

    def has_steps(self) -> bool:
        """Return whether its rows are followed in their order."""
        return any(row.call or row.run or row.wait for row in self.rows)


@dataclass(frozen=True)
class Deviation:
    """Rows that this package's bridge does not keep, why, and what it does `instead`.

    The latter is said by the words of a row, and may be missing.
    """

    rows: Tuple[str, ...]
    reason: str
    instead: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Contract:
    """All of it: `types` has md5 sums by the names of messages and services."""

    chapters: Tuple[Chapter, ...]
    types: Mapping[str, str]
    deviations: Tuple[Deviation, ...]
    folder: Path

    @property
    def rows(self) -> List[Row]:
        """All that is checked."""
        return [row for chapter in self.chapters for row in chapter.rows if row.word]

    @property
    def known(self) -> Dict[str, Deviation]:
        """The deviations by the names of their rows."""
        return {name: entry for entry in self.deviations for name in entry.rows}


def read_contract(folder: Path) -> Contract:
    """Read all files of a contract; raises ContractError."""
    paths = [path for path in sorted(folder.glob("*.yaml")) if path.name not in (DEVIATIONS, TYPES)]
    chapters = tuple(_chapter(path) for path in paths)
    if not chapters:
        raise ContractError(f"there is no contract in {folder}")
    deviations = tuple(
        _made(Deviation, {**entry, "rows": tuple(entry.get("rows", ()))}, folder / DEVIATIONS)
        for entry in _load(folder / DEVIATIONS) or ()
    )
    contract = Contract(chapters, _load(folder / TYPES) or {}, deviations, folder)
    names = [row.name for row in contract.rows]
    doubled = sorted({name for name in names if names.count(name) > 1})
    unknown = sorted(set(contract.known) - set(names))
    if doubled or unknown:
        raise ContractError(f"{folder}: rows twice: {doubled}, deviations of no row: {unknown}")
    return contract


def _load(path: Path) -> Any:
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8")) if path.is_file() else None
    except (OSError, UnicodeError, yaml.YAMLError) as error:
        raise ContractError(f"{path}: {error}") from error


def _chapter(path: Path) -> Chapter:
    entries = _load(path)
    name = path.stem
    if not isinstance(entries, dict) or not isinstance(entries.get("rows"), list):
        raise ContractError(f"{path}: has no rows")
    probes = {
        key: _made(
            Probe, {"plugin": entries.get("plugin", ""), **entry, "name": f"{name}_{key}"}, path
        )
        for key, entry in (entries.get("probes") or {}).items()
    }
    rows = tuple(_row(name, entry, entries.get("source", ""), path) for entry in entries["rows"])
    for row in rows:
        if row.probe and row.probe not in probes:
            raise ContractError(f"{path}: '{row.name}': there is no probe '{row.probe}'")
    return Chapter(name, probes, rows)


def _row(chapter: str, entry: Dict[str, Any], source: str, path: Path) -> Row:
    words = sorted(set(entry) - ABOUT)
    acts = bool({"run", "wait"} & set(entry))
    if len(words) > 1 or (not words and not acts) or not set(words) <= set(JUDGES):
        raise ContractError(f"{path}: {entry}: expects none or too much of {sorted(JUDGES)}")
    word = words[0] if words else ""
    if word and not ("name" in entry and "line" in entry):
        raise ContractError(f"{path}: {entry}: has no name or no line")
    return Row(
        name=f"{chapter}/{entry.get('name', '')}",
        source=_sources(entry.get("source", source), entry.get("line", "")),
        word=word,
        expected=entry.get(word),
        probe=entry.get("probe", ""),
        topic=entry.get("topic", ""),
        call=entry.get("call", ""),
        request=entry.get("with") or {},
        run=float(entry.get("run", 0.0)),
        wait=float(entry.get("wait", 0.0)),
        publish=entry.get("publish", ()),
    )


def _sources(file: str, lines: Any) -> str:
    numbers = lines if isinstance(lines, list) else [lines]
    return f"{file}:{','.join(map(str, numbers))}"


def _made(kind: type, entry: Mapping[str, Any], path: Path) -> Any:
    try:
        return kind(**entry)
    except TypeError as error:
        raise ContractError(f"{path}: {entry}: {error}") from error
