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
from bullet_lab.simulation.attached_frame import AttachedFrame
from bullet_lab.simulation.contacts import Contact, contacts_of
from bullet_lab.simulation.description import FrameState, Model, ModelState, Plugin, World
from bullet_lab.simulation.devices import Device, Mount, known_plugins, make_device
from bullet_lab.simulation.forces import Forces
from bullet_lab.simulation.physics import Body, Physics
from bullet_lab.simulation.pose import Pose, Vector, add, cross
from bullet_lab.simulation.proportions import FARTHEST, FASTEST, check_proportions
from bullet_lab.simulation.rendering.choice import AUTO, choose_renderer
from bullet_lab.simulation.rendering.engine import shared_engine
from bullet_lab.simulation.rendering.frame import Photographer
from bullet_lab.simulation.rendering.scene import Scene
from bullet_lab.simulation.rendering.textures import check_textures
from bullet_lab.simulation.resources import ResourceFinder
from bullet_lab.simulation.schedule import STEPS_PER_SECOND, Schedule
from bullet_lab.simulation.sdf_reader import read_world_file
from bullet_lab.simulation.touched_shapes import TouchedShapes
from bullet_lab.simulation.urdf_reader import read_urdf_file

LOG = logging.getLogger(__name__)

# Of the length of a quaternion from outside, which may have been rounded.
QUATERNION_TOLERANCE = 1e-3


class SimulationError(LabError):
    """Something is asked of the simulation that it cannot do."""


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


class ModelInstance:
    """A model in a running simulation."""

    def __init__(
        self, model: Model, bodies: Mapping[str, Body], devices: Tuple[Device, ...]
    ):
        self.model = model
        self.bodies = bodies
        self.devices = devices
        self._frames: Dict[str, AttachedFrame] = {}

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

    def move(self, pose: Pose, linear: Vector, angular: Vector) -> None:
        """Put the model somewhere in motion; its joints keep their positions and stand still.

        Args:
            pose: of the model's frame in the world.
            linear: velocity in m/s of the frame's origin, in the world.
            angular: velocity in rad/s, in the world.

        Raises:
            SimulationError: a number that is not finite, or an impossible pose.
        """
        _check_pose(pose, self.name)
        if not all(abs(value) <= FASTEST for value in linear + angular):
            raise SimulationError(f"model '{self.name}': its velocity is out of all proportion")
        before = self.pose().inverse()
        for body in self.bodies.values():
            offset = before * body.pose()
            arm = pose.rotate(offset.position)
            body.move(pose * offset, add(linear, cross(angular, arm)), angular)
        for device in self.devices:
            device.placed()

    def configure(self, positions: Mapping[str, float]) -> None:
        """Put joints somewhere (rad or m), at rest.

        Raises:
            SimulationError: an unknown joint or a position that is not finite; none is moved.
        """
        bodies = {name: self.body_of_joint(name) for name in positions}
        for name, position in positions.items():
            if not math.isfinite(position):
                raise SimulationError(f"model '{self.name}': joint '{name}' at {position}")
        for name, body in bodies.items():
            body.set_joint(name, positions[name])

    def state(self) -> ModelState:
        """Return where all parts of the model are and how they move."""
        frames = {link.name: self.frame(link.name) for link in self.model.links}
        links = {name: FrameState(f.pose(), *f.velocity()) for name, f in frames.items()}
        states = {
            name: body.joint_state(name)
            for body in self.bodies.values()
            for name in body.joint_names
        }
        joints = {name: (state.position, state.velocity) for name, state in states.items()}
        return ModelState(self.pose(), links, joints)

    def restore(self, state: ModelState) -> None:
        """Put all parts of the model where a state has them.

        Raises:
            SimulationError: an impossible pose or velocity, or a joint that is not there.
        """
        for root in self.model.root_links():
            link = state.links.get(root.name, FrameState(state.pose * root.pose))
            _check_pose(link.pose, self.name)
            self.bodies[root.name].move(link.pose, link.linear, link.angular)
        for name, (position, velocity) in state.joints.items():
            self.body_of_joint(name).set_joint(name, position, velocity)
        for device in self.devices:
            device.placed()

    def body_of_joint(self, name: str) -> Body:
        """Return the body that has a joint; raises SimulationError for an unknown one."""
        for body in self.bodies.values():
            if name in body.joint_names:
                return body
        raise SimulationError(f"model '{self.name}' has no movable joint '{name}'")

    def keeper(self, link: str) -> Optional[str]:
        """Return the link that a link's frame is fixed to: itself, if it was not merged.

        Returns:
            None where the model has no such link.
        """
        if link in self.model.frames:
            return self.model.frames[link][0]
        return link if link in self.model.links_by_name() else None

    def frame(self, link: str = "") -> AttachedFrame:
        """Return the frame of a link, merged or not, or of the model itself.

        Raises:
            KeyError: there is no such link.
        """
        if link not in self._frames:
            root = self.model.root_links()[0]
            keeper, offset = root.name, root.pose.inverse()
            if link:
                keeper, offset = self.model.frames.get(link, (link, Pose()))
            body = next(
                body
                for body in self.bodies.values()
                if any(part.name == keeper for part in body.links)
            )
            self._frames[link] = AttachedFrame(body, keeper, offset)
        return self._frames[link]

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

    def __init__(
        self, world: Optional[World] = None, seed: int = 0, renderer: str = AUTO
    ):
        """Load a world; an empty one with gravity if none is given.

        Args:
            world: what to load.
            seed: of the noise of all sensors.
            renderer: what draws the cameras' pictures: "egl", "tiny", or "auto" for EGL where it
                works. Nothing is loaded for it before the first picture.
        """
        self.world = world or World("default")
        self._renderer = renderer
        self._photographers: Dict[str, Photographer] = {}
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
    def of(cls, world: str, seed: int = 0, renderer: str = AUTO) -> Simulation:
        """Load the world file that a path or URI names; raises LabError."""
        return cls(read_world_file(ResourceFinder.anywhere().find(world)), seed, renderer)

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """Give memory and files back."""
        for photographer in self._photographers.values():
            photographer.close()
        self._photographers.clear()
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

    def photographer(self, renderer: str = "") -> Photographer:
        """Return who takes pictures of this world.

        All are to be taken by the thread that takes the first one.

        Args:
            renderer: "egl", "tiny" or "auto"; that of the simulation if empty.

        Raises:
            RendererError: the renderer that is asked for does not work.
        """
        renderer = choose_renderer(renderer or self._renderer)
        if renderer not in self._photographers:
            scene = Scene(self.world, self._instances, shared_engine(renderer))
            self._photographers[renderer] = Photographer(scene, self.world.background[:3])
        return self._photographers[renderer]

    def spawn(
        self,
        urdf: str,
        name: str = "",
        pose: Optional[Pose] = None,
        namespace: str = "",
        tf_prefix: str = "",
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
        tf_prefix: str = "",
    ) -> ModelInstance:
        """Put a model into the world.

        Args:
            model: what to add.
            name: its name in the world; the model's own if empty.
            pose: of the model's frame in the world; the model's own pose if None.
            namespace: robotNamespace of every plugin that has none.
            tf_prefix: what stands before the names of its frames on TF.

        Raises:
            LabError: the name is taken, or the model or one of its plugins makes no sense.
        """
        name = name or model.name
        if name in self._instances:
            raise SimulationError(f"a model named '{name}' exists already")
        if not name.isprintable():
            raise SimulationError(f"a model cannot be called {name!r}")
        if pose is not None:
            _check_pose(pose, name)
        check_proportions(model)
        plugins = tuple(_in_namespace(plugin, namespace) for plugin in model.plugins)
        model = replace(model, name=name, pose=pose or model.pose, plugins=plugins)
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
        self.forces.clear()
        self.reset_world()
        for timer in self._timers + self._measuring:
            timer.schedule.restart(0)

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
        self, model: Model, bodies: Mapping[str, Body], plugin: Plugin, tf_prefix: str
    ) -> Mount:
        gravity = -self.world.gravity[2]
        return Mount(
            model,
            bodies,
            plugin,
            gravity,
            self.seed,
            tf_prefix,
            self.photographer,
            self._touched_shapes.name,
        )

    def _make_devices(
        self, model: Model, bodies: Mapping[str, Body], tf_prefix: str
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


def _check_pose(pose: Pose, model: str) -> None:
    if not all(map(math.isfinite, pose.position + pose.quaternion)):
        raise SimulationError(f"model '{model}': its pose is not finite")
    if max(map(abs, pose.position)) > FARTHEST:
        raise SimulationError(f"model '{model}': its pose is out of all proportion")
    length = math.sqrt(sum(value * value for value in pose.quaternion))
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise SimulationError(f"model '{model}': a quaternion of length {length:g}, not 1")


def _in_namespace(plugin: Plugin, namespace: str) -> Plugin:
    if not namespace or plugin.tags.get("robotNamespace"):
        return plugin
    return replace(plugin, tags={**plugin.tags, "robotNamespace": namespace})
