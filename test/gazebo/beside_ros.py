"""A stage behind a ROS master: this package's bridge, or a Gazebo, used in the same way.

:ROS Service clients: those of /gazebo; /bullet_lab/step, where it is offered
:ROS Subscribers: /clock, where it is not
:ROS Publishers: cmd_vel in the namespace of each robot
"""

import contextlib
import sys
import time
import xmlrpc.client

import rosgraph
import rospy
from beside_scenarios import PACKAGE
from geometry_msgs.msg import Point, Twist, Vector3, Wrench

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.gazebo_types import msg
from bullet_lab.ros.messages.poses import normalised_pose, pose_message, twist_message, twist_of
from bullet_lab.simulation.world.description import FrameState

sys.path += [str(PACKAGE / "test"), str(PACKAGE / "test" / "contract")]
from contract_simulator import (  # noqa: E402
    ANSWER_SECONDS,
    HALF_STEP,
    Gazebo,
    SimulatorError,
    wait_until,
)
from lab_nodes import Node, end_all  # noqa: E402, F401

STEP = "/bullet_lab/step"
"""A service that only this package's bridge offers; a Gazebo runs by the clock."""

START_SECONDS = 60.0
SETTLE_SECONDS = 0.05
"""Wall seconds from a message's arrival to its effect, while simulated time stands still."""

ASIDE = 200.0
"""Metres to where robots are put that cannot be deleted."""

SLOW_RATE = 250.0
"""Steps per wall second of a simulator that runs by the clock, which makes it stop in time."""


def start_bridge(*words):
    """Return a bridge that is started, paused, on the master that there is; none beside another."""
    services = rosgraph.Master(rospy.get_name()).getSystemState()[2]
    if "/gazebo/get_world_properties" in dict(services):
        return []
    rospy.set_param("/use_sim_time", True)
    node = Node("pybullet_bridge", "_paused:=true", *words)
    rospy.wait_for_service(STEP, START_SECONDS)
    return [node]


class RosStage(Gazebo):
    """The simulator on the ROS master, paused. `by_clock`: though there is a service that steps."""

    def __init__(self, by_clock):
        super().__init__()
        # Names, and whether they have plugins.
        self._models = {}
        self._commands = {}
        self._spawned = 0
        self._steps = STEP in self.offered() and not by_clock
        self.must("pause_physics")
        if not self._steps:
            self._rate = self._set_rate(SLOW_RATE)
            # A step too many in one run is one less in the next.
            self.time = self._until = self.sim_time()
            _wait(self._clock.get_num_connections, "nobody sends /clock")

    def spawn(self, text, pose):
        self._spawned += 1
        # A name is never used again: a Gazebo that is paused loses a model of an old name.
        name = f"beside_{round(1000 * self.sim_time())}_{self._spawned}"
        self.must(
            f"spawn_{'sdf' if '<sdf' in text else 'urdf'}_model",
            model_name=name,
            model_xml=text,
            robot_namespace=name,
            initial_pose=pose_message(pose),
        )
        self._models[name] = "<plugin" in text
        return name

    def clear(self):
        for name, publisher in self._commands.items():
            self.command(name, 0.0, 0.0, 0.0)
            publisher.unregister()
        self._commands.clear()
        for name, has_plugins in self._models.items():
            # Some plugins end a Gazebo when they are deleted.
            if has_plugins and not self._steps:
                x, y, z = self.state(name).pose.position
                self.put(name, FrameState(Pose((x + ASIDE, y + 5.0 * self._spawned, z))))
            else:
                self.must("delete_model", model_name=name)
        self._models.clear()
        if not self._steps:
            self._until = self.sim_time()

    def state(self, name):
        answer = self.must("get_model_state", model_name=name)
        return FrameState(normalised_pose(answer.pose), *twist_of(answer.twist))

    def put(self, name, state):
        message = msg.ModelState(name, pose_message(state.pose), twist_message(state), "")
        self.must("set_model_state", model_state=message)

    def command(self, name, vx, vy, wz):
        topic = f"/{name}/cmd_vel"
        if name not in self._commands:
            self._commands[name] = rospy.Publisher(topic, Twist, queue_size=1)
            _wait(self._commands[name].get_num_connections, f"nobody listens to {topic}")
        before = self._arrived(topic)
        self._commands[name].publish(Vector3(vx, vy, 0.0), Vector3(0.0, 0.0, wz))
        _wait(lambda: self._arrived(topic) != before, f"{topic} does not arrive")
        time.sleep(SETTLE_SECONDS)

    def push(self, body, push):
        self.must(
            "apply_body_wrench",
            body_name=body,
            reference_frame=push.frame,
            reference_point=Point(*push.point),
            wrench=Wrench(Vector3(*push.force), Vector3(*push.torque)),
            duration=rospy.Duration(push.seconds),
        )

    def exert(self, name, joint, effort, seconds):
        duration = rospy.Duration(seconds)
        self.must("apply_joint_effort", joint_name=joint, effort=effort, duration=duration)

    def joint(self, name, joint):
        answer = self.must("get_joint_properties", joint_name=joint)
        return answer.position[0], answer.rate[0]

    def turn_joint(self, name, joint, position):
        self.must(
            "set_model_configuration",
            model_name=name,
            joint_names=[joint],
            joint_positions=[position],
        )

    def run(self, seconds):
        if self._steps:
            self.must(STEP, steps=round(1000 * seconds))
            return
        self._until += seconds
        if self.time < self._until - HALF_STEP:
            self.run_until(self._until, seconds)

    def close(self):
        """Give the simulator its speed back, if it is still there."""
        if not self._steps:
            with contextlib.suppress(SimulatorError):
                self._set_rate(self._rate)

    def _set_rate(self, rate):
        """Set how fast it runs, in steps per wall second; return what it was."""
        now = self.must("get_physics_properties")
        kept = {name: getattr(now, name) for name in ("time_step", "gravity", "ode_config")}
        self.must("set_physics_properties", max_update_rate=rate, **kept)
        return now.max_update_rate

    def _arrived(self, topic):
        """Return what the nodes that listen to a topic say of their connections: it grows."""
        found = []
        for node in dict(self.master.getSystemState()[1]).get(topic, ()):
            with xmlrpc.client.ServerProxy(self.master.lookupNode(node)) as slave:
                answer = slave.getBusStats(rospy.get_name())
                # Nodes in C++ leave out the status and its text.
                incoming = (answer[2] if isinstance(answer[0], int) else answer)[1]
                found += [entry for entry in incoming if entry[0] == topic]
        return found


def _wait(condition, problem):
    if not wait_until(condition, ANSWER_SECONDS, 0.01):
        raise SimulatorError(problem)
