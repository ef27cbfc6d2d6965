"""What robots can do: one class for each Gazebo plugin that is simulated."""

from bullet_lab.simulation.devices import joint_states, planar_move
from bullet_lab.simulation.devices.device import (
    Device,
    DeviceError,
    Input,
    Mount,
    Output,
    known_plugins,
    make_device,
)

__all__ = [
    "Device",
    "DeviceError",
    "Input",
    "Mount",
    "Output",
    "joint_states",
    "known_plugins",
    "make_device",
    "planar_move",
]
