"""Services on links and joints: forces, efforts, properties.

/gazebo/apply_body_wrench, clear_body_wrenches, apply_joint_effort, clear_joint_forces (also
clear_joint_efforts), get_joint_properties, get_link_properties.
"""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Pose as PoseMessage

from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.gazebo.services import Answer, offer
from bullet_lab.ros.messages.gazebo import vector_of
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.simulation.entities import find_joint, find_link, frame_state
from bullet_lab.simulation.forces import Effort, Period, Wrench

JOINT_TYPES = {
    "revolute": srv.GetJointPropertiesResponse.REVOLUTE,
    "continuous": srv.GetJointPropertiesResponse.CONTINUOUS,
    "prismatic": srv.GetJointPropertiesResponse.PRISMATIC,
}


class GazeboForces:
    """Offers the services."""

    def __init__(self, world: RunningWorld):
        self._world = world
        self.services = [
            offer("apply_body_wrench", srv.ApplyBodyWrench, self._apply_wrench),
            offer("clear_body_wrenches", srv.BodyRequest, self._clear_wrenches),
            offer("apply_joint_effort", srv.ApplyJointEffort, self._apply_effort),
            offer("clear_joint_forces", srv.JointRequest, self._clear_efforts),
            # Gazebo knows it by this name, too.
            offer("clear_joint_efforts", srv.JointRequest, self._clear_efforts),
            offer(
                "get_joint_properties",
                srv.GetJointProperties,
                self._joint_properties,
                "GetJointProperties: got properties",
            ),
            offer(
                "get_link_properties",
                srv.GetLinkProperties,
                self._link_properties,
                "GetLinkProperties: got properties",
            ),
        ]

    def _apply_wrench(self, request: Any) -> Answer:
        force = vector_of(request.wrench.force, "the force")
        torque = vector_of(request.wrench.torque, "the torque")
        point = vector_of(request.reference_point, "the reference point")

        def apply() -> None:
            models = self._world.models
            link = find_link(models, request.body_name)
            frame = frame_state(models, request.reference_frame)
            period = self._period(request)
            self._world.simulation.forces.add(
                Wrench.at_point(frame, link.instance, link.frame, force, torque, point, period)
            )

        self._world.do(apply)
        return {}

    def _clear_wrenches(self, request: Any) -> Answer:
        def clear() -> None:
            link = find_link(self._world.models, request.body_name)
            self._world.simulation.forces.clear_link(link.instance, link.link)

        self._world.do(clear)
        return {}

    def _apply_effort(self, request: Any) -> Answer:
        def apply() -> None:
            instance, joint = find_joint(self._world.models, request.joint_name)
            effort = Effort(instance, joint, request.effort, self._period(request))
            self._world.simulation.forces.add(effort)

        self._world.do(apply)
        return {}

    def _clear_efforts(self, request: Any) -> Answer:
        def clear() -> None:
            found = find_joint(self._world.models, request.joint_name)
            self._world.simulation.forces.clear_joint(*found)

        self._world.do(clear)
        return {}

    def _period(self, request: Any) -> Period:
        now = self._world.simulation.step
        return Period.after(now, request.start_time.to_sec(), request.duration.to_sec())

    def _joint_properties(self, request: Any) -> Answer:
        def look() -> Answer:
            instance, name = find_joint(self._world.models, request.joint_name)
            state = instance.body_of_joint(name).joint_state(name)
            joint = next(j for j in instance.model.joints if j.name == name)
            return {
                "type": JOINT_TYPES[joint.kind],
                "damping": [joint.damping],
                "position": [state.position],
                "rate": [state.velocity],
            }

        return self._world.do(look)

    def _link_properties(self, request: Any) -> Answer:
        link = self._world.do(lambda: find_link(self._world.models, request.link_name))
        inertia = link.instance.model.links_by_name()[link.link].inertia
        com = PoseMessage()
        com.orientation.w = 1.0
        if inertia is None:
            return {"com": com}
        com.position.x, com.position.y, com.position.z = inertia.centre
        moments = {
            f"i{a}{b}": float(inertia.matrix[row, column])
            for row, a in enumerate("xyz")
            for column, b in enumerate("xyz")
            if row <= column
        }
        gravity = not link.instance.model.static
        return {"com": com, "gravity_mode": gravity, "mass": inertia.mass, **moments}
