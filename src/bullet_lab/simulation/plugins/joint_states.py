"""libgazebo_ros_joint_state_publisher.so: where the joints of a robot stand."""

from __future__ import annotations

from bullet_lab.simulation.plugins.plugin import Mount, Output, Plugin, PluginError
from bullet_lab.simulation.plugins.samples import JointSample


class JointStates(Plugin):
    """Reports position, velocity and effort of the joints.

    Tags: jointName (names with commas between them; all movable joints if left out),
    updateRate (100 Hz; 0: every step) and robotNamespace, as in Gazebo.
    """

    filenames = ("libgazebo_ros_joint_state_publisher.so",)

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._body = mount.body
        self._names = _joint_names(mount)
        self.states = Output(mount.topic("joint_states"), JointSample)
        self.outputs = (self.states,)
        self.schedule = mount.schedule("updateRate", 100.0)

    def produce(self, step: int) -> None:
        """Send the states of all joints."""
        if not self._names or not self.states.wanted:
            return
        states = [self._body.joint_state(name) for name in self._names]
        self.states.send(JointSample.of(step, self._names, states))


def _joint_names(mount: Mount) -> tuple:
    known = mount.body.joint_names
    listed = [name.strip() for name in mount.text("jointName").split(",")]
    names = tuple(name for name in listed if name) or known
    missing = [name for name in names if name not in known]
    if missing:
        raise PluginError(f"{mount.where('jointName')}: no movable joint '{missing[0]}'")
    return names
