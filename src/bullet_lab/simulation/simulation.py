"""A world that is stepped: models, what their plugins do, simulated time, and pictures of it.

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
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Any, Callable, DefaultDict, Dict, Iterator, List, Mapping, Optional, Tuple, Union

import numpy as np

from bullet_lab.core.pinhole import PinholeCamera
from bullet_lab.core.pose import Pose, Vector, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND, Schedule
from bullet_lab.errors import LabError
from bullet_lab.simulation.forces import Forces
from bullet_lab.simulation.models import ModelInstance, SimulationError, check_pose
from bullet_lab.simulation.physics.contacts import Contact, contacts_of, shape_name, touching_points
from bullet_lab.simulation.physics.physics import Body, Physics
from bullet_lab.simulation.physics.traction import Traction
from bullet_lab.simulation.plugins import Mount, Plugin, known_plugins, make_plugin, namespace_of
from bullet_lab.simulation.plugins.plugin import NAMESPACE
from bullet_lab.simulation.rendering.renderer import Renderer, Shot
from bullet_lab.simulation.world.description import Light, Model, PluginTag, Snapshot, World
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.tree import check_proportions, usable
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.simulation.world.xml import leaving_out

__all__ = ["ModelInstance", "Simulation", "SimulationError", "Snapshot", "Timer", "View"]

LOG = logging.getLogger(__name__)
# Steps between two looks whether all joints are numbers still.
LONGEST_MARCH = 20

TfPrefix = Union[str, Callable[[str], str]]


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
        """Load a world, an empty one by default; the noise of all sensors follows the seed."""
        self.world = world or World("default")
        self._renderer: Optional[Renderer] = None
        self.seed = seed
        self.step = 0
        self._physics = Physics(self.world.gravity)
        self._instances: Dict[str, ModelInstance] = {}
        # Names of the models, and their bodies, by the bodies' unique ids.
        self._owners: Dict[int, str] = {}
        self._bodies: Dict[int, Body] = {}
        self._tractions: List[Traction] = []
        self._acting: List[Plugin] = []
        self._measuring: List[Union[Plugin, Timer]] = []
        self._timers: List[Union[Plugin, Timer]] = []
        self._on_failure: Optional[Callable[[str, LabError], None]] = None
        self._spent: DefaultDict[Union[Plugin, Timer], float] = defaultdict(float)
        self.forces = Forces()
        self._known_is_told = False
        # When (wall s) it was last warned of a model's reset, by its name.
        self._warned_of_reset: Dict[str, float] = {}
        for model in self.world.models:
            with leaving_out(lambda said: LOG.warning("%s", said)):
                instance = self.add(model, namespace="")
                if model.name in self.world.states:
                    instance.restore(self.world.states[model.name])

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
        """Return what draws this world, loaded once it is asked for; raises RendererError."""
        if self._renderer is None:
            self._renderer = Renderer(self.world, self._instances)
        return self._renderer

    def spawn(self, urdf: str, *place: Any, **names: Any) -> ModelInstance:
        """Read a robot from the URDF file that a path or URI names and add it; see `add`."""
        return self.add(read_urdf_file(ResourceFinder.anywhere().find(urdf)), *place, **names)

    def add(
        self,
        model: Model,
        name: str = "",
        pose: Optional[Pose] = None,
        namespace: str = "/",
        tf_prefix: TfPrefix = "",
    ) -> ModelInstance:
        """Put a model into the world.

        Args:
            model: what to add.
            name: its name in the world; the model's own if empty.
            pose: of the model's frame in the world; the model's own pose if None.
            namespace: robotNamespace of every plugin that has none; empty for what a plugin
                does without: some are named by their model.
            tf_prefix: what stands before the names of its frames on TF; or what gives that for
                the namespace of a plugin.

        Raises:
            LabError: the name is taken, or nothing of the model can be simulated.
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
        model = usable(model)
        bodies = self._physics.add(model)
        plugins = self._make_plugins(model, bodies, tf_prefix)
        instance = ModelInstance(model, bodies, plugins)
        self._instances[name] = instance
        for body in bodies.values():
            self._owners[body.unique_id], self._bodies[body.unique_id] = name, body
        self._find_tractions()
        self._acting.extend(plugin for plugin in plugins if plugin.acts)
        self._measuring.extend(plugin for plugin in plugins if plugin.schedule is not None)
        return instance

    def remove(self, name: str) -> None:
        """Take a model out of the world; raises SimulationError for an unknown name."""
        instance = self._instances.pop(name, None)
        if instance is None:
            raise SimulationError(f"there is no model '{name}'")
        self._physics.remove(instance.bodies)
        self.forces.clear(target=(instance,))
        for plugin in instance.plugins:
            self._spent.pop(plugin, None)
        for body in instance.bodies.values():
            del self._owners[body.unique_id], self._bodies[body.unique_id]
        self._find_tractions()
        self._acting = [p for p in self._acting if p not in instance.plugins]
        self._measuring = [p for p in self._measuring if p not in instance.plugins]

    def contacts(self, name: str) -> Dict[str, Contact]:
        """Return what a model touched in the last step, by the other models' names.

        What stands on the floor touches the floor.

        Raises:
            SimulationError: there is no such model.
        """
        if name not in self._instances:
            raise SimulationError(f"there is no model '{name}'")
        return contacts_of(self._instances[name].bodies.values(), self._owners, name)

    def touches(self, name: str) -> Iterator[Tuple[str, str, float]]:
        """Yield what a model touched in the last step: its own link, and the other model::link.

        The third is the z of the unit normal towards the model: 1 on level ground.
        """
        for body in self._instances[name].bodies.values():
            for point in touching_points(body):
                _, _, second, index, other, _, _, normal, *_ = point
                if self._owners[second] != name:
                    link = self._bodies[second].part_at(other).link.name
                    owner = self._owners[second]
                    yield body.part_at(index).link.name, f"{owner}::{link}", normal[2]

    def set_gravity(self, gravity: Vector) -> None:
        """Change gravity, in m/s²; raises SimulationError for what is not finite."""
        if not all(map(math.isfinite, gravity)):
            raise SimulationError("gravity is not finite")
        self.world = replace(self.world, gravity=gravity)
        self._physics.set_gravity(gravity)
        for instance in self._instances.values():
            for plugin in instance.plugins:
                plugin.gravity = gravity

    def light(self, name: str) -> Light:
        """Return a light; raises SimulationError for an unknown name."""
        for light in self.world.lights:
            if light.name == name:
                return light
        raise SimulationError(f"light [{name}] not found")

    def set_light(self, light: Light) -> None:
        """Put a light into the world, in the place of one of the same name."""
        names = [one.name for one in self.world.lights]
        if light.name not in names:
            self._set_lights((*self.world.lights, light))
        else:
            lights = (light if one.name == light.name else one for one in self.world.lights)
            self._set_lights(tuple(lights))

    def remove_light(self, name: str) -> None:
        """Take a light out of the world; raises SimulationError for an unknown name."""
        gone = self.light(name)
        self._set_lights(tuple(light for light in self.world.lights if light is not gone))

    def _set_lights(self, lights: Tuple[Light, ...]) -> None:
        self.world = replace(self.world, lights=lights)
        if self._renderer is not None:
            self._renderer.relight(self.world)

    def snapshot(self) -> Snapshot:
        """Return all that makes up the present state, to be written by whoever has time."""
        models = tuple((i.model, i.state()) for i in self._instances.values())
        return Snapshot(self.world, self.step, models)

    def every(self, rate: float, call: Callable[[int], None]) -> None:
        """Call `call(step)` `rate` times per simulated second, before plugins send theirs."""
        self._timers.append(Timer(Schedule(rate, self.step), call))

    def go_on_after(self, failed: Callable[[str, LabError], None]) -> None:
        """Go on where a plugin cannot measure, as a camera without a driver to draw with.

        `failed` is told the plugin's name and the reason, each time. Without this, `run_until`
        raises what the plugin raises.
        """
        self._on_failure = failed

    def run_for(self, seconds: float) -> None:
        """Advance by a simulated duration, rounded to whole steps."""
        self.run_until(self.step + round(seconds * STEPS_PER_SECOND))

    def run_until(self, step: int) -> None:
        """Advance to a step; samples are sent as they fall due on the way."""
        timers = self._timers + self._measuring
        while self.step < step:
            dates = [timer.schedule.next_step for timer in timers]
            self._march(min([*dates, step, self.step + LONGEST_MARCH]))
            self._mend()
            for timer in timers:
                if timer.schedule.next_step <= self.step:
                    timer.schedule.advance()
                    start = time.perf_counter()
                    try:
                        timer.produce(self.step)
                    except LabError as error:
                        if self._on_failure is None:
                            raise
                        self._on_failure(_name_of(timer), error)
                    self._spent[timer] += time.perf_counter() - start

    def take_spent(self) -> Dict[str, float]:
        """Return the wall seconds that each plugin's samples have taken since the last call."""
        taken: DefaultDict[str, float] = defaultdict(float)
        for timer, seconds in self._spent.items():
            taken[_name_of(timer)] += seconds
        self._spent.clear()
        return taken

    def reset_world(self) -> None:
        """Put all models back to where they were added; time goes on."""
        for instance in self._instances.values():
            instance.place(instance.model.pose)
            for plugin in instance.plugins:
                plugin.reset(self.step)

    def reset_simulation(self) -> None:
        """Put all models back and let time start again at 0."""
        self.step = 0
        self.forces.clear()
        self.reset_world()
        for timer in self._timers + self._measuring:
            timer.schedule.restart(0)

    def _march(self, stop: int) -> None:
        """Advance the physics; this is the loop that decides the speed."""
        acting: List[Callable[[int], None]] = [plugin.before_step for plugin in self._acting]
        if self.forces.active:
            acting.append(self.forces.before_step)
        if any(body.settling for body in self._bodies.values()):
            acting.append(self._settle)
        if any(body.floats for body in self._bodies.values()):
            acting.append(self._bear)
        acting += [traction.before_step for traction in self._tractions]
        advance = self._physics.step
        places = [body.com_place for body in self._bodies.values() if body.moves]
        step = self.step
        while step < stop:
            for act in acting:
                act(step)
            advance()
            step += 1
            # A step later, what is no number any more ruins all that it touches.
            for place in places:
                x = place()[0][0]
                if x - x != 0.0:
                    stop = step
        self.step = step

    def _mend(self) -> None:
        """Put back models with a pose that is no number, which would ruin all others in time.

        It may be the floor's: Bullet hands NaN on to whatever it touches.
        """
        lost = {self._owners[i] for i, body in self._bodies.items() if not body.is_finite()}
        instances = [self._instances[name] for name in sorted(lost)]
        # What stands still is made anew after that: else Bullet no longer finds what touches it.
        for instance in sorted(instances, key=lambda one: one.model.static):
            self._warn_of_reset(instance.name)
            if instance.model.static and not instance.plugins:
                self.remove(instance.name)
                self.add(instance.model)
                continue
            instance.place(instance.model.pose)
            for plugin in instance.plugins:
                plugin.reset(self.step)

    def _warn_of_reset(self, name: str) -> None:
        """Warn that a model was reset, once a second at most."""
        now = time.monotonic()
        if now - self._warned_of_reset.get(name, -math.inf) >= 1.0:
            self._warned_of_reset[name] = now
            LOG.warning("model '%s': its pose is no longer finite; reset to its first pose", name)

    def _find_tractions(self) -> None:
        tractions = (body.traction for body in self._bodies.values())
        self._tractions = [traction for traction in tractions if traction is not None]

    def _settle(self, _: int) -> None:
        """Let no body be thrown out of what it was put into."""
        for body in self._bodies.values():
            if body.settling:
                body.settle()

    def _bear(self, _: int) -> None:
        """Hold up what gravity does not pull."""
        for body in self._bodies.values():
            if body.floats:
                body.bear(self._physics.gravity)

    def _shape_name(self, unique_id: int, index: int, place: Vector) -> str:
        return shape_name(self._owners[unique_id], self._bodies[unique_id], index, place)

    def _make_plugins(
        self, model: Model, bodies: Mapping[str, Body], tf_prefix: TfPrefix
    ) -> Tuple[Plugin, ...]:
        plugins = []
        common = (self.world.gravity, self.seed)
        draws = (self.renderer, self._shape_name)
        for tag in model.plugins:
            space = namespace_of(tag, model.name)
            prefix = tf_prefix(space) if callable(tf_prefix) else tf_prefix
            what = f"model '{model.name}': plugin '{tag.name}' ({tag.filename})"
            try:
                plugin = make_plugin(Mount(model, bodies, tag, *common, prefix, *draws))
            except LabError as error:
                LOG.warning("%s is left out: %s", what, error)
                continue
            if plugin is None:
                known = "" if self._known_is_told else f"; known are {', '.join(known_plugins())}"
                self._known_is_told = True
                LOG.warning("%s is not simulated and skipped%s", what, known)
                continue
            plugin.reset(self.step)
            if plugin.schedule is not None:
                plugin.schedule.restart(self.step)
            plugins.append(plugin)
            for unread in plugin.mount.unread_tags():
                LOG.warning("%s is not known and skipped", plugin.mount.where(unread))
        return tuple(plugins)


def _name_of(timer: Union[Plugin, Timer]) -> str:
    """Name in messages what takes its time."""
    if isinstance(timer, Timer):
        return "clock and states"
    return f"plugin '{timer.mount.plugin.name}' of '{timer.mount.model.name}'"


def _in_namespace(tag: PluginTag, namespace: str) -> PluginTag:
    # An empty tag is one, as in Gazebo.
    named = not namespace or NAMESPACE in tag.tags
    return tag if named else replace(tag, tags={**tag.tags, NAMESPACE: namespace})


class ViewError(LabError):
    """A picture that cannot be taken."""


@dataclass(frozen=True)
class View:
    """An ideal pinhole camera in the world that looks from `eye` at `target` (both in m), upright.

    Width and height are in pixels, the field of view in rad; `near` and `far` (m) limit what is
    drawn.
    """

    eye: Vector
    target: Vector
    width: int = 640
    height: int = 480
    horizontal_fov: float = math.radians(65.0)
    near: float = 0.1
    far: float = 100.0


def take_picture(simulation: Simulation, view: View, samples: int = 1) -> np.ndarray:
    """Draw the world as it is now, with 1, 2 or 4 samples of each pixel.

    Returns:
        (height, width, 3) array of uint8, RGB. The same world and view give the same bytes.

    Raises:
        ViewError: the picture has no area or depth, a number is not finite, or the target is
            straight above or below the eye.
        LabError: nothing can be drawn here.
    """
    if not all(map(math.isfinite, (*view.eye, *view.target, view.near, view.far))):
        raise ViewError("the view has a number that is not finite")
    if not 0.0 < view.near < view.far:
        raise ViewError(f"no view reaches from {view.near:g} m to {view.far:g} m")
    if view.width < 1 or view.height < 1 or not 0.0 < view.horizontal_fov < math.pi:
        raise ViewError(f"no picture has {view.width} x {view.height} pixels and such an angle")
    if math.dist(view.eye[:2], view.target[:2]) == 0.0:
        raise ViewError("the view is vertical: the picture has no upper side")
    focal = 0.5 * view.width / math.tan(0.5 * view.horizontal_fov)
    centre = (0.5 * (view.width - 1), 0.5 * (view.height - 1))
    camera = PinholeCamera(view.width, view.height, focal, focal, *centre)
    shot = Shot(camera, view.near, view.far, samples)
    # Along its x axis at the target, without roll.
    dx, dy, dz = subtract(view.target, view.eye)
    rpy = (0.0, -math.atan2(dz, math.hypot(dx, dy)), math.atan2(dy, dx))
    return simulation.renderer().picture(Pose.from_rpy(view.eye, rpy), shot)
