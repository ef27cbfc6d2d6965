"""What is really so: where a link is and how it moves (p3d), and where the joints stand."""

from __future__ import annotations

from typing import Tuple

from bullet_lab.core.pose import Pose, Vector, add, cross, subtract
from bullet_lab.simulation.plugins.plugin import Mount, Output, Plugin, PluginError
from bullet_lab.simulation.plugins.samples import JointSample, MotionSample

WORLD_FRAMES = ("world", "/world", "map", "/map")


class TruePose(Plugin):
    """libgazebo_ros_p3d.so: reports the pose and velocity of a link as odometry.

    As in Gazebo, the velocity is given along the axes of frameName, not of the link; xyzOffset
    and rpyOffset move the reported pose within frameName (and not the point whose velocity is
    reported); and gaussianNoise, the deviation in m/s and rad/s, is on the velocity alone while
    its square stands in both covariances.
    """

    filenames = ("libgazebo_ros_p3d.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        body, topic = mount.required("bodyName"), mount.required("topicName")
        self._child = mount.frame(body)
        self._place = mount.attached(body)
        frame = mount.text("frameName", WORLD_FRAMES[0])
        self._frame = mount.frame(frame)
        self._reference = None if frame in WORLD_FRAMES else mount.attached(frame)
        self._offset = mount.offset()
        self._deviation = mount.coefficient("gaussianNoise", 0.0)
        self._noise = mount.noise()
        self.odometry = Output(mount.topic(topic), MotionSample)
        self.outputs = (self.odometry,)
        self.schedule = mount.schedule("updateRate", 0.0)

    def produce(self, step: int) -> None:
        if not self.odometry.wanted:
            return
        pose, linear, angular = self._motion()
        shifted = add(pose.position, self._offset.position)
        moved = Pose(shifted, (self._offset * pose).quaternion)
        if self._deviation:
            errors = self._noise.at(step).normal(0.0, self._deviation, 6).tolist()
            linear, angular = add(linear, errors[:3]), add(angular, errors[3:])
        frames, variance = (self._frame, self._child), self._deviation * self._deviation
        self.odometry.send(MotionSample(step, *frames, moved, linear, angular, variance))

    def _motion(self) -> Tuple[Pose, Vector, Vector]:
        """Return pose, linear and angular velocity in the frame of reference."""
        pose, (linear, angular) = self._place.pose(), self._place.velocity()
        if self._reference is None:
            return pose, linear, angular
        frame, (base, spin) = self._reference.pose(), self._reference.velocity()
        # What the frame's own motion contributes at the place of the link: base + spin x arm.
        carried = add(base, cross(spin, subtract(pose.position, frame.position)))
        into = Pose(quaternion=frame.inverse().quaternion)
        moves = (into.rotate(subtract(linear, carried)), into.rotate(subtract(angular, spin)))
        return (frame.inverse() * pose, *moves)


class JointStates(Plugin):
    """libgazebo_ros_joint_state_publisher.so: reports where the joints stand and how they move."""

    filenames = ("libgazebo_ros_joint_state_publisher.so",)
    named_by_model = (True, True)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._body = mount.body
        known = self._body.joint_names
        listed = [name.strip() for name in mount.text("jointName").split(",")]
        self._names = tuple(name for name in listed if name) or known
        missing = [name for name in self._names if name not in known]
        if missing:
            raise PluginError(f"{mount.where('jointName')}: no movable joint '{missing[0]}'")
        self.states = Output(mount.topic("joint_states"), JointSample)
        self.outputs = (self.states,)
        self.schedule = mount.schedule("updateRate", 100.0)

    def produce(self, step: int) -> None:
        if not self._names or not self.states.wanted:
            return
        states = [self._body.joint_state(name) for name in self._names]
        positions, velocities = zip(*((state.position, state.velocity) for state in states))
        # Without efforts, as Gazebo sends it.
        self.states.send(JointSample(step, self._names, positions, velocities))
