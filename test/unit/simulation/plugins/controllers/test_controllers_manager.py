import pytest
from control_robots import control_of, run, spawn
from shared import cases

from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.samples import JointCommands

STATES = {"type": "joint_state_controller/JointStateController"}
JOINT = {"joint": "turntable_joint"}
WHEELS = ["left_wheel_joint", "right_wheel_joint"]


@cases("wrong: [[1.0, 2.0, 3.0], [1.0, .nan]]")
def test_a_group_refuses_what_makes_no_sense(manager, wrong):
    kind = "velocity_controllers/JointGroupVelocityController"
    controller = run(manager, "wheels", type=kind, joints=WHEELS)
    with pytest.raises(ControlError, match="3 numbers for the 2 joints|not finite"):
        controller.command(JointCommands(wrong))


def test_a_controller_is_loaded_started_stopped_and_unloaded(manager):
    controller = manager.load("s", ControlParameters({"publish_rate": 50, **STATES}, "/bot/s"))
    assert controller.state == "initialized"
    with pytest.raises(ControlError, match="loaded already"):
        manager.load("s", ControlParameters(STATES, "/bot/s"))
    manager.switch(["s"], [])
    assert controller.state == "running"
    with pytest.raises(ControlError, match="running already"):
        manager.switch(["s"], [])
    with pytest.raises(ControlError, match="has to be stopped first"):
        manager.unload("s")
    manager.switch([], ["s"])
    assert controller.state == "stopped"
    manager.unload("s")
    assert not manager.controllers
    with pytest.raises(ControlError, match="no controller 's'"):
        manager.unload("s")


def test_two_controllers_of_one_joint_do_not_run_at_once(manager):
    kind = "effort_controllers/JointEffortController"
    run(manager, "one", type=kind, **JOINT)
    manager.load("two", ControlParameters({"type": kind, **JOINT}, "/bot/two"))
    with pytest.raises(ControlError, match="would both command the joint 'turntable_joint'"):
        manager.switch(["two"], [], strict=False)
    assert not manager.controllers["two"].running
    manager.switch(["two"], ["one"])
    assert manager.controllers["two"].running


def test_best_effort_passes_over_what_cannot_be(manager):
    with pytest.raises(ControlError, match="no controller 'tail'"):
        manager.switch([], ["tail"])
    run(manager, "s", publish_rate=50, **STATES)
    manager.switch(["s", "tail"], ["nose"], strict=False)
    assert manager.controllers["s"].running


def test_the_control_period_is_a_tag(world):
    robot, manager = spawn(world, tags="<controlPeriod>0.005</controlPeriod>")
    # A plugin without a namespace has its model's.
    assert control_of(robot).namespace == "/bot/"
    periods = []
    controller = run(manager, "s", publish_rate=50, **STATES)
    controller.update = lambda step, seconds: periods.append(seconds)
    world.run_for(0.1)
    assert set(periods) == {0.005}
