"""libgazebo_ros_p3d.so: where a link really is, and how it moves."""

from __future__ import annotations

from typing import Optional, Tuple

from bullet_lab.core.pose import Pose, Vector, add, cross, subtract
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.plugins.plugin import Mount, Output, Plugin, PluginError
from bullet_lab.simulation.plugins.samples import MotionSample

WORLD_FRAMES = ("world", "/world", "map", "/map")


class TruePose(Plugin):
    """Reports the pose and velocity of a link as odometry.

    As in Gazebo, the velocity is given along the axes of frameName, not of the link; xyzOffset
    and rpyOffset move the reported pose within frameName (and not the point whose velocity is
    reported); and gaussianNoise, the deviation in m/s and rad/s, is on the velocity alone while
    its square stands in both covariances.

    Tags as in Gazebo: bodyName and topicName (both needed), frameName (world; or a link of the
    model), xyzOffset, rpyOffset, gaussianNoise, updateRate (Hz, 0: every step) and
    robotNamespace.
    """

    filenames = ("libgazebo_ros_p3d.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        body, topic = mount.text("bodyName"), mount.text("topicName")
        for tag, text in (("bodyName", body), ("topicName", topic)):
            if not text:
                raise PluginError(f"{mount.where(tag)}: is missing")
        self._child = mount.frame(body)
        self._place = mount.attached(body)
        frame = mount.text("frameName", WORLD_FRAMES[0])
        self._frame = mount.frame(frame)
        self._reference: Optional[AttachedFrame] = None
        if frame not in WORLD_FRAMES:
            self._reference = mount.attached(frame)
        self._shift = mount.vector("xyzOffset")
        self._turn = Pose.from_rpy((0.0, 0.0, 0.0), mount.vector("rpyOffset"))
        self._deviation = mount.coefficient("gaussianNoise", 0.0)
        self._noise = mount.noise()
        self.odometry = Output(mount.topic(topic), MotionSample)
        self.outputs = (self.odometry,)
        self.schedule = mount.schedule("updateRate", 0.0)

    def produce(self, step: int) -> None:
        """Send pose and velocity."""
        if not self.odometry.wanted:
            return
        pose, linear, angular = self._motion()
        moved = Pose(add(pose.position, self._shift), (self._turn * pose).quaternion)
        if self._deviation:
            errors = self._noise.at(step).normal(0.0, self._deviation, 6).tolist()
            linear = add(linear, errors[:3])
            angular = add(angular, errors[3:])
        variance = self._deviation * self._deviation
        self.odometry.send(
            MotionSample(step, self._frame, self._child, moved, linear, angular, variance)
        )

    def _motion(self) -> Tuple[Pose, Vector, Vector]:
        """Return pose, linear and angular velocity in the frame of reference."""
        pose, (linear, angular) = self._place.pose(), self._place.velocity()
        if self._reference is None:
            return pose, linear, angular
        frame, (base, spin) = self._reference.pose(), self._reference.velocity()
        # What the frame's own motion contributes at the place of the link: base + spin x arm.
        carried = add(base, cross(spin, subtract(pose.position, frame.position)))
        into = Pose(quaternion=frame.inverse().quaternion)
        return (
            frame.inverse() * pose,
            into.rotate(subtract(linear, carried)),
            into.rotate(subtract(angular, spin)),
        )
