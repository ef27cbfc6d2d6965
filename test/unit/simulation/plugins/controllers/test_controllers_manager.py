import pytest
import yaml
from control_robots import control_of, listen, run, spawn

from bullet_lab.simulation.plugins.controllers import ControlError, ControlParameters
from bullet_lab.simulation.plugins.samples import JointCommand, JointCommands

STATES = {"type": "joint_state_controller/JointStateController"}
JOINT = {"joint": "turntable_joint"}
WHEELS = ["left_wheel_joint", "right_wheel_joint"]


def test_joint_states_come_at_their_rate_for_all_that_have_a_transmission(world, manager):
    controller = run(manager, "states", publish_rate=50, **STATES)
    samples = listen(controller.states)
    world.run_for(1.0)
    assert controller.states.topic == "/bot/joint_states"
    assert len(samples) == pytest.approx(50, abs=1)
    assert samples[0].names == (*WHEELS, "turntable_joint")
    assert samples[0].step == 1


def test_joint_states_of_some_joints_and_of_some_that_nobody_reads(world, manager):
    told = {
        "joints": ["turntable_joint"],
        "extra_joints": [{"name": "lid", "position": 0.3, "effort": 2}, {"position": 1.0}],
    }
    controller = run(manager, "s", publish_rate=50, **told, **STATES)
    samples = listen(controller.states)
    world.run_for(0.1)
    assert samples[-1].names == ("turntable_joint", "lid")
    assert (samples[-1].positions[1], samples[-1].efforts[1]) == (0.3, 2.0)


def test_joint_states_of_a_robot_whose_joints_have_no_known_transmission_are_empty(world):
    _, manager = spawn(world, interface="own/Interface", turntable="own/Interface")
    controller = run(manager, "states", publish_rate=50, **STATES)
    samples = listen(controller.states)
    world.run_for(0.1)
    assert (samples[-1].names, samples[-1].positions) == ((), ())


def test_a_position_is_reached_by_an_effort_and_told(world, manager):
    gains = {"p": 2.0, "i": 0.5, "d": 0.05, "i_clamp": 1.0}
    kind = "effort_controllers/JointPositionController"
    controller = run(manager, "turn", type=kind, pid=gains, **JOINT)
    samples = listen(controller.states)
    world.run_for(0.1)
    assert controller.states.topic == "/bot/turn/state"
    # Each tenth update.
    assert len(samples) == 10
    controller.command(JointCommand(5.0))
    world.run_for(1.5)
    # Its limits are known to it.
    assert samples[-1].target == 2.0
    assert samples[-1].value == pytest.approx(2.0, abs=0.05)
    assert samples[-1].error == pytest.approx(samples[-1].target - samples[-1].value)
    assert samples[-1].gains == (2.0, 0.5, 0.05, 1.0)


EFFORT_GAINS = {"p": 0.05, "i": 0.5, "i_clamp": 1.0}


SINGLE = """
- [effort_controllers/JointVelocity, {kind: continuous}, {p: 0.05, i: 0.5, i_clamp: 1.0}, velocity]
- [velocity_controllers/JointPosition, {turntable: VelocityJointInterface}, {p: 10.0}, position]
"""


@pytest.mark.parametrize("kind, robot, gains, what", yaml.safe_load(SINGLE))
def test_a_speed_by_an_effort_and_a_position_by_a_speed(world, kind, robot, gains, what):
    _, manager = spawn(world, **robot)
    controller = run(manager, "turn", type=f"{kind}Controller", pid=gains, **JOINT)
    controller.command(JointCommand(-1.0))
    world.run_for(1.0)
    assert getattr(controller.joints[0], what) == pytest.approx(-1.0, abs=0.01)


GROUPS = """
- [velocity_controllers/JointGroupVelocity, VelocityJointInterface, {}, velocity, 0.001]
- [effort_controllers/JointGroupPosition, EffortJointInterface, {left_wheel_joint: {pid: {p: 0.05,
   d: 0.005}}, right_wheel_joint: {pid: {p: 0.05, d: 0.005}}}, position, 0.02]
"""


@pytest.mark.parametrize("kind, interface, gains, what, within", yaml.safe_load(GROUPS))
def test_a_group_is_told_at_once(world, kind, interface, gains, what, within):
    _, manager = spawn(world, height=0.5, interface=interface)
    world.set_gravity((0.0, 0.0, 0.0))
    controller = run(manager, "wheels", type=f"{kind}Controller", joints=WHEELS, **gains)
    controller.command(JointCommands((0.5, -0.5)))
    assert controller.outputs == ()
    world.run_for(2.0)
    found = [getattr(joint, what) for joint in controller.joints]
    assert found == pytest.approx([0.5, -0.5], abs=within)
    for wrong, complaint in (
        ((1.0, 2.0, 3.0), "3 numbers for the 2 joints"),
        ((1.0, float("nan")), "not finite"),
    ):
        with pytest.raises(ControlError, match=complaint):
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
