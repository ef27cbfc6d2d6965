"""A model in a running simulation: where its parts are, and putting them elsewhere."""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, Mapping, Optional, Tuple

from bullet_lab.core.pose import Pose, Vector, add, cross
from bullet_lab.errors import LabError
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.physics.physics import Body
from bullet_lab.simulation.plugins import Device
from bullet_lab.simulation.world.description import FrameState, Model, ModelState
from bullet_lab.simulation.world.proportions import FARTHEST, FASTEST

# Of the length of a quaternion from outside, which may have been rounded.
QUATERNION_TOLERANCE = 1e-3


class SimulationError(LabError):
    """Something is asked of the simulation that it cannot do."""


class ModelInstance:
    """A model in a running simulation.

    Attributes:
        moves: how often it was put somewhere: what is static moves in no other way.
    """

    def __init__(self, model: Model, bodies: Mapping[str, Body], devices: Tuple[Device, ...]):
        self.model = model
        self.bodies = bodies
        self.devices = devices
        self.moves = 0
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
        check_pose(pose, self.name)
        for root in self.model.root_links():
            self.bodies[root.name].place(pose * root.pose)
        self._note_move()

    def move(self, pose: Pose, linear: Vector, angular: Vector) -> None:
        """Put the model somewhere in motion; its joints keep their positions and stand still.

        Args:
            pose: of the model's frame in the world.
            linear: velocity in m/s of the frame's origin, in the world.
            angular: velocity in rad/s, in the world.

        Raises:
            SimulationError: a number that is not finite, or an impossible pose.
        """
        check_pose(pose, self.name)
        if not all(abs(value) <= FASTEST for value in linear + angular):
            raise SimulationError(f"model '{self.name}': its velocity is out of all proportion")
        before = self.pose().inverse()
        for body in self.bodies.values():
            offset = before * body.pose()
            arm = pose.rotate(offset.position)
            body.move(pose * offset, add(linear, cross(angular, arm)), angular)
        self._note_move()

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
        self.moves += 1

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
            check_pose(link.pose, self.name)
            self.bodies[root.name].move(link.pose, link.linear, link.angular)
        for name, (position, velocity) in state.joints.items():
            self.body_of_joint(name).set_joint(name, position, velocity)
        self._note_move()

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

    def _note_move(self) -> None:
        self.moves += 1
        for device in self.devices:
            device.placed()


def check_pose(pose: Pose, model: str) -> None:
    """Refuse a pose that is not finite, absurdly far away or no rotation."""
    if not all(map(math.isfinite, pose.position + pose.quaternion)):
        raise SimulationError(f"model '{model}': its pose is not finite")
    if max(map(abs, pose.position)) > FARTHEST:
        raise SimulationError(f"model '{model}': its pose is out of all proportion")
    length = math.sqrt(sum(value * value for value in pose.quaternion))
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise SimulationError(f"model '{model}': a quaternion of length {length:g}, not 1")
