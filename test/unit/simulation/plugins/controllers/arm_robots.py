"""The arm of test/tutorials for tests without ROS, with goals for its controllers."""

import functools

import yaml
from control_robots import control_of, run
from shared import PACKAGE

from bullet_lab.simulation.plugins.controllers.actions import Goal
from bullet_lab.simulation.plugins.samples import Trajectory, TrajectoryGoal, TrajectoryPoint
from bullet_lab.simulation.world.urdf import expand_xacro, read_urdf

CONFIG = yaml.safe_load((PACKAGE / "test/tutorials/config/arm.yaml").read_text())
NAMES = tuple(CONFIG["arm_controller"]["joints"])
GAINS = yaml.safe_load("""
position: {}
velocity:
  gains:
    shoulder_pan_joint: &p {p: 20.0}
    shoulder_lift_joint: *p
    elbow_joint: *p
    wrist_1_joint: *p
    wrist_2_joint: *p
    wrist_3_joint: *p
  velocity_ff:
    shoulder_pan_joint: 1.0
    shoulder_lift_joint: 1.0
    elbow_joint: 1.0
    wrist_1_joint: 1.0
    wrist_2_joint: 1.0
    wrist_3_joint: 1.0
effort:
  gains:
    shoulder_pan_joint: &lifting {p: 3000.0, i: 500.0, d: 60.0, i_clamp: 100.0}
    shoulder_lift_joint: *lifting
    elbow_joint: *lifting
    wrist_1_joint: &turning {p: 300.0, i: 50.0, d: 6.0, i_clamp: 30.0}
    wrist_2_joint: *turning
    wrist_3_joint: *turning
""")


@functools.lru_cache(maxsize=None)
def arm_urdf():
    return expand_xacro(PACKAGE / "test/tutorials/urdf/arm.urdf.xacro")


def spawn_arm(world, kind="position", change=lambda urdf: urdf):
    """Put the arm into a world; return its manager."""
    urdf = change(arm_urdf().replace("PositionJoint", f"{kind.title()}Joint"))
    instance = world.add(read_urdf(urdf, "here"), namespace="arm")
    return control_of(instance).configure(urdf, {})


def arm_controller(world, kind="position", **parameters):
    """Spawn the arm with its controller of trajectories, which runs; return the controller."""
    given = {**CONFIG["arm_controller"], **GAINS[kind], **parameters}
    given["type"] = f"{kind}_controllers/JointTrajectoryController"
    controller = run(spawn_arm(world, kind), "arm_controller", **given)
    world.run_for(0.01)
    return controller


def trajectory(*points, joints=NAMES, start=0.0):
    """Return a trajectory of points: seconds and positions, velocities, accelerations.

    A number stands for that of each joint.
    """
    listed = (
        TrajectoryPoint(
            seconds,
            *((values,) * len(joints) if isinstance(values, float) else values for values in lists),
        )
        for seconds, *lists in points
    )
    return Trajectory(start, joints, tuple(listed))


class Sent:
    """A goal that a controller has got, with its states and feedback, after some time."""

    def __init__(self, controller, content, world=None, seconds=0.0):
        if isinstance(content, Trajectory):
            content = TrajectoryGoal(content, {}, {}, 0.0)
        self.states, self.told, self.result, self.text = [], [], None, ""
        self.goal = Goal(content, self._move, self.told.append)
        controller.receive(self.goal)
        if world:
            world.run_for(seconds)

    def _move(self, state, result, text):
        self.states.append(state)
        self.result, self.text = result, text


def positions(controller):
    return [joint.position for joint in controller.joints]
