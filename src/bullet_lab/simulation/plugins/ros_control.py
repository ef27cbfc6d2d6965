"""libgazebo_ros_control.so: joints that controllers of ros_control command."""

from __future__ import annotations

import logging
import math
from typing import Any

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.plugins import Input, Mount, Plugin
from bullet_lab.simulation.plugins.controllers.controller import ControllerManager
from bullet_lab.simulation.plugins.controllers.description import (
    ControlParameters,
    RobotDescription,
)
from bullet_lab.simulation.plugins.controllers.hardware import joint_handles
from bullet_lab.simulation.plugins.samples import Stop

LOG = logging.getLogger(__name__)

DEFAULT_HARDWARE = "gazebo_ros_control/DefaultRobotHWSim"


class RosControl(Plugin):
    """Runs controllers on the joints of its model, in lock step with the physics.

    It does nothing until `configure` gives it the robot's description, which in ROS is a
    parameter. The caller then loads and starts controllers by its `manager`; controllers have
    inputs and outputs of their own.

    Attributes:
        namespace: of the robot's parameters, topics and services, with slashes around it.
        description: name of the parameter with the robot's URDF.
        manager: of its controllers; None until it is configured.
    """

    filenames = ("libgazebo_ros_control.so",)
    acts = True

    def __init__(self, mount: Mount):
        super().__init__(mount)
        mount.require_moving()
        # As in Gazebo, the default namespace is the model's name.
        space = (mount.text("robotNamespace") or mount.model.name).strip("/")
        self.namespace = f"/{space}/" if space else "/"
        self.description = mount.text("robotParam", "robot_description")
        hardware = mount.text("robotSimType", DEFAULT_HARDWARE)
        if hardware != DEFAULT_HARDWARE:
            where = mount.where("robotSimType")
            LOG.warning("%s: %s is not simulated; %s is used", where, hardware, DEFAULT_HARDWARE)
        # Of releases before Noetic; Noetic's plugin ignores it as well.
        mount.text("legacyModeNS")
        period = mount.number("controlPeriod", STEP_SECONDS)
        if period < STEP_SECONDS:
            where = mount.where("controlPeriod")
            LOG.warning("%s: %g s is less than a time step; a time step is used", where, period)
        self._period = max(1, math.ceil(round(period * STEPS_PER_SECOND, 6)))
        stop = mount.text("eStopTopic")
        if stop:
            topic = stop if stop.startswith("/") else self.namespace + stop
            self.inputs = (Input(topic, Stop, self._press),)
        self.manager: ControllerManager | None = None
        self._stopped = self._was_stopped = False
        self._last_step = 0

    def configure(self, urdf: str, parameters: Any) -> ControllerManager:
        """Read the robot's joints, and return the manager of its controllers.

        Args:
            urdf: the robot's description.
            parameters: the tree of parameters in the robot's namespace, with joint_limits/<joint>
                and gazebo_ros_control/pid_gains/<joint>.

        Raises:
            XmlError: the description is invalid.
        """
        where = f"model '{self.mount.model.name}': {self.description}"
        description = RobotDescription.read(urdf, where)
        given = ControlParameters(parameters, self.namespace.rstrip("/"))
        joints = joint_handles(self.mount.bodies, description, given)
        self.manager = ControllerManager(joints, self.namespace)
        self.manager.step = self._last_step
        return self.manager

    def before_step(self, step: int) -> None:
        manager = self.manager
        if manager is None:
            self._last_step = step
            return
        if step - self._last_step >= self._period:
            seconds = (step - self._last_step) / STEPS_PER_SECOND
            self._last_step = manager.step = step
            manager.read()
            if self._was_stopped and not self._stopped:
                manager.restart()
            self._was_stopped = self._stopped
            manager.update(seconds)
        manager.write(STEP_SECONDS, self._stopped)

    def placed(self) -> None:
        if self.manager is not None:
            self.manager.placed()

    def reset(self, step: int) -> None:
        self._last_step = step
        if self.manager is not None:
            self.manager.reset(step)

    def _press(self, stop: Stop) -> None:
        self._stopped = stop.pressed
