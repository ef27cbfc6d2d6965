"""The rows of the contract, as the YAML files in rows/ hold them.

Each file is a chapter. Its `source` is the file of gazebo_ros_pkgs that the rows quote, its
`probes` are models that are spawned, and its `rows` are expectations. A row has a `name`, the
`line` of the source, and one of the words in `judges.JUDGES` with what is expected. It is about a
`topic` of a `probe`, or about the answer to a service `call` `with` a request.

The rows of a chapter are followed in their order if one of them has a call, or lets simulated time
`run` (in s, perhaps with messages to `publish`), or must `wait` (wall s, while time is paused).
"""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any
from xml.sax.saxutils import escape

import yaml
from contract_judges import JUDGES
from rosgraph.names import ns_join

from bullet_lab.errors import LabError

COMMIT = "f9e1a4607842afa5888ef01de31cd64a1e3e297f"
"""The commit of ros-simulation/gazebo_ros_pkgs, branch noetic-devel, that all lines refer to."""

PREFIX = "contract_"
"""The names of all models that the contract spawns begin with this, and with the mark of a run."""

# Keys of a row that are copied as they are, and the others besides the word.
_COPIED = ("probe", "topic", "call", "publish")
_KEYS = {"name", "line", "source", "with", "run", "wait", *_COPIED}


class ContractError(LabError):
    """The contract's files are invalid."""


@dataclass(frozen=True)
class Probe:
    """A model that is spawned to be observed.

    Attributes:
        name: name of the model, without PREFIX.
        robot: its file in rows/probes.
        plugin: file name of its plugin.
        tags: tags of the plugin.
        fill: other values for the placeholders of the robot's file.
        namespace: robot_namespace of the spawn service; None: contract/NAME.
        tf_prefix: parameter that is set in the namespace, if any.
        parameters: parameters of the ROS master; `{file: …}` is the text of a file in probes/.
        rpy: initial roll, pitch and yaw in rad.
        floor: whether the probe stands on a slab.
        publish: commands before time runs: `topic`, `type` and `message` each.
        round: probes of different rounds are not in the world together.
    """

    name: str
    robot: str
    plugin: str
    tags: dict = field(default_factory=dict)
    fill: dict = field(default_factory=dict)
    namespace: str = None
    tf_prefix: str = ""
    parameters: dict = field(default_factory=dict)
    rpy: tuple = (0.0, 0.0, 0.0)
    floor: bool = True
    publish: tuple = ()
    round: int = 1

    @property
    def robot_namespace(self):
        """The namespace of plugins that name none."""
        return f"contract/{self.name}" if self.namespace is None else self.namespace

    def full_name(self, topic):
        """Return the full name of a topic or service of this probe; empty for an empty name."""
        return ns_join(f"/{self.robot_namespace.strip('/')}", topic) if topic else ""

    def commands(self):
        """Return the entries of `publish` with full names of topics."""
        return [{**entry, "topic": self.full_name(entry["topic"])} for entry in self.publish]

    def text(self, folder):
        """Return the SDF or URDF of this probe of the contract in a folder; raise ContractError."""
        path = folder / "probes" / self.robot
        values = {"plugin": self._plugin_text(), **self.fill}
        try:
            return Template(path.read_text(encoding="utf-8")).substitute(values)
        except (OSError, KeyError, ValueError) as error:
            raise ContractError(f"{path}, for {self.name}: {error!r}") from error

    def _plugin_text(self):
        if not self.plugin:
            return ""
        tags = []
        for tag, value in self.tags.items():
            text = str(value).lower() if isinstance(value, bool) else str(value)
            tags.append(f"<{tag}>{escape(text)}</{tag}>")
        opening = f'<plugin name="{self.name}_plugin" filename="{self.plugin}">'
        return f"{opening}{''.join(tags)}</plugin>"


@dataclass(frozen=True)
class Row:
    """A row: what is observed, what is expected, and the line of Gazebo that promises it.

    `word` is the kind of expectation; it is empty for a row that only acts.
    """

    name: str
    source: str
    word: str = ""
    expected: Any = None
    probe: str = ""
    topic: str = ""
    call: str = ""
    request: dict = field(default_factory=dict)
    run: float = 0.0
    wait: float = 0.0
    publish: tuple = ()


@dataclass(frozen=True)
class Chapter:
    """A file of the contract: its probes by name, and its rows."""

    probes: dict
    rows: tuple

    def has_steps(self):
        """Return whether its rows are followed in their order."""
        return any(row.call or row.run or row.wait for row in self.rows)


@dataclass(frozen=True)
class Deviation:
    """Rows that this package's bridge does not meet, and the reason.

    `instead` has the expectations that it meets instead, by their words; it may be empty.
    """

    rows: tuple
    reason: str
    instead: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Contract:
    """All chapters and deviations.

    Attributes:
        types: md5 sums by the names of messages and services.
        folder: of its files.
        mark: follows PREFIX in all names, so that no run uses a name of an earlier one: Gazebo
            loses a model that is spawned while paused under the name of a deleted one.
    """

    chapters: tuple
    types: dict
    deviations: tuple
    folder: Path
    mark: str = ""

    @property
    def rows(self):
        """All rows that are checked."""
        return [row for chapter in self.chapters for row in chapter.rows if row.word]

    @property
    def known(self):
        """The deviations by the names of their rows."""
        return {name: entry for entry in self.deviations for name in entry.rows}

    def read(self, value):
        """Return a value of a row; for `{file: …}`, the text of that file in probes/."""
        if not (isinstance(value, dict) and set(value) == {"file"}):
            return value
        text = (self.folder / "probes" / value["file"]).read_text(encoding="utf-8")
        return text.replace(PREFIX, PREFIX + self.mark)


def read_contract(folder, mark=""):
    """Read all files of a contract; raise ContractError."""
    others = folder / "deviations.yaml", folder / "types.yaml"
    paths = sorted(set(folder.glob("*.yaml")) - set(others))
    chapters = tuple(_chapter(path, mark) for path in paths)
    if not chapters:
        raise ContractError(f"there is no contract in {folder}")
    deviations = tuple(
        _made(Deviation, {**entry, "rows": tuple(entry.get("rows", ()))}, others[0])
        for entry in _load(others[0], mark) or ()
    )
    contract = Contract(chapters, _load(others[1]) or {}, deviations, folder, mark)
    counts = Counter(row.name for row in contract.rows)
    duplicates = [name for name in counts if counts[name] > 1]
    unknown = sorted(set(contract.known) - set(counts))
    if duplicates or unknown:
        raise ContractError(
            f"{folder}: duplicate rows: {duplicates}, deviations of unknown rows: {unknown}"
        )
    return contract


def _load(path, mark=""):
    try:
        text = path.read_text(encoding="utf-8") if path.is_file() else ""
        return yaml.safe_load(text.replace(PREFIX, PREFIX + mark))
    except (OSError, UnicodeError, yaml.YAMLError) as error:
        raise ContractError(f"{path}: {error}") from error


def _chapter(path, mark):
    content = _load(path, mark)
    if not isinstance(content, dict) or not isinstance(content.get("rows"), list):
        raise ContractError(f"{path}: has no rows")
    plugin = content.get("plugin", "")
    probes = {
        key: _made(Probe, {"plugin": plugin, **entry, "name": f"{path.stem}_{key}"}, path)
        for key, entry in (content.get("probes") or {}).items()
    }
    rows = tuple(_row(entry, content.get("source", ""), path) for entry in content["rows"])
    for row in rows:
        if row.probe and row.probe not in probes:
            raise ContractError(f"{path}: '{row.name}': there is no probe '{row.probe}'")
    return Chapter(probes, rows)


def _row(entry, source, path):
    words = set(entry) - _KEYS
    acts = "run" in entry or "wait" in entry
    if len(words) > 1 or not (words or acts) or words - set(JUDGES):
        raise ContractError(f"{path}: {entry}: needs exactly one of {sorted(JUDGES)}")
    word = "".join(words)
    if word and not ("name" in entry and "line" in entry):
        raise ContractError(f"{path}: {entry}: has no name or no line")
    lines = entry.get("line", "")
    numbers = lines if isinstance(lines, list) else [lines]
    return Row(
        name=f"{path.stem}/{entry.get('name', '')}",
        source=f"{entry.get('source', source)}:{','.join(map(str, numbers))}",
        word=word,
        expected=entry.get(word),
        request=entry.get("with") or {},
        run=float(entry.get("run", 0.0)),
        wait=float(entry.get("wait", 0.0)),
        **{key: entry[key] for key in _COPIED if key in entry},
    )


def _made(kind, entry, path):
    try:
        return kind(**entry)
    except TypeError as error:
        raise ContractError(f"{path}: {entry}: {error}") from error
