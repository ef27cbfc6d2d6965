"""A world that is stepped: models, what their plugins do, and simulated time.

Example:
    >>> from bullet_lab.simulation.simulation import Simulation
    >>> from bullet_lab.simulation.samples import PlanarCommand
    >>> with Simulation.of("package://bullet_lab/worlds/empty.world") as simulation:
    ...     robot = simulation.spawn("package://bullet_lab/urdf/block_robot.urdf")
    ...     robot.command("cmd_vel", PlanarCommand(vx=0.2))
    ...     simulation.run_for(10.0)
    ...     print(f"{robot.pose().position[0]:.3f}")
    1.902
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple, Union

from bullet_lab.errors import LabError
from bullet_lab.simulation.description import Model, Plugin, World
from bullet_lab.simulation.devices import Device, Mount, known_plugins, make_device
from bullet_lab.simulation.physics import Body, Physics
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.resources import ResourceFinder
from bullet_lab.simulation.schedule import STEPS_PER_SECOND, Schedule
from bullet_lab.simulation.sdf_reader import read_world_file
from bullet_lab.simulation.urdf_reader import read_urdf_file

LOG = logging.getLogger(__name__)

# Of the length of a quaternion from outside, which may have been rounded.
QUATERNION_TOLERANCE = 1e-3


class SimulationError(LabError):
    """Something is asked of the simulation that it cannot do."""


@dataclass(frozen=True)
class Timer:
    """Something that is called at its own rate."""

    schedule: Schedule
    produce: Callable[[int], None]


class ModelInstance:
    """A model in a running simulation."""

    def __init__(
        self, model: Model, bodies: Mapping[str, Body], devices: Tuple[Device, ...]
    ):
        self.model = model
        self.bodies = bodies
        self.devices = devices

    @property
    def name(self) -> str:
        """The model's name in the world."""
        return self.model.name

    def pose(self) -> Pose:
        """Return the pose of the model's frame in the world."""
        root = self.model.root_links()[0]
        return self.bodies[root.name].pose() * root.pose.inverse()

    def place(self, pose: Pose) -> None:
        """Put the model somewhere, at rest; raises SimulationError for an impossible pose."""
        _check_pose(pose, self.name)
        for root in self.model.root_links():
            self.bodies[root.name].place(pose * root.pose)
        for device in self.devices:
            device.placed()

    def command(self, topic: str, command: Any) -> None:
        """Give a command to the devices that listen to a topic.

        Raises:
            SimulationError: no device does.
            DeviceError: the device refuses it.
        """
        listening = [i for device in self.devices for i in device.inputs if i.topic == topic]
        if not listening:
            raise SimulationError(f"model '{self.name}' has no input '{topic}'")
        for entry in listening:
            entry.handle(command)

    def listen(self, topic: str, listener: Callable[[Any], None]) -> None:
        """Call `listener(sample)` with whatever the model's devices send on a topic.

        Raises:
            SimulationError: none sends there.
        """
        sending = [o for device in self.devices for o in device.outputs if o.topic == topic]
        if not sending:
            raise SimulationError(f"model '{self.name}' has no output '{topic}'")
        for output in sending:
            output.connect(listener)


class Simulation:
    """Models in a world, advanced in steps of 1 ms.

    The same calls in the same order give the same numbers, to the last bit. Not thread-safe:
    PyBullet wants all calls from one thread at a time.
    """

    def __init__(self, world: Optional[World] = None):
        """Load a world; an empty one with gravity if none is given."""
        self.world = world or World("default")
        self.step = 0
        self._physics = Physics(self.world.gravity)
        self._instances: Dict[str, ModelInstance] = {}
        self._acting: List[Device] = []
        self._measuring: List[Union[Device, Timer]] = []
        self._timers: List[Union[Device, Timer]] = []
        try:
            for model in self.world.models:
                self.add(model)
        except LabError:
            self.close()
            raise

    @classmethod
    def of(cls, world: str) -> Simulation:
        """Load the world file that a path or URI names; raises LabError."""
        return cls(read_world_file(ResourceFinder.anywhere().find(world)))

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """Give memory and files back."""
        self._physics.close()

    @property
    def client(self) -> int:
        """The PyBullet client, for what this class does not offer."""
        return self._physics.client

    @property
    def seconds(self) -> float:
        """Simulated time in seconds."""
        return self.step / STEPS_PER_SECOND

    @property
    def models(self) -> Mapping[str, ModelInstance]:
        """All models by name."""
        return self._instances

    def spawn(
        self, urdf: str, name: str = "", pose: Optional[Pose] = None, namespace: str = ""
    ) -> ModelInstance:
        """Read a robot from the URDF file that a path or URI names and add it; see `add`."""
        model = read_urdf_file(ResourceFinder.anywhere().find(urdf))
        return self.add(model, name, pose, namespace)

    def add(
        self, model: Model, name: str = "", pose: Optional[Pose] = None, namespace: str = ""
    ) -> ModelInstance:
        """Put a model into the world.

        Args:
            model: what to add.
            name: its name in the world; the model's own if empty.
            pose: of the model's frame in the world; the model's own pose if None.
            namespace: robotNamespace of every plugin that has none.

        Raises:
            LabError: the name is taken, or the model or one of its plugins makes no sense.
        """
        name = name or model.name
        if name in self._instances:
            raise SimulationError(f"a model named '{name}' exists already")
        if pose is not None:
            _check_pose(pose, name)
        plugins = tuple(_in_namespace(plugin, namespace) for plugin in model.plugins)
        model = replace(model, name=name, pose=pose or model.pose, plugins=plugins)
        bodies = self._physics.add(model)
        try:
            devices = self._make_devices(model, bodies)
        except LabError:
            self._physics.remove(bodies)
            raise
        instance = ModelInstance(model, bodies, devices)
        self._instances[name] = instance
        self._acting.extend(device for device in devices if device.acts)
        self._measuring.extend(device for device in devices if device.schedule is not None)
        return instance

    def remove(self, name: str) -> None:
        """Take a model out of the world; raises SimulationError for an unknown name."""
        instance = self._instances.pop(name, None)
        if instance is None:
            raise SimulationError(f"there is no model '{name}'")
        self._physics.remove(instance.bodies)
        self._acting = [d for d in self._acting if d not in instance.devices]
        self._measuring = [d for d in self._measuring if d not in instance.devices]

    def every(self, rate: float, call: Callable[[int], None]) -> None:
        """Call `call(step)` `rate` times per simulated second, before devices send theirs.

        Raises:
            ScheduleError: the rate is not within 0 … 1000 Hz.
        """
        self._timers.append(Timer(Schedule(rate, self.step), call))

    def run_for(self, seconds: float) -> None:
        """Advance by a simulated duration, rounded to whole steps."""
        self.run_until(self.step + round(seconds * STEPS_PER_SECOND))

    def run_until(self, step: int) -> None:
        """Advance to a step; samples are sent as they fall due on the way."""
        timers = self._timers + self._measuring
        while self.step < step:
            self._march(min([timer.schedule.next_step for timer in timers] + [step]))
            for timer in timers:
                if timer.schedule.next_step <= self.step:
                    timer.schedule.advance()
                    timer.produce(self.step)

    def reset_world(self) -> None:
        """Put all models back to where they were added; time goes on."""
        for instance in self._instances.values():
            instance.place(instance.model.pose)
            for device in instance.devices:
                device.reset(self.step)

    def reset_simulation(self) -> None:
        """Put all models back and let time start again at 0."""
        self.step = 0
        self.reset_world()
        for timer in self._timers + self._measuring:
            timer.schedule.restart(0)

    def _march(self, stop: int) -> None:
        """Advance the physics; this is the loop that decides the speed."""
        acting = [device.before_step for device in self._acting]
        advance = self._physics.step
        step = self.step
        while step < stop:
            for act in acting:
                act(step)
            advance()
            step += 1
        self.step = step

    def _make_devices(self, model: Model, bodies: Mapping[str, Body]) -> Tuple[Device, ...]:
        gravity = -self.world.gravity[2]
        devices = []
        for plugin in model.plugins:
            device = make_device(Mount(model, bodies, plugin, gravity))
            if device is None:
                LOG.warning(
                    "model '%s': plugin '%s' (%s) is not simulated and skipped; known are %s",
                    model.name,
                    plugin.name,
                    plugin.filename,
                    ", ".join(known_plugins()),
                )
            else:
                device.reset(self.step)
                if device.schedule is not None:
                    device.schedule.restart(self.step)
                devices.append(device)
        return tuple(devices)


def _check_pose(pose: Pose, model: str) -> None:
    if not all(map(math.isfinite, pose.position + pose.quaternion)):
        raise SimulationError(f"model '{model}': its pose is not finite")
    length = math.sqrt(sum(value * value for value in pose.quaternion))
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise SimulationError(f"model '{model}': a quaternion of length {length:g}, not 1")


def _in_namespace(plugin: Plugin, namespace: str) -> Plugin:
    if not namespace or plugin.tags.get("robotNamespace"):
        return plugin
    return replace(plugin, tags={**plugin.tags, "robotNamespace": namespace})
