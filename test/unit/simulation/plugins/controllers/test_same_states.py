"""Controllers send the same samples, and move their joints alike, as before.

A change that means to send others renews the text: see `assert_as_before`.
"""

from pathlib import Path

import yaml
from alike import assert_as_before, lines_of
from arm_robots import arm_controller, trajectory
from control_robots import listen, run, spawn
from shared import PACKAGE

from bullet_lab.simulation.plugins.samples import JointCommand, PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.urdf import read_urdf

HERE = Path(__file__).parent
FLOOR = "package://bullet_lab/worlds/empty.world"


def controller_of(world, name, robot="bot", parameters=None, velocity=None):
    """Return a controller that runs, and its command."""
    parameters = parameters or {}
    if robot == "arm":
        points = (0.2, 0.3, 0.5, 0.0), (0.6, 0.7, -0.2, 0.1)
        return arm_controller(world, name.partition("s_")[0], **parameters), trajectory(*points)
    if robot == "car":
        text = (PACKAGE / "test/drives/car.urdf").read_text()
        usual = yaml.safe_load((PACKAGE / "test/drives/car.yaml").read_text())["drive"]
        parameters = {**usual, **parameters}
        manager = world.add(read_urdf(text, "car")).plugins[0].configure(text, {})
    else:
        _, manager = spawn(world)
    command = PlanarCommand(*velocity) if velocity else JointCommand(0.8)
    return run(manager, name, **parameters), command


def test_states_are_as_before(caplog):
    told = []
    for name, case in yaml.safe_load((HERE / "controllers.yaml").read_text()).items():
        with Simulation.of(FLOOR) as world:
            controller, command = controller_of(world, name, **case)
            samples = {output.topic: listen(output) for output in controller.outputs}
            for entry in controller.inputs:
                entry.handle(command)
            world.run_for(0.45)
            joints = [(joint.name, joint.position, joint.velocity) for joint in controller.joints]
        told += lines_of(joints, name)
        for topic, found in samples.items():
            told += [f"{topic}: {len(found)}", *lines_of(found[-1:], topic)]
    told += caplog.messages
    # Errors of controllers by efforts grow from one step to the next.
    assert_as_before(told, HERE / "controllers.txt", 1e-4)
