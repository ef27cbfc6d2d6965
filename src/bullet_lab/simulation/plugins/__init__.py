"""Plugins: the classes that simulate the `<plugin>` tags of a robot.

A plugin belongs to one model and stands for one `<plugin>` tag. It may act before each physics
step, and it sends samples at its own rate. It knows nothing of ROS: it names its topics, takes
commands through `inputs` and sends samples through `outputs`; the bridge, a test or a script
connects to those. A new kind of plugin is a subclass of `Plugin` that names Gazebo's files in
`filenames`. All modules of this folder are imported with it; a module elsewhere must be imported
before the robot is spawned.
"""

from __future__ import annotations

import importlib
import logging
import pkgutil
import re
from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any, Callable, Iterable, Mapping, Sequence
from zlib import crc32

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.core.schedule import Schedule
from bullet_lab.errors import LabError
from bullet_lab.simulation.physics.attached_frame import ORIGIN, AttachedFrame
from bullet_lab.simulation.physics.bodies import Body
from bullet_lab.simulation.world.description import Model, PluginTag
from bullet_lab.simulation.world.xml import ElementReader, TagReader

LOG = logging.getLogger(__name__)


class StepNoise:
    """Random numbers that depend only on a seed, a name and the simulated time.

    So a sensor's reading does not depend on earlier listeners, and a world that is run again
    gives the same readings.
    """

    def __init__(self, seed: int, name: str):
        key = np.random.SeedSequence([seed, crc32(name.encode())]).generate_state(2, np.uint64)
        self._bits = np.random.Philox(key=key)
        self._generator = np.random.Generator(self._bits)
        self._state = self._bits.state

    def at(self, step: int) -> np.random.Generator:
        """Return a generator for one step; the next call changes it."""
        # The generator adds one to its counter with every four numbers; this is the highest word.
        self._state["state"]["counter"][3] = step
        self._bits.state = self._state
        return self._generator


NAMESPACE = "robotNamespace"
# Names that ROS allows.
TOPIC = re.compile(r"[~/A-Za-z][\w/]*", re.ASCII)
# Tags that Gazebo's plugins ignore, or that have no use here.
QUIET_TAGS = frozenset((NAMESPACE, "rosDebugLevel", "alwaysOn", "visualize"))


# The physics that plugins need, with a pattern of their files.
PHYSICS = {
    "thrust of propellers": "rotors_.*motor|multirotor|quadrotor_(propulsion|simple)|ardupilot",
    "lift and drag in air": "liftdrag|quadrotor_aerodynamics|fw_dynamics|parachute",
    "wind": "wind",
    "buoyancy and drag of water": "buoyancy|underwater_object|hydrodynamic|usv_dynamics",
    "thrusters and fins": "thruster|fin_plugin",
    "slip of wheels": "wheel_?slip",
    "tracks": "track(ed)?_?vehicle",
    "a harness": "harness",
    "grasping": "gripper|grasp|vacuum|sticky",
    "a framework of its own for joints": "fetch_gazebo|ros_controller_manager|baxter_gazebo",
    "motion of an obstacle (docs/plugins/path.md has one)": "obstacle",
}


class PluginError(LabError):
    """A plugin's tags are invalid, or a command is refused."""


@dataclass(frozen=True)
class Mount(TagReader):
    """The model and the tag that a plugin belongs to, and what it needs of the simulation.

    Attributes:
        model: the model.
        bodies: of the model, by root link.
        plugin: the tag.
        simulation: with its `seed`, `world`, `renderer()` and `shape_name(body, link, place)`.
        namespace: of relative topics.
        tf_prefix: prefix of the names of the robot's frames.
    """

    model: Model
    bodies: Mapping[str, Body]
    plugin: PluginTag
    simulation: Any
    namespace: str
    tf_prefix: str
    _read: set[str] = field(default_factory=set)

    @property
    def body(self) -> Body:
        """The body of the first link of the model, or of the nested model with the plugin."""
        scope = self.plugin.scope
        if not scope:
            return self.bodies[self.model.root_links()[0].name]
        first = next(link.name for link in self.model.links if link.name.startswith(scope))
        return AttachedFrame.of(self.model, self.bodies.values(), first).body

    def text(self, key: str, default: str = "") -> str:
        self._read.add(key)
        return self.plugin.tags.get(key) or default

    def required(self, tag: str) -> str:
        """Return the text of a tag; raises PluginError if it is missing."""
        text = self.text(tag)
        if not text:
            raise PluginError(f"{self.where(tag)}: is missing")
        return text

    def vector(self, tag: str) -> Vector:
        """Return the three finite numbers in a tag, zeros without it."""
        return self.numbers(tag, 3, "0 0 0")

    def doubt(self, error: LabError) -> None:
        LOG.warning("%s; the default is used", error)

    def unread_tags(self) -> tuple[str, ...]:
        """Return the tags that the plugin has not read, without those that have no effect."""
        return tuple(tag for tag in self.plugin.tags if tag not in self._read | QUIET_TAGS)

    def topic(self, name: str) -> str:
        """Return a topic's name within the plugin's namespace; raises PluginError if invalid."""
        is_full = name.startswith("/") or not self.namespace
        full = name if is_full else f"/{self.namespace}/{name}"
        if not TOPIC.fullmatch(full):
            raise PluginError(f"{self.name()}: '{full}' is not a valid topic name")
        return full

    def noise(self, part: str = "") -> StepNoise:
        """Return the noise of this plugin, or of a part of it; other robots do not change it."""
        return StepNoise(self.simulation.seed, f"{self.model.name}/{self.plugin.name}{part}")

    def frame(self, name: str) -> str:
        """Return a frame's name on TF, with the robot's prefix as in tf::resolve."""
        if name.startswith("/") or not self.tf_prefix:
            return name.lstrip("/")
        return f"{self.tf_prefix.strip('/')}/{name}"

    def scoped(self, name: str) -> str:
        """Return the full name of a link or joint; a nested model's own names come first."""
        model, full = self.model, self.plugin.scope + name
        joints = (joint.name for joint in model.joints)
        return full if full in {*model.links_by_name(), *model.frames, *joints} else name

    def attached(self, link: str, offset: Pose = ORIGIN) -> AttachedFrame:
        """Return a frame that is fixed to a link; as `AttachedFrame.of`, but with PluginError."""
        try:
            return AttachedFrame.of(self.model, self.bodies.values(), self.scoped(link), offset)
        except KeyError:
            raise PluginError(f"{self.name()}: no link '{link}'") from None

    def name(self) -> str:
        """Return the names of model and plugin, for messages."""
        return f"model '{self.model.name}': plugin '{self.plugin.name}'"

    def where(self, key: str) -> str:
        return f"{self.name()}: <{key}>"

    def sensor(self, tag: str, kind: str) -> SensorTag:
        """Return the sensor of the model that a tag names; raises PluginError."""
        name, own = self.required(tag), self.plugin
        for found in self.model.plugins:
            is_sensor = found.sensor is not None and found.sensor.get("name") == name
            if is_sensor and found.scope == own.scope:
                holder = replace(found, filename=own.filename, name=own.name)
                return SensorTag(replace(self, plugin=holder), (kind,))
        raise PluginError(f"{self.where(tag)}: the model has no sensor '{name}'")

    def require_moving(self) -> None:
        """Raise PluginError if the model is static."""
        if self.model.static:
            raise PluginError(f"{self.name()} needs a model that can move, but it is static")


class SensorTag(ElementReader):
    """The `<sensor>` element around a plugin; raises PluginError for one of another kind."""

    def __init__(self, mount: Mount, kinds: tuple[str, ...]):
        sensor, where = mount.plugin.sensor, mount.name()
        if sensor is None or sensor.get("type") not in kinds:
            found = "" if sensor is None else f', not "{sensor.get("type")}"'
            wanted = f'<sensor type="{kinds[0]}">{found}'
            raise PluginError(f"{where} ({mount.plugin.filename}) needs a {wanted}")
        super().__init__(sensor, f"{where}: <sensor>")
        self._mount = mount

    def count(self, path: str, default: int, most: int) -> int:
        """Return the whole number from 1 to `most` in a tag; raises LabError."""

        def is_wrong(values: tuple[float, ...]) -> bool:
            return not (values[0].is_integer() and 1 <= values[0] <= most)

        reason = f"{{:g}} is not a whole number in 1 … {most}"
        return int(self.numbers(path, 1, repr(default), is_wrong, reason)[0])

    def doubt(self, error: LabError) -> None:  # noqa: D102
        self._mount.doubt(error)

    def place(self, offset: Pose = ORIGIN) -> AttachedFrame:
        """Return a frame at an offset from the sensor, fixed to its link; raises LabError."""
        link = self._mount.plugin.link or self._mount.model.canonical_link().name
        return self._mount.attached(link, self.pose() * offset)

    def slower(self, tag: str, default: float) -> Schedule:
        """Return the slower of the schedules for the sensor's update_rate and a plugin's tag."""
        own, other = self.schedule("update_rate", 0.0), self._mount.schedule(tag, default)
        return max(other, own, key=lambda schedule: schedule.period)


@dataclass(frozen=True)
class Input:
    """A topic with commands; `handle(command)` raises PluginError to refuse one.

    With `alone`, commands are refused while several nodes publish them.
    """

    topic: str
    kind: type
    handle: Callable[[Any], None]
    alone: bool = False


class Output:
    """A topic with samples; `kind` is the class of the samples."""

    def __init__(self, topic: str, kind: type):
        self.topic = topic
        self.kind = kind
        self._listeners: list[Callable[[Any], None]] = []
        self._wanted: list[Callable[[], bool]] = []

    def connect(
        self, listener: Callable[[Any], None], wanted: Callable[[], bool] = lambda: True
    ) -> None:
        """Call `listener(sample)` with samples from now on.

        While no `wanted()` is true, plugins may save the work for a sample.
        """
        self._listeners.append(listener)
        self._wanted.append(wanted)

    @property
    def wanted(self) -> bool:
        """Whether anybody wants samples now."""
        return any(wanted() for wanted in self._wanted)

    def send(self, sample: Any) -> None:
        """Call all listeners with a sample."""
        for listener in self._listeners:
            listener(sample)


class Device:
    """What takes commands and sends samples: a plugin, or a controller of one.

    Attributes:
        inputs: topics with commands for it.
        outputs: topics with its samples.
    """

    inputs: tuple[Input, ...] = ()
    outputs: tuple[Output, ...] = ()

    def topic(self, name: str) -> str:
        """Return the full name of a topic of the device."""
        raise NotImplementedError

    def input(
        self, topic: str, kind: type, handle: Callable[[Any], None], alone: bool = False
    ) -> None:
        """Take the commands of a topic; see `Input`."""
        self.inputs += (Input(self.topic(topic), kind, handle, alone),)

    def output(self, topic: str, kind: type, offered: bool = True) -> Output:
        """Return a new output on a topic.

        It is added to `outputs` if it is offered; otherwise, it never has a listener.
        """
        made = Output(self.topic(topic), kind)
        if offered:
            self.outputs += (made,)
        return made

    def placed(self) -> None:
        """Handle that the model was placed somewhere else."""

    def reset(self, step: int) -> None:
        """Start anew after a reset of the model; simulated time is now `step`."""


# The classes of plugins by the names of files.
_KINDS: dict[str, type[Plugin]] = {}


class Plugin(Device):
    """Base of all plugins.

    Attributes:
        filenames: the files of Gazebo's plugins that the class simulates.
        named_by_model: whether the namespace is the model's name if the plugin has no
            robotNamespace, and if it has an empty one: Gazebo's plugins differ.
        acts: whether `before_step` does anything; the loop skips it otherwise.
        schedule: when `produce` is due; None for a plugin without samples.
        refused: names and types of controllers that could not be loaded.
    """

    filenames = ()
    named_by_model = (False, False)
    acts = False

    def __init_subclass__(cls, **arguments: Any):
        super().__init_subclass__(**arguments)
        _KINDS.update(dict.fromkeys(cls.__dict__.get("filenames", ()), cls))

    def __init__(self, mount: Mount):
        self.mount = mount
        self.schedule: Schedule | None = None
        self.refused: dict[str, str] = {}

    @property
    def driven(self) -> Iterable[str]:
        """The names of the joints that motors of the plugin drive."""
        return ()

    @classmethod
    def split(cls, tag: PluginTag) -> tuple[PluginTag, ...]:
        """Return the tags that stand for one: several if its sensor has several cameras."""
        return (tag,)

    def topic(self, name: str) -> str:
        return self.mount.topic(name)

    def before_step(self, step: int) -> None:
        """Act on the model before the physics advances from `step` to `step + 1`."""

    def prepare(self) -> None:
        """Ask, before anybody produces, for what costs less together with others."""

    def produce(self, step: int) -> None:
        """Measure and send, at the simulated time `step`."""


class Sensor(Plugin, ABC):
    """A plugin with one output, which measures only while the output has a listener."""

    def __init__(self, mount: Mount, topic: str, kind: type):
        super().__init__(mount)
        self._output = self.output(topic, kind)
        self._noise = mount.noise()

    def produce(self, step: int) -> None:
        """Send a sample if it is wanted."""
        if self._output.wanted:
            self._output.send(self.measure(step))

    @abstractmethod
    def measure(self, step: int) -> Any:
        """Return a sample of the simulated time `step`."""


def known_plugins() -> tuple[str, ...]:
    """Return the file names of the plugins that are simulated."""
    return tuple(sorted(_KINDS))


def kind_of(tag: PluginTag) -> type[Plugin] | None:
    """Return the class that simulates a tag, or None."""
    # Gazebo accepts the name without .so as well.
    return _KINDS.get(tag.filename) or _KINDS.get(f"{tag.filename}.so")


def namespace_of(tag: PluginTag, model: str) -> str:
    """Return the namespace of a model's plugin, without slashes at its ends.

    That is its robotNamespace, or the default of its kind.
    """
    kind, given = kind_of(tag), tag.tags.get(NAMESPACE)
    if kind is not None and not given and kind.named_by_model[given is not None]:
        return model
    return (given or "").strip("/")


def warn_of_rivals(plugin: Plugin, others: Iterable[Plugin]) -> None:
    """Warn of joints that both a plugin and another one of its model drive."""
    for other in others:
        joints = ", ".join(sorted(set(plugin.driven) & set(other.driven)))
        if joints and other is not plugin:
            both = f"{other.mount.name()} and plugin '{plugin.mount.plugin.name}'"
            LOG.warning("%s both drive %s: each undoes what the other does", both, joints)


def missing_physics(files: Iterable[str]) -> list[str]:
    """Return the physics that the plugins of some files need and that is not simulated.

    >>> missing_physics(["libLiftDragPlugin.so", "librotors_gazebo_motor_model.so"])
    ['thrust of propellers', 'lift and drag in air']
    """
    names = " ".join(files).lower()
    return [need for need, pattern in PHYSICS.items() if re.search(pattern, names)]


def skipped_line(model: str, tags: Sequence[PluginTag], others: Iterable[Plugin]) -> str:
    """Return the warning about skipped plugins of a model that has others."""
    files = Counter(tag.filename for tag in tags)
    what = f"plugin '{tags[0].name}' ({tags[0].filename}) is not simulated and skipped"
    if len(tags) > 1:
        counted = (f"{count} {name}" if count > 1 else name for name, count in files.items())
        what = f"{len(tags)} plugins are not simulated and skipped ({', '.join(counted)})"
    needs = missing_physics(files)
    drives = any(plugin.acts and not isinstance(plugin, Sensor) for plugin in others)
    missing = f"; missing: {', '.join(needs)}" if needs else ""
    idle = "" if drives else "; no other plugin moves the model"
    return f"model '{model}': {what}{missing}{idle}"


for _module in pkgutil.iter_modules(__path__, f"{__name__}."):
    importlib.import_module(_module.name)
