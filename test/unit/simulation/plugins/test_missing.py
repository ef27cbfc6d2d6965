"""What a robot says of plugins that are not simulated: one line, with the physics that it lacks."""

import pytest
from sensor_worlds import carrier, empty

MOVE = "libgazebo_ros_planar_move.so"
FLYER = [f"librotors_gazebo_{name}.so" for name in ("controller", *4 * ["motor_model"])]
DIVER = ["libuuv_underwater_object_ros_plugin.so", *2 * ["libuuv_thruster_ros_plugin.so"]]
ALONE = "; no other plugin moves the model"


def said(caplog, files):
    tags = (f'<plugin name="p{n}" filename="{file}"/>' for n, file in enumerate(files))
    with empty() as simulation:
        simulation.add(carrier(f"<gazebo>{''.join(tags)}</gazebo>"))
    (message,) = caplog.messages
    return message.split("skipped ")[-1]


@pytest.mark.parametrize(
    ("files", "line"),
    [
        (
            FLYER,
            "(librotors_gazebo_controller.so, 4 librotors_gazebo_motor_model.so); "
            f"missing: thrust of propellers{ALONE}",
        ),
        (
            DIVER,
            "(libuuv_underwater_object_ros_plugin.so, 2 libuuv_thruster_ros_plugin.so); "
            f"missing: buoyancy and drag of water, thrusters and fins{ALONE}",
        ),
        (
            ["libLiftDragPlugin.so", "libHarnessPlugin.so"],
            f"(libLiftDragPlugin.so, libHarnessPlugin.so); missing: lift and drag in air, "
            f"a harness{ALONE}",
        ),
        (
            ["libBuoyancyPlugin.so", "libgazebo_ros_wheel_slip.so", MOVE],
            "(libBuoyancyPlugin.so, libgazebo_ros_wheel_slip.so); "
            "missing: buoyancy and drag of water, slip of wheels",
        ),
        (["liblamp.so", "libhorn.so"], f"(liblamp.so, libhorn.so){ALONE}"),
        (["liblamp.so", "libhorn.so", MOVE], "(liblamp.so, libhorn.so)"),
        (
            ["libfetch_gazebo_plugin.so", "liblamp.so"],
            "(libfetch_gazebo_plugin.so, liblamp.so); "
            f"missing: a framework of its own for joints{ALONE}",
        ),
        (
            2 * ["libobstacle1.so"],
            "(2 libobstacle1.so); "
            f"missing: motion of an obstacle (docs/plugins/path.md has one){ALONE}",
        ),
    ],
)
def test_a_robot_says_in_one_line_what_it_lacks(caplog, files, line):
    assert said(caplog, files) == line


def test_a_single_plugin_is_named(caplog):
    message = said(caplog, ["libWindPlugin.so"])
    what = "model 'carrier': plugin 'p0' (libWindPlugin.so) is not simulated and"
    assert message.startswith(f"{what} skipped; missing: wind{ALONE}")
