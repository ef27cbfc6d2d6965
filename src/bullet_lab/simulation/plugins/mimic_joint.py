"""libroboticsgroup_gazebo_mimic_joint_plugin.so: a joint that follows another one."""

from __future__ import annotations

from typing import Optional

from bullet_lab.simulation.physics.bodies import Body
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.plugins import Mount, Plugin, PluginError
from bullet_lab.simulation.plugins.controllers import ControlParameters
from bullet_lab.simulation.plugins.controllers.joints import AT_ONCE, STRONGEST, Pid


class MimicJoint(Plugin):
    """Keeps a joint at multiplier · position + offset of another one.

    A motor moves it, or with hasPID an effort by the gains that `configure` gets.

    Attributes:
        gains: name of the parameters with the gains; empty without hasPID.
    """

    filenames = (
        "libroboticsgroup_gazebo_mimic_joint_plugin.so",
        "libroboticsgroup_upatras_gazebo_mimic_joint_plugin.so",
    )
    acts = True

    def __init__(self, mount: Mount):
        super().__init__(mount)
        self._leader, self._follower = self._joint("joint"), self._joint("mimicJoint")
        self._multiplier = mount.number("multiplier", 1.0)
        self._offset = mount.number("offset")
        self._most = mount.number("maxEffort", 1.0)
        self._least = mount.number("sensitiveness")
        # As in Gazebo's older plugin, the tag alone says yes.
        has_pid = mount.boolean("hasPID", "hasPID" in mount.plugin.tags)
        self._pid: Optional[Pid] = None
        space = f"{mount.namespace}/gazebo_ros_control/pid_gains/{self._follower[1]}"
        self.gains = f"/{space.lstrip('/')}" if has_pid else ""

    def configure(self, parameters: object) -> None:
        """Take the gains; raises ControlError, and the motor goes on, without them."""
        self._pid = Pid(ControlParameters(parameters, self.gains))
        body, name = self._follower
        body.drive_joint(name, 0.0, 0.0)

    def before_step(self, step: int) -> None:
        body, name = self._leader
        lead = body.joint_state(name)
        target = lead.position * self._multiplier + self._offset
        body, name = self._follower
        error = target - body.joint_state(name).position
        if abs(error) < self._least:
            return
        if self._pid is None:
            # Where the leader will be after the step: a lag would feed the leader's oscillations.
            target += lead.velocity * self._multiplier * STEP_SECONDS
            body.hold_joint(name, target, STRONGEST, AT_ONCE)
        else:
            effort = self._pid.command(error, STEP_SECONDS)
            body.exert(name, min(max(effort, -self._most), self._most))

    def _joint(self, tag: str) -> tuple[Body, str]:
        """Return the joint that a tag names; raises PluginError."""
        name = self.mount.scoped(self.mount.required(tag))
        for body in self.mount.bodies.values():
            if name in body.joint_names:
                return body, name
        raise PluginError(f"{self.mount.where(tag)}: no movable joint '{name}'")
