"""A world that is stepped: models, what their plugins do, and simulated time.

Example:
    >>> from bullet_lab.simulation.simulation import Simulation
    >>> from bullet_lab.simulation.plugins.samples import PlanarCommand
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
import time
from dataclasses import dataclass, replace
from typing import Callable, Dict, List, Mapping, Optional, Tuple, Union

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.core.schedule import STEPS_PER_SECOND, Schedule
from bullet_lab.errors import LabError
from bullet_lab.simulation.forces import Forces
from bullet_lab.simulation.model_instance import ModelInstance, SimulationError, check_pose
from bullet_lab.simulation.physics.contacts import Contact, TouchedShapes, contacts_of
from bullet_lab.simulation.physics.physics import Body, Physics
from bullet_lab.simulation.plugins import Device, Mount, known_plugins, make_device
from bullet_lab.simulation.rendering.renderer import Renderer
from bullet_lab.simulation.rendering.surfaces import check_textures
from bullet_lab.simulation.world.description import Model, ModelState, Plugin, World
from bullet_lab.simulation.world.meshes import check_visible_meshes
from bullet_lab.simulation.world.proportions import check_proportions
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.urdf import read_urdf_file

__all__ = ["ModelInstance", "Simulation", "SimulationError", "Snapshot", "Timer"]

LOG = logging.getLogger(__name__)

TfPrefix = Union[str, Callable[[str], str]]


@dataclass(frozen=True)
class Snapshot:
    """A world at a step: its models, and where all their parts are."""

    world: World
    step: int
    models: Tuple[Tuple[Model, ModelState], ...]


@dataclass(frozen=True)
class Timer:
    """Something that is called at its own rate."""

    schedule: Schedule
    produce: Callable[[int], None]


class Simulation:
    """Models in a world, advanced in steps of 1 ms.

    The same calls in the same order give the same numbers, to the last bit. Not thread-safe:
    PyBullet wants all calls from one thread at a time.
    """

    def __init__(self, world: Optional[World] = None, seed: int = 0):
        """Load a world; an empty one with gravity if none is given.

        Args:
            world: what to load.
            seed: of the noise of all sensors.
        """
        self.world = world or World("default")
        self._renderer: Optional[Renderer] = None
        self.seed = seed
        self.step = 0
        self._physics = Physics(self.world.gravity)
        self._instances: Dict[str, ModelInstance] = {}
        # Names of the models by the unique ids of their bodies.
        self._owners: Dict[int, str] = {}
        self._touched_shapes = TouchedShapes(lambda body: self._instances[self._owners[body]])
        self._acting: List[Device] = []
        self._measuring: List[Union[Device, Timer]] = []
        self._timers: List[Union[Device, Timer]] = []
        self._on_failure: Optional[Callable[[str, LabError], None]] = None
        self._spent: Dict[Union[Device, Timer], float] = {}
        self.forces = Forces()
        try:
            for model in self.world.models:
                instance = self.add(model)
                if model.name in self.world.states:
                    instance.restore(self.world.states[model.name])
        except LabError:
            self.close()
            raise

    @classmethod
    def of(cls, world: str, seed: int = 0) -> Simulation:
        """Load the world file that a path or URI names; raises LabError."""
        return cls(read_world_file(ResourceFinder.anywhere().find(world)), seed)

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """Give memory and files back."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
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

    def renderer(self) -> Renderer:
        """Return what draws this world; nothing is loaded for it before it is asked for.

        Raises:
            RendererError: nothing can be drawn here.
        """
        if self._renderer is None:
            self._renderer = Renderer(self.world, self._instances)
        return self._renderer

    def spawn(
        self,
        urdf: str,
        name: str = "",
        pose: Optional[Pose] = None,
        namespace: str = "",
        tf_prefix: TfPrefix = "",
    ) -> ModelInstance:
        """Read a robot from the URDF file that a path or URI names and add it; see `add`."""
        model = read_urdf_file(ResourceFinder.anywhere().find(urdf))
        return self.add(model, name, pose, namespace, tf_prefix)

    def add(
        self,
        model: Model,
        name: str = "",
        pose: Optional[Pose] = None,
        namespace: str = "",
        tf_prefix: TfPrefix = "",
    ) -> ModelInstance:
        """Put a model into the world.

        Args:
            model: what to add.
            name: its name in the world; the model's own if empty.
            pose: of the model's frame in the world; the model's own pose if None.
            namespace: robotNamespace of every plugin that has none.
            tf_prefix: what stands before the names of its frames on TF; or what gives that for
                the robotNamespace of a plugin.

        Raises:
            LabError: the name is taken, or the model or one of its plugins makes no sense.
        """
        name = name or model.name
        if name in self._instances:
            raise SimulationError(f"a model named '{name}' exists already")
        if not name.isprintable():
            raise SimulationError(f"a model cannot be called {name!r}")
        if pose is not None:
            check_pose(pose, name)
        check_proportions(model)
        plugins = tuple(_in_namespace(plugin, namespace) for plugin in model.plugins)
        model = replace(model, name=name, pose=pose or model.pose, plugins=plugins)
        check_visible_meshes(model)
        check_textures(model)
        bodies = self._physics.add(model)
        try:
            devices = self._make_devices(model, bodies, tf_prefix)
        except LabError:
            self._physics.remove(bodies)
            raise
        instance = ModelInstance(model, bodies, devices)
        self._instances[name] = instance
        self._owners.update((body.unique_id, name) for body in bodies.values())
        self._acting.extend(device for device in devices if device.acts)
        self._measuring.extend(device for device in devices if device.schedule is not None)
        return instance

    def remove(self, name: str) -> None:
        """Take a model out of the world; raises SimulationError for an unknown name."""
        instance = self._instances.pop(name, None)
        if instance is None:
            raise SimulationError(f"there is no model '{name}'")
        self._physics.remove(instance.bodies)
        self.forces.forget(instance)
        for device in instance.devices:
            self._spent.pop(device, None)
        for body in instance.bodies.values():
            del self._owners[body.unique_id]
        self._acting = [d for d in self._acting if d not in instance.devices]
        self._measuring = [d for d in self._measuring if d not in instance.devices]

    def contacts(self, name: str) -> Dict[str, Contact]:
        """Return what a model touched in the last step, by the other models' names.

        What stands on the floor touches the floor.

        Raises:
            SimulationError: there is no such model.
        """
        instance = self._instances.get(name)
        if instance is None:
            raise SimulationError(f"there is no model '{name}'")
        return contacts_of(instance.bodies.values(), self._owners, name)

    def set_gravity(self, gravity: Vector) -> None:
        """Change gravity, in m/s²; raises SimulationError for what is not finite."""
        if not all(map(math.isfinite, gravity)):
            raise SimulationError("gravity is not finite")
        self.world = replace(self.world, gravity=gravity)
        self._physics.set_gravity(gravity)
        for instance in self._instances.values():
            for device in instance.devices:
                device.gravity = -gravity[2]

    def snapshot(self) -> Snapshot:
        """Return all that makes up the present state, to be written by whoever has time."""
        models = tuple((i.model, i.state()) for i in self._instances.values())
        return Snapshot(self.world, self.step, models)

    def every(self, rate: float, call: Callable[[int], None]) -> None:
        """Call `call(step)` `rate` times per simulated second, before devices send theirs.

        Raises:
            ScheduleError: the rate is not within 0 … 1000 Hz.
        """
        self._timers.append(Timer(Schedule(rate, self.step), call))

    def go_on_after(self, failed: Callable[[str, LabError], None]) -> None:
        """Go on where a device cannot measure, as a camera without a driver to draw with.

        Args:
            failed: is told the device's name and the reason, each time. Without this, `run_until`
                raises what the device raises.
        """
        self._on_failure = failed

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
                    start = time.perf_counter()
                    self._produce(timer)
                    took = time.perf_counter() - start
                    self._spent[timer] = self._spent.get(timer, 0.0) + took

    def take_spent(self) -> Dict[str, float]:
        """Return the wall seconds that each plugin's samples have taken since the last call."""
        taken: Dict[str, float] = {}
        for timer, seconds in self._spent.items():
            name = _name_of(timer)
            taken[name] = taken.get(name, 0.0) + seconds
        self._spent.clear()
        return taken

    def reset_world(self) -> None:
        """Put all models back to where they were added; time goes on."""
        for instance in self._instances.values():
            instance.place(instance.model.pose)
            for device in instance.devices:
                device.reset(self.step)

    def reset_simulation(self) -> None:
        """Put all models back and let time start again at 0."""
        self.step = 0
        self.forces.clear()
        self.reset_world()
        for timer in self._timers + self._measuring:
            timer.schedule.restart(0)

    def _produce(self, timer: Union[Device, Timer]) -> None:
        try:
            timer.produce(self.step)
        except LabError as error:
            if self._on_failure is None:
                raise
            self._on_failure(_name_of(timer), error)

    def _march(self, stop: int) -> None:
        """Advance the physics; this is the loop that decides the speed."""
        acting: List[Callable[[int], None]] = [d.before_step for d in self._acting]
        if self.forces.active:
            acting.append(self.forces.before_step)
        advance = self._physics.step
        step = self.step
        while step < stop:
            for act in acting:
                act(step)
            advance()
            step += 1
        self.step = step

    def _mount(
        self, model: Model, bodies: Mapping[str, Body], plugin: Plugin, tf_prefix: TfPrefix
    ) -> Mount:
        gravity = -self.world.gravity[2]
        if callable(tf_prefix):
            tf_prefix = tf_prefix(plugin.tags.get("robotNamespace", ""))
        return Mount(
            model,
            bodies,
            plugin,
            gravity,
            self.seed,
            tf_prefix,
            self.renderer,
            self._touched_shapes.name,
        )

    def _make_devices(
        self, model: Model, bodies: Mapping[str, Body], tf_prefix: TfPrefix
    ) -> Tuple[Device, ...]:
        devices = []
        for plugin in model.plugins:
            device = make_device(self._mount(model, bodies, plugin, tf_prefix))
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
                for tag in device.mount.unread_tags():
                    LOG.warning("%s is not known and skipped", device.mount.where(tag))
        return tuple(devices)


def _name_of(timer: Union[Device, Timer]) -> str:
    """Name in messages what takes its time."""
    if isinstance(timer, Timer):
        return "clock and states"
    return f"plugin '{timer.mount.plugin.name}' of '{timer.mount.model.name}'"


def _in_namespace(plugin: Plugin, namespace: str) -> Plugin:
    if not namespace or plugin.tags.get("robotNamespace"):
        return plugin
    return replace(plugin, tags={**plugin.tags, "robotNamespace": namespace})
