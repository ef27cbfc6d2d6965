"""Controllers that hand commands on to joints as they are, to one or to a group."""

from __future__ import annotations

from typing import Tuple, Union

from bullet_lab.simulation.plugins.controllers.controller import (
    EFFORT,
    POSITION,
    VELOCITY,
    Controller,
    ControllerSetup,
)
from bullet_lab.simulation.plugins.controllers.parameters import ControlError
from bullet_lab.simulation.plugins.plugin import Input
from bullet_lab.simulation.plugins.samples import JointCommand, JointCommands, is_sound


class JointTargets(Controller):
    """Takes a number for a joint, or one for each of a group, on the topic `command`.

    Parameters: joint, or joints for the kinds named JointGroup….
    """

    def __init__(self, setup: ControllerSetup):
        super().__init__(setup)
        self.grouped = "/JointGroup" in setup.kind
        if self.grouped:
            names = setup.parameters.required_names("joints")
            entry = Input(setup.topic("command"), JointCommands, self.command)
        else:
            names = (setup.joint_name(),)
            entry = Input(setup.topic("command"), JointCommand, self.command)
        self.joints = setup.joints(names, self.interface)
        self.inputs = (entry,)
        self.targets: Tuple[float, ...] = (0.0,) * len(names)

    def command(self, command: Union[JointCommand, JointCommands]) -> None:
        """Take over what the joints shall do.

        Raises:
            ControlError: not as many as there are joints, not finite, or beyond `LARGEST_COMMAND`.
        """
        values = (command.value,) if isinstance(command, JointCommand) else command.values
        if len(values) != len(self.joints):
            joints = len(self.joints)
            raise ControlError(f"{len(values)} numbers for the {joints} joints of '{self.name}'")
        if not is_sound(*values):
            raise ControlError(
                f"a command to '{self.name}' is not finite, or out of all proportion"
            )
        self.targets = tuple(values)


class ForwardCommand(JointTargets):
    """Hands commands on.

    It begins with the present position, or with no velocity or effort; as in ros_controllers, a
    joint keeps its last command when the controller stops.
    """

    kinds = {
        "position_controllers/JointPositionController": POSITION,
        "position_controllers/JointGroupPositionController": POSITION,
        "velocity_controllers/JointVelocityController": VELOCITY,
        "velocity_controllers/JointGroupVelocityController": VELOCITY,
        "effort_controllers/JointEffortController": EFFORT,
        "effort_controllers/JointGroupEffortController": EFFORT,
    }

    def starting(self, step: int) -> None:
        position = self.interface == POSITION
        self.targets = tuple(joint.position if position else 0.0 for joint in self.joints)

    def update(self, step: int, seconds: float) -> None:
        for joint, target in zip(self.joints, self.targets):
            joint.command = target
