"""Services on links and joints: forces, efforts, properties.

/gazebo/apply_body_wrench, clear_body_wrenches, apply_joint_effort, clear_joint_forces (also
clear_joint_efforts), get_joint_properties, get_link_properties.
"""

from __future__ import annotations

from typing import Any, Callable

import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.gazebo.services import Answer, between_steps, offer
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.ros.messages.poses import pose_message, vector_of
from bullet_lab.simulation.forces import Effort, Period, Wrench
from bullet_lab.simulation.models import find_joint, find_link, frame_state

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
            self._offer("apply_body_wrench", srv.ApplyBodyWrench, self._apply_wrench),
            self._offer("clear_body_wrenches", srv.BodyRequest, self._clear_wrenches),
            self._offer("apply_joint_effort", srv.ApplyJointEffort, self._apply_effort),
            self._offer("clear_joint_forces", srv.JointRequest, self._clear_efforts),
            # Gazebo knows it by this name, too.
            self._offer("clear_joint_efforts", srv.JointRequest, self._clear_efforts),
            self._offer(
                "get_joint_properties",
                srv.GetJointProperties,
                self._joint_properties,
                "GetJointProperties: got properties",
            ),
            self._offer(
                "get_link_properties",
                srv.GetLinkProperties,
                self._link_properties,
                "GetLinkProperties: got properties",
            ),
        ]

    def _offer(
        self, name: str, kind: Any, answer: Callable[[Any], Answer], done: str = ""
    ) -> rospy.Service:
        return offer(name, kind, between_steps(self._world, answer), done)

    def _apply_wrench(self, request: Any) -> Answer:
        force = vector_of(request.wrench.force, "the force")
        torque = vector_of(request.wrench.torque, "the torque")
        point = vector_of(request.reference_point, "the reference point")
        link = find_link(self._world.models, request.body_name)
        frame = frame_state(self._world.models, request.reference_frame)
        wrench = Wrench.at_point(frame, link, force, torque, point, self._period(request))
        self._world.simulation.forces.add(wrench)
        return {}

    def _clear_wrenches(self, request: Any) -> Answer:
        link = find_link(self._world.models, request.body_name)
        self._world.simulation.forces.clear_link(link.instance, link.link)
        return {}

    def _apply_effort(self, request: Any) -> Answer:
        instance, joint = find_joint(self._world.models, request.joint_name)
        effort = Effort(instance, joint, request.effort, self._period(request))
        self._world.simulation.forces.add(effort)
        return {}

    def _clear_efforts(self, request: Any) -> Answer:
        found = find_joint(self._world.models, request.joint_name)
        self._world.simulation.forces.clear_joint(*found)
        return {}

    def _period(self, request: Any) -> Period:
        now = self._world.simulation.step
        return Period.after(now, request.start_time.to_sec(), request.duration.to_sec())

    def _joint_properties(self, request: Any) -> Answer:
        instance, name = find_joint(self._world.models, request.joint_name)
        state = instance.body_of_joint(name).joint_state(name)
        joint = next(j for j in instance.model.joints if j.name == name)
        return {
            "type": JOINT_TYPES[joint.kind],
            "damping": [joint.damping],
            "position": [state.position],
            "rate": [state.velocity],
        }

    def _link_properties(self, request: Any) -> Answer:
        link = find_link(self._world.models, request.link_name)
        model = link.instance.model
        inertia = model.links_by_name()[link.link].inertia
        if inertia is None:
            return {"com": pose_message(Pose())}
        moments = {
            f"i{a}{b}": float(inertia.matrix[row, column])
            for row, a in enumerate("xyz")
            for column, b in enumerate("xyz")
            if row <= column
        }
        com = pose_message(Pose(inertia.centre))
        return {"com": com, "gravity_mode": not model.static, "mass": inertia.mass, **moments}
