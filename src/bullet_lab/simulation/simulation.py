"""The simulation: models and their plugins in a world, simulated time, and pictures.

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
from itertools import chain
from typing import Any, Callable, Iterator, Mapping, Union

import numpy as np

from bullet_lab.core.pose import Pose, Vector, subtract
from bullet_lab.core.schedule import STEPS_PER_SECOND, Schedule
from bullet_lab.errors import LabError
from bullet_lab.simulation.forces import Forces
from bullet_lab.simulation.models import ModelInstance, SimulationError, check_pose, find_model
from bullet_lab.simulation.physics.attached_frame import shape_name
from bullet_lab.simulation.physics.bodies import Body
from bullet_lab.simulation.physics.physics import Physics
from bullet_lab.simulation.physics.rays import RayScene
from bullet_lab.simulation.plugins import (
    NAMESPACE,
    Mount,
    Plugin,
    kind_of,
    namespace_of,
    skipped_line,
    warn_of_rivals,
)
from bullet_lab.simulation.rendering.renderer import (
    Renderer,
    RendererError,
    Shot,
    centred_camera,
)
from bullet_lab.simulation.world.description import Light, Model, PluginTag, Snapshot, World
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_world_file
from bullet_lab.simulation.world.tree import check_proportions, usable
from bullet_lab.simulation.world.urdf import read_urdf_file
from bullet_lab.simulation.world.xml import leaving_out

__all__ = ["ModelInstance", "Simulation", "SimulationError", "Snapshot", "Timer", "View"]

LOG = logging.getLogger(__name__)
# Steps between two checks that all poses are finite.
LONGEST_ADVANCE = 20

TfPrefix = Union[str, Callable[[str], str]]


@dataclass(frozen=True)
class Timer:
    """A function that is called at a rate."""

    schedule: Schedule
    produce: Callable[[int], None]

    def prepare(self) -> None:
        """Do nothing: a function prepares nothing."""


class Simulation:
    """Models in a world, advanced in steps of 1 ms.

    The same calls in the same order give the same numbers, to the last bit. Not thread-safe:
    PyBullet allows calls from one thread at a time.

    Attributes:
        world: the world, without the models that were added later.
        models: all models by name.
        seed: of the noise of all sensors.
        step: simulated time in steps.
        forces: on models.
    """

    def __init__(self, world: World | None = None, seed: int = 0):
        """Load a world, an empty one by default; the noise of all sensors follows the seed."""
        self.world = world or World("default")
        self._renderer: Renderer | None = None
        self.seed = seed
        self.step = 0
        self._physics = Physics(self.world.gravity, self.world.coulomb)
        self.models: dict[str, ModelInstance] = {}
        self._bodies = self._physics.bodies
        self._timers: list[Timer] = []
        self._on_failure: Callable[[str, Exception], None] | None = None
        self.forces = Forces()
        # Wall time (s) of the last warning that a model was reset, by its name.
        self._warned_of_reset: dict[str, float] = {}
        for model in self.world.models:
            with leaving_out(LOG.warning):
                instance = self.add(model, namespace="")
                if model.name in self.world.states:
                    instance.restore(self.world.states[model.name])

    @classmethod
    def of(cls, world: str, seed: int = 0, coulomb: bool | None = None) -> Simulation:
        """Load the world file that a path or URI names; raises LabError.

        Friction is as the world says, unless `coulomb` tells otherwise.
        """
        found = read_world_file(ResourceFinder.anywhere().find(world))
        return cls(found if coulomb is None else replace(found, coulomb=coulomb), seed)

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """Free memory and files."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        self._physics.close()

    @property
    def client(self) -> int:
        """The PyBullet client."""
        return self._physics.client

    @property
    def rays(self) -> RayScene:
        """What rays can hit, where it was after the last step."""
        return self._physics.rays

    @property
    def seconds(self) -> float:
        """Simulated time in seconds."""
        return self.step / STEPS_PER_SECOND

    def renderer(self) -> Renderer:
        """Return the renderer of this world, which the first call loads; raises RendererError."""
        if self._renderer is None:
            self._renderer = Renderer(self.world, self.models)
        return self._renderer

    def spawn(self, urdf: str, *place: Any, **names: Any) -> ModelInstance:
        """Read a robot from the URDF file that a path or URI names and add it; see `add`."""
        return self.add(read_urdf_file(ResourceFinder.anywhere().find(urdf)), *place, **names)

    def add(
        self,
        model: Model,
        name: str = "",
        pose: Pose | None = None,
        namespace: str = "/",
        tf_prefix: TfPrefix = "",
    ) -> ModelInstance:
        """Add a model to the world.

        Args:
            model: what to add.
            name: its name in the world; the model's own if empty.
            pose: of the model's frame in the world; the model's own pose if None.
            namespace: robotNamespace of every plugin that has none; if empty, each plugin's own
                default, which for some is the model's name.
            tf_prefix: prefix of the names of its frames on TF, or a function that returns it for
                the namespace of a plugin.

        Raises:
            LabError: the name is taken or invalid, or the model cannot be simulated.
        """
        name = name or model.name
        if name in self.models:
            raise SimulationError(f"a model named '{name}' exists already")
        if not name.isprintable():
            raise SimulationError(f"model name {name!r}: has characters that cannot be printed")
        if pose is not None:
            check_pose(pose, name)
        check_proportions(model)
        parts = ((kind_of(plugin) or Plugin).split(plugin) for plugin in model.plugins)
        plugins = tuple(_in_namespace(plugin, namespace) for plugin in chain.from_iterable(parts))
        model = usable(replace(model, name=name, pose=pose or model.pose, plugins=plugins))
        bodies = self._physics.add(model)
        plugins = self._make_plugins(model, bodies, tf_prefix)
        instance = ModelInstance(model, bodies, plugins)
        self.models[name] = instance
        return instance

    def remove(self, name: str) -> None:
        """Take a model out of the world; raises EntityError for an unknown name."""
        instance = find_model(self.models, name)
        del self.models[name]
        self._physics.remove(instance.bodies)
        self.forces.clear(target=(instance,))

    def contacts(self, name: str) -> set[str]:
        """Return the names of the models that a model touched in the last step.

        A robot on the floor touches the floor. Raises EntityError for an unknown name.
        """
        return {other for _, other, _, _ in self.touches(name)}

    def touches(self, name: str) -> Iterator[tuple[str, str, str, float]]:
        """Yield a model's contacts in the last step: its link, the other model and its link.

        The last value is the z of the unit normal towards the model: 1 on level ground. Raises
        EntityError for an unknown name.
        """
        for body in find_model(self.models, name).bodies.values():
            for _, _, second, index, other_index, _, _, normal, *_ in body.touching_points():
                other = self._bodies[second]
                if other.model != name:
                    ends = body.link_at(index), other.link_at(other_index)
                    yield ends[0].link.name, other.model, ends[1].link.name, normal[2]

    def shape_name(self, unique_id: int, index: int, place: Vector) -> str:
        """Return the full name of the shape at a place (m) on a link of a body."""
        return shape_name(self._bodies[unique_id], index, place)

    def set_gravity(self, gravity: Vector) -> None:
        """Change gravity, in m/s²; raises SimulationError if it is not finite."""
        if not all(map(math.isfinite, gravity)):
            raise SimulationError("gravity is not finite")
        self.world = replace(self.world, gravity=gravity)
        self._physics.set_gravity(gravity)

    def light(self, name: str) -> Light:
        """Return a light; raises SimulationError for an unknown name."""
        for light in self.world.lights:
            if light.name == name:
                return light
        raise SimulationError(f"light [{name}] not found")

    def set_light(self, light: Light) -> None:
        """Add a light to the world, or replace the one of the same name."""
        lights = [light if one.name == light.name else one for one in self.world.lights]
        if light not in lights:
            lights.append(light)
        self._set_lights(tuple(lights))

    def remove_light(self, name: str) -> None:
        """Take a light out of the world; raises SimulationError for an unknown name."""
        gone = self.light(name)
        self._set_lights(tuple(light for light in self.world.lights if light is not gone))

    def _set_lights(self, lights: tuple[Light, ...]) -> None:
        self.world = replace(self.world, lights=lights)
        if self._renderer is not None:
            self._renderer.relight(self.world)

    def snapshot(self) -> Snapshot:
        """Return the world with the present state of its models."""
        models = tuple((i.model, i.state()) for i in self.models.values())
        return Snapshot(self.world, self.step, models)

    def every(self, rate: float, call: Callable[[int], None]) -> None:
        """Call `call(step)` `rate` times per simulated second, before the plugins' samples."""
        self._timers.append(Timer(Schedule(rate, self.step), call))

    def go_on_after(self, failed: Callable[[str, Exception], None]) -> None:
        """Continue after the error of a plugin, such as a camera without a driver to draw with.

        `failed` is called with the plugin's name and the error, each time: the plugin is called
        again when it is due. Without this, `run_until` raises what the plugin raises.
        """
        self._on_failure = failed

    def _fail(self, source: Any, error: Exception) -> None:
        """Report the error of a plugin or timer; raise any other."""
        if self._on_failure is None or not isinstance(source, (Plugin, Timer)):
            raise error
        name = "clock and states"
        if isinstance(source, Plugin):
            name = f"plugin '{source.mount.plugin.name}' of '{source.mount.model.name}'"
        self._on_failure(name, error)

    def run_for(self, seconds: float) -> None:
        """Advance by a simulated duration, rounded to whole steps."""
        self.run_until(self.step + round(seconds * STEPS_PER_SECOND))

    def run_until(self, step: int) -> None:
        """Advance to a step, and send samples when they are due."""
        timers = self._all_timers()
        while self.step < step:
            due = [timer.schedule.next_step for timer in timers]
            self._advance(min([*due, step, self.step + LONGEST_ADVANCE]))
            self._reset_lost_models()
            due = [timer for timer in timers if timer.schedule.next_step <= self.step]
            for timer in due:
                try:
                    timer.prepare()
                except Exception as error:
                    self._fail(timer, error)
            for timer in due:
                timer.schedule.advance()
                try:
                    timer.produce(self.step)
                except Exception as error:
                    self._fail(timer, error)

    def reset_world(self) -> None:
        """Place all models where they were added; time continues."""
        for instance in self.models.values():
            self._reset(instance)

    def reset_simulation(self) -> None:
        """Place all models where they were added, and restart time at 0."""
        self.step = 0
        self.forces.clear()
        self.reset_world()
        for timer in self._all_timers():
            timer.schedule.restart(0)

    def _reset(self, instance: ModelInstance) -> None:
        instance.place(instance.model.pose)
        for plugin in instance.plugins:
            plugin.reset(self.step)

    def _plugins(self) -> list[Plugin]:
        return [plugin for instance in self.models.values() for plugin in instance.plugins]

    def _all_timers(self) -> list[Plugin | Timer]:
        """Return what is due at times: first the timers, then the plugins with samples."""
        return [*self._timers, *(p for p in self._plugins() if p.schedule is not None)]

    def _advance(self, stop: int) -> None:
        """Advance the physics. This loop decides the speed of the simulation."""
        bodies = self._bodies.values()
        acting: list[Callable[[int], None]]
        acting = [plugin.before_step for plugin in self._plugins() if plugin.acts]
        if self.forces.active:
            acting.append(self.forces.before_step)
        acting += [body.settle for body in bodies if body.settling]
        if any(body.weightless for body in bodies):
            acting.append(self._cancel_gravity)
        acting += [body.traction.before_step for body in bodies if body.traction is not None]
        advance = self._physics.step
        moving = [body for body in bodies if body.moves]
        step = self.step
        while step < stop:
            for act in acting:
                try:
                    act(step)
                except Exception as error:
                    self._fail(act.__self__, error)
            advance()
            step += 1
            # Stop at once at a position that is not finite: in the next step it would spread to
            # all that the body touches.
            for body in moving:
                body.last_place = place = body.com_place()
                x = place[0][0]
                if x - x != 0.0:
                    stop = step
        self.step = step
        self._physics.rays.moved()

    def _cancel_gravity(self, _step: int) -> None:
        for body in self._bodies.values():
            body.cancel_gravity(self.world.gravity)

    def _reset_lost_models(self) -> None:
        """Place models where they were added if their pose is not finite.

        The floor may be among them: Bullet passes NaN on to all that a body touches.
        """
        bodies = self._bodies.values()
        # What cannot move is lost only with something that does.
        if all(body.is_finite() for body in bodies if body.moves or body.joint_names):
            return
        lost = {body.model for body in bodies if not body.is_finite()}
        instances = [self.models[name] for name in sorted(lost)]
        # Static models come last, and are made anew: otherwise Bullet finds no contacts of them.
        for instance in sorted(instances, key=lambda one: one.model.static):
            self._warn_of_reset(instance.name)
            if instance.model.static and not instance.plugins:
                self.remove(instance.name)
                self.add(instance.model)
            else:
                self._reset(instance)

    def _warn_of_reset(self, name: str) -> None:
        """Warn that a model was reset, once a second at most."""
        now = time.monotonic()
        if now - self._warned_of_reset.get(name, -math.inf) >= 1.0:
            self._warned_of_reset[name] = now
            LOG.warning("model '%s': its pose is no longer finite; reset to its first pose", name)

    def _make_plugins(
        self, model: Model, bodies: Mapping[str, Body], tf_prefix: TfPrefix
    ) -> tuple[Plugin, ...]:
        plugins: list[Plugin] = []
        skipped: list[PluginTag] = []
        for tag in model.plugins:
            if tag.is_bare_sensor:
                continue
            what = f"model '{model.name}': plugin '{tag.name}' ({tag.filename})"
            kind, space = kind_of(tag), namespace_of(tag, model.name)
            if kind is None:
                skipped.append(tag)
                continue
            prefix = tf_prefix(space) if callable(tf_prefix) else tf_prefix
            try:
                plugin = kind(Mount(model, bodies, tag, self, space, prefix))
                plugin.reset(self.step)
            except LabError as error:
                LOG.warning("%s is left out: %s", what, error)
                continue
            except Exception as error:
                LOG.exception("%s is left out: %s: %s", what, type(error).__name__, error)
                continue
            if plugin.schedule is not None:
                plugin.schedule.restart(self.step)
            warn_of_rivals(plugin, plugins)
            plugins.append(plugin)
            for unread in plugin.mount.unread_tags():
                LOG.warning("%s is not known and skipped", plugin.mount.where(unread))
        if skipped:
            LOG.warning("%s", skipped_line(model.name, skipped, plugins))
        return tuple(plugins)


def _in_namespace(tag: PluginTag, namespace: str) -> PluginTag:
    """Return a plugin's tag with a robotNamespace; as in Gazebo, an empty one counts as one."""
    if not namespace or NAMESPACE in tag.tags:
        return tag
    return replace(tag, tags={**tag.tags, NAMESPACE: namespace})


@dataclass(frozen=True)
class View:
    """An ideal pinhole camera in the world, upright, that looks from `eye` at `target`.

    Attributes:
        eye: in m.
        target: in m.
        width: in pixels.
        height: in pixels.
        horizontal_fov: in rad.
        near: distance in m from which things are drawn.
        far: distance in m up to which things are drawn.
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
        RendererError: a value of the view is invalid, the target is straight above or below the
            eye, or nothing can be drawn on this machine.
    """
    if not all(map(math.isfinite, (*view.eye, *view.target))):
        raise RendererError("view: a number is not finite")
    if view.width < 1 or view.height < 1:
        raise RendererError(f"view: {view.width} x {view.height} pixels; needs 1 at least")
    if not 0.0 < view.horizontal_fov < math.pi:
        raise RendererError(f"view: field of view {view.horizontal_fov:g} rad; needs 0 < fov < pi")
    if math.dist(view.eye[:2], view.target[:2]) == 0.0:
        raise RendererError("view: the target is straight above or below the eye")
    camera = centred_camera(view.width, view.height, view.horizontal_fov)
    shot = Shot(camera, view.near, view.far, samples)
    # The camera looks along its x axis, without roll.
    dx, dy, dz = subtract(view.target, view.eye)
    rpy = (0.0, -math.atan2(dz, math.hypot(dx, dy)), math.atan2(dy, dx))
    return simulation.renderer().picture(Pose.from_rpy(view.eye, rpy), shot)
