"""libgazebo_ros_control.so: joints that controllers of ros_control command."""

from __future__ import annotations

import logging
import math
from typing import Any, Optional

from bullet_lab.core.schedule import STEPS_PER_SECOND
from bullet_lab.simulation.physics.physics import STEP_SECONDS
from bullet_lab.simulation.plugins.controllers.description import RobotDescription
from bullet_lab.simulation.plugins.controllers.hardware import RobotHardware
from bullet_lab.simulation.plugins.controllers.manager import ControllerManager
from bullet_lab.simulation.plugins.controllers.parameters import ControlParameters
from bullet_lab.simulation.plugins.plugin import Input, Mount, Plugin, PluginError
from bullet_lab.simulation.plugins.samples import Stop

LOG = logging.getLogger(__name__)

DEFAULT_HARDWARE = "gazebo_ros_control/DefaultRobotHWSim"


class RosControl(Plugin):
    """Lets controllers act on the joints of its model, in lock step with the physics.

    It does nothing until it is told the robot's description, which in ROS is a parameter, by
    `configure`. Whoever does so loads and starts controllers by its `manager`, whose controllers
    have inputs and outputs of their own.

    Attributes:
        namespace: of the robot: that of its parameters, topics and services, with slashes around.
        description: name of the parameter with the robot's URDF.
        manager: of its controllers; None until it is configured.
    """

    filenames = ("libgazebo_ros_control.so",)
    acts = True

    def __init__(self, mount: Mount):
        super().__init__(mount)
        if mount.model.static:
            raise PluginError(f"model '{mount.model.name}': controllers on what cannot move")
        # As in Gazebo, a plugin that is told no namespace has that of its model.
        space = (mount.text("robotNamespace") or mount.model.name).strip("/")
        self.namespace = f"/{space}/" if space else "/"
        self.description = mount.text("robotParam", "robot_description")
        hardware = mount.text("robotSimType", DEFAULT_HARDWARE)
        if hardware != DEFAULT_HARDWARE:
            where = mount.where("robotSimType")
            LOG.warning("%s: %s is not simulated: it is %s", where, hardware, DEFAULT_HARDWARE)
        # Of releases before Noetic, whose plugin passes it over as well.
        mount.text("legacyModeNS")
        self._period = self._steps(mount.number("controlPeriod", STEP_SECONDS))
        stop = mount.text("eStopTopic")
        self.inputs = (Input(self._topic(stop), Stop, self._press),) if stop else ()
        self.manager: Optional[ControllerManager] = None
        self._stopped = self._was_stopped = False
        self._last_step = 0

    def configure(self, urdf: str, parameters: Any) -> ControllerManager:
        """Get ready for controllers, and return their manager.

        Args:
            urdf: the robot's description.
            parameters: those in the robot's namespace, as a tree: of joint_limits/<joint> and
                gazebo_ros_control/pid_gains/<joint>.

        Raises:
            XmlError: that is no description.
        """
        where = f"model '{self.mount.model.name}': {self.description}"
        description = RobotDescription.read(urdf, where)
        told = ControlParameters(parameters, self.namespace.rstrip("/"))
        hardware = RobotHardware(list(self.mount.bodies.values()), description, told)
        self.manager = ControllerManager(hardware, self.namespace)
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
            manager.hardware.read()
            if self._was_stopped and not self._stopped:
                manager.restart()
            self._was_stopped = self._stopped
            manager.update(seconds)
        manager.hardware.write(STEP_SECONDS, self._stopped)

    def placed(self) -> None:
        if self.manager is not None:
            self.manager.placed()

    def reset(self, step: int) -> None:
        self._last_step = step
        if self.manager is not None:
            self.manager.reset(step)

    def _press(self, stop: Stop) -> None:
        self._stopped = stop.pressed

    def _topic(self, name: str) -> str:
        return name if name.startswith("/") else self.namespace + name

    def _steps(self, period: float) -> int:
        where = self.mount.where("controlPeriod")
        if period < STEP_SECONDS:
            LOG.warning("%s: %g s is less than a step of the physics, which counts", where, period)
        return max(1, math.ceil(round(period * STEPS_PER_SECOND, 6)))
