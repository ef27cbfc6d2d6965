"""What robots can do: one class for each Gazebo plugin that is simulated."""

from bullet_lab.simulation.plugins import (
    bumper,
    camera,
    depth_camera,
    diff_drive,
    imu,
    joint_states,
    laser,
    p3d,
    planar_move,
    range_sensor,
    skid_steer,
)
from bullet_lab.simulation.plugins.device import (
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
    "bumper",
    "camera",
    "depth_camera",
    "diff_drive",
    "imu",
    "joint_states",
    "known_plugins",
    "laser",
    "make_device",
    "p3d",
    "planar_move",
    "range_sensor",
    "skid_steer",
]
