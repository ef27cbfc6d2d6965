"""What the plugin of a robot is made of in this simulation.

A device belongs to one model and stands for one `<plugin>` tag. It may act before each physics
step, and it produces samples at its own rate. It knows nothing of ROS: it names the topics it
would use, takes commands through `inputs` and sends samples through `outputs`; whoever wants
them (the bridge, a test, a script) connects to those. A new kind of device is one class with
`@device("libgazebo_ros_….so")` above it, imported in `devices/__init__.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable, ClassVar, Dict, List, Mapping, Optional, Set, Tuple, Type
from zlib import crc32

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.core.schedule import Schedule, ScheduleError
from bullet_lab.errors import LabError
from bullet_lab.simulation.physics.attached_frame import ORIGIN, AttachedFrame
from bullet_lab.simulation.physics.physics import Body
from bullet_lab.simulation.rendering.renderer import Renderer
from bullet_lab.simulation.world.description import Model, Plugin
from bullet_lab.simulation.world.xml import boolean, number, numbers


class StepNoise:
    """Random numbers that follow from a seed, a name and the simulated time, and nothing else.

    What a sensor reads at some time does not depend on who listened before, and a world that
    is run again gives the same readings.

    Args:
        seed: any whole number from 0 on.
        name: of whoever wants the numbers.
    """

    def __init__(self, seed: int, name: str):
        key = np.random.SeedSequence([seed, crc32(name.encode())]).generate_state(2, np.uint64)
        self._bits = np.random.Philox(key=key)
        self._generator = np.random.Generator(self._bits)
        self._state = self._bits.state

    def at(self, step: int) -> np.random.Generator:
        """Return a generator for one step; the next call changes it."""
        # The highest word of a counter that is counted up with every four numbers.
        self._state["state"]["counter"][3] = step
        self._bits.state = self._state
        return self._generator


# Tags that Gazebo's plugins themselves pass over, or that only they have a use for.
QUIET_TAGS = frozenset(("robotNamespace", "rosDebugLevel", "alwaysOn", "visualize"))


class DeviceError(LabError):
    """A plugin's tags make no device, or a command is refused."""


def _nothing_to_see() -> Renderer:
    raise DeviceError("there is no world to take pictures of")


def _nothing_to_touch(_body: int, _link: int, _place: Vector) -> str:
    raise DeviceError("there is no world to touch")


@dataclass(frozen=True)
class Mount:
    """What a device is fixed to: a model, its bodies by root link, and its plugin tag.

    `gravity` is in m/s² and points down, `seed` is the simulation's, `tf_prefix` stands
    before the names of the robot's frames, `renderer` gives what draws its pictures, and
    `name_shape` the full name of the shape at a place on a link (`TouchedShapes.name`).
    """

    model: Model
    bodies: Mapping[str, Body]
    plugin: Plugin
    gravity: float
    seed: int = 0
    tf_prefix: str = ""
    renderer: Callable[[], Renderer] = field(default=_nothing_to_see, repr=False)
    name_shape: Callable[[int, int, Vector], str] = field(default=_nothing_to_touch, repr=False)
    _read: Set[str] = field(default_factory=set, repr=False)

    @property
    def body(self) -> Body:
        """The body of the model's first link."""
        return self.bodies[self.model.root_links()[0].name]

    def text(self, tag: str, default: str = "") -> str:
        """Return what a tag of the plugin says, or the default."""
        self._read.add(tag)
        return self.plugin.tags.get(tag) or default

    def number(self, tag: str, default: float) -> float:
        """Return the finite number in a tag; raises XmlError."""
        text = self.text(tag)
        return default if not text else number(text, self.where(tag))

    def boolean(self, tag: str, default: bool) -> bool:
        """Return the truth value in a tag; raises XmlError."""
        text = self.text(tag)
        return default if not text else boolean(text, self.where(tag))

    def vector(self, tag: str) -> Vector:
        """Return the three finite numbers in a tag, zeros without it; raises XmlError."""
        return numbers(self.text(tag, "0 0 0"), 3, self.where(tag))

    def unread_tags(self) -> Tuple[str, ...]:
        """Return the tags of the plugin that nobody has asked for, but those that mean nothing."""
        return tuple(tag for tag in self.plugin.tags if tag not in self._read | QUIET_TAGS)

    def schedule(self, tag: str, default: float) -> Schedule:
        """Return the schedule for the rate (Hz) in a tag; raises LabError."""
        try:
            return Schedule(self.number(tag, default))
        except ScheduleError as error:
            raise DeviceError(f"{self.where(tag)}: {error}") from error

    def topic(self, name: str) -> str:
        """Return a topic's name within the plugin's robotNamespace."""
        namespace = self.text("robotNamespace").strip("/")
        return name if name.startswith("/") or not namespace else f"/{namespace}/{name}"

    def noise(self) -> StepNoise:
        """Return the noise of this device.

        It follows from the simulation's seed and the names of model and plugin, so that another
        robot in the world does not change it.
        """
        return StepNoise(self.seed, f"{self.model.name}/{self.plugin.name}")

    def frame(self, name: str) -> str:
        """Return a frame's name on TF: with the robot's prefix, as tf::resolve has it."""
        if name.startswith("/") or not self.tf_prefix:
            return name.lstrip("/")
        return f"{self.tf_prefix.strip('/')}/{name}"

    def attached(self, link: str, offset: Pose = ORIGIN) -> AttachedFrame:
        """Return a frame that is fixed to a link, which may have been merged into another.

        Args:
            link: the link's name in the description.
            offset: pose of the frame in the link's frame.

        Raises:
            DeviceError: there is no such link.
        """
        keeper, pose = self.model.frames.get(link, (link, ORIGIN))
        for body in self.bodies.values():
            if any(part.name == keeper for part in body.links):
                return AttachedFrame(body, keeper, pose * offset)
        raise DeviceError(
            f"model '{self.model.name}': plugin '{self.plugin.name}': no link '{link}'"
        )

    def where(self, tag: str) -> str:
        """Name a tag in messages."""
        return f"model '{self.model.name}': plugin '{self.plugin.name}': <{tag}>"


@dataclass(frozen=True)
class Input:
    """A topic that a device listens to; `handle(command)` raises DeviceError to refuse one."""

    topic: str
    kind: type
    handle: Callable[[Any], None]


class Output:
    """A topic that a device speaks on; `kind` is the class of its samples."""

    def __init__(self, topic: str, kind: type):
        self.topic = topic
        self.kind = kind
        self._listeners: List[Callable[[Any], None]] = []
        self._wanted: List[Callable[[], bool]] = []

    def connect(
        self, listener: Callable[[Any], None], wanted: Callable[[], bool] = lambda: True
    ) -> None:
        """Call `listener(sample)` with samples from now on.

        Args:
            listener: takes a sample.
            wanted: says whether samples are of any use now; devices spare themselves those
                that nobody wants.
        """
        self._listeners.append(listener)
        self._wanted.append(wanted)

    @property
    def wanted(self) -> bool:
        """Whether anybody wants samples now."""
        return any(wanted() for wanted in self._wanted)

    def send(self, sample: Any) -> None:
        """Give a sample to all that are connected."""
        for listener in self._listeners:
            listener(sample)


class Device:
    """Base of all devices.

    Attributes:
        inputs: topics with commands for it.
        outputs: topics with what it measures.
        schedule: when `produce` is due; None for a device that measures nothing.
        gravity: in m/s², down; may be changed from outside.
        acts: whether `before_step` does anything; the loop skips those that do not.
    """

    acts: ClassVar[bool] = False

    def __init__(self, mount: Mount):
        self.mount = mount
        self.gravity = mount.gravity
        self.inputs: Tuple[Input, ...] = ()
        self.outputs: Tuple[Output, ...] = ()
        self.schedule: Optional[Schedule] = None

    def before_step(self, step: int) -> None:
        """Act on the model before the physics advances from `step` to `step + 1`."""

    def produce(self, step: int) -> None:
        """Measure and send, at the simulated time `step`."""

    def placed(self) -> None:
        """Take note that the model was put somewhere else."""

    def reset(self, step: int) -> None:
        """Start anew after the model was put back; simulated time is now `step`."""


_KINDS: Dict[str, Type[Device]] = {}


def device(*filenames: str) -> Callable[[Type[Device]], Type[Device]]:
    """Register a class as what the plugins with these file names do."""

    def register(kind: Type[Device]) -> Type[Device]:
        _KINDS.update(dict.fromkeys(filenames, kind))
        return kind

    return register


def known_plugins() -> Tuple[str, ...]:
    """Return the file names of the plugins that are simulated."""
    return tuple(sorted(_KINDS))


def make_device(mount: Mount) -> Optional[Device]:
    """Return the device for a plugin, or None where its kind is not simulated.

    Raises:
        LabError: a tag of the plugin cannot be read.
    """
    # Gazebo accepts the name without .so as well.
    filename = mount.plugin.filename
    kind = _KINDS.get(filename) or _KINDS.get(f"{filename}.so")
    return None if kind is None else kind(mount)
