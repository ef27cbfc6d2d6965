"""A stage behind a ROS master: this package's bridge, or a Gazebo, used in the same way.

:ROS Service clients: those of /gazebo; /bullet_lab/step, where it is offered
:ROS Subscribers: /clock, where it is not
:ROS Publishers: cmd_vel in the namespace of each robot
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
import xmlrpc.client
from typing import Any, Dict, List, Tuple

import rosgraph
import rospy
from beside_scenarios import PACKAGE, Push, Stage
from bullet_lab.srv import Step
from geometry_msgs.msg import Point, Twist, Vector3, Wrench
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Empty

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.ros.messages.gazebo_types import msg, srv
from bullet_lab.ros.messages.poses import normalised_pose, pose_message, twist_message, twist_of
from bullet_lab.simulation.world.description import FrameState

sys.path.insert(0, str(PACKAGE / "test"))
from lab_nodes import Node, end_all  # noqa: E402, F401

CALLER = "/beside_gazebo"
STEP = "/bullet_lab/step"
"""A service that only this package's bridge offers; a Gazebo runs by the clock."""

START_SECONDS = 60.0
ANSWER_SECONDS = 20.0
SETTLE_SECONDS = 0.05
"""Wall seconds from a message's arrival to its effect, while simulated time stands still."""

ASIDE = 200.0
"""Metres to where robots are put that cannot be deleted."""

SLOW_RATE = 250.0
"""Steps per wall second of a simulator that runs by the clock, which makes it stop in time."""

HALF_STEP = 5e-4
SLOWEST = 60.0
"""Wall seconds in which a simulated second must pass."""


class StageError(LabError):
    """The simulator does not do what is asked of it."""


def start_bridge(*words: str) -> Node:
    """Start a bridge, paused, on the master that there is."""
    rospy.set_param("/use_sim_time", True)
    node = Node("pybullet_bridge", "_paused:=true", *words)
    rospy.wait_for_service(STEP, START_SECONDS)
    return node


def is_there(service: str = "/gazebo/get_world_properties") -> bool:
    """Return whether a service is registered."""
    offered = rosgraph.Master(CALLER).getSystemState()[2]
    return service in (name for name, _ in offered)


class RosStage(Stage):
    """The simulator on the ROS master, paused. `by_clock`: though there is a service that steps."""

    def __init__(self, by_clock: bool = False):
        self._proxies: Dict[str, rospy.ServiceProxy] = {}
        # Names, and whether they have plugins.
        self._models: Dict[str, bool] = {}
        self._commands: Dict[str, rospy.Publisher] = {}
        self._spawned = 0
        self._steps = is_there(STEP) and not by_clock
        rospy.ServiceProxy("/gazebo/pause_physics", Empty)()
        if not self._steps:
            self._rate = self._set_rate(SLOW_RATE)
            # A step too many in one run is one less in the next.
            self._until = self.now()
            self._clock = _Clock(self._until)

    def spawn(self, text: str, pose: Pose) -> str:
        self._spawned += 1
        # A name is never used again: a Gazebo that is paused loses a model of an old name.
        name = f"beside_{round(1000 * self.now())}_{self._spawned}"
        kind = "sdf" if "<sdf" in text else "urdf"
        self.call(f"spawn_{kind}_model", srv.SpawnModel, name, text, name, pose_message(pose), "")
        self._models[name] = "<plugin" in text
        return name

    def clear(self) -> None:
        for name, publisher in self._commands.items():
            self.command(name, 0.0, 0.0, 0.0)
            publisher.unregister()
        self._commands.clear()
        for name, has_plugins in self._models.items():
            # Some plugins end a Gazebo when they are deleted.
            if has_plugins and not self._steps:
                self._put_aside(name)
            else:
                self.call("delete_model", srv.DeleteModel, name)
        self._models.clear()
        if not self._steps:
            self._until = self.now()

    def _put_aside(self, name: str) -> None:
        x, y, z = self.state(name).pose.position
        self.put(name, FrameState(Pose((x + ASIDE, y + 5.0 * self._spawned, z))))

    def state(self, name: str) -> FrameState:
        answer = self.call("get_model_state", srv.GetModelState, name, "")
        return FrameState(normalised_pose(answer.pose), *twist_of(answer.twist))

    def put(self, name: str, state: FrameState) -> None:
        message = msg.ModelState(name, pose_message(state.pose), twist_message(state), "")
        self.call("set_model_state", srv.SetModelState, message)

    def command(self, name: str, vx: float, vy: float, wz: float) -> None:
        if name not in self._commands:
            self._commands[name] = rospy.Publisher(f"/{name}/cmd_vel", Twist, queue_size=1)
            _wait(self._commands[name].get_num_connections, f"nobody listens to /{name}/cmd_vel")
        before = arrived(f"/{name}/cmd_vel")
        self._commands[name].publish(Vector3(vx, vy, 0.0), Vector3(0.0, 0.0, wz))
        _wait(lambda: arrived(f"/{name}/cmd_vel") != before, f"/{name}/cmd_vel does not arrive")
        time.sleep(SETTLE_SECONDS)

    def push(self, body: str, push: Push) -> None:
        wrench = Wrench(Vector3(*push.force), Vector3(*push.torque))
        words = (Point(*push.point), wrench, rospy.Time(), rospy.Duration(push.seconds))
        self.call("apply_body_wrench", srv.ApplyBodyWrench, body, push.frame, *words)

    def exert(self, name: str, joint: str, effort: float, seconds: float) -> None:
        words = (effort, rospy.Time(), rospy.Duration(seconds))
        self.call("apply_joint_effort", srv.ApplyJointEffort, joint, *words)

    def joint(self, name: str, joint: str) -> Tuple[float, float]:
        answer = self.call("get_joint_properties", srv.GetJointProperties, joint)
        return answer.position[0], answer.rate[0]

    def turn_joint(self, name: str, joint: str, position: float) -> None:
        words = (name, "", [joint], [position])
        self.call("set_model_configuration", srv.SetModelConfiguration, *words)

    def run(self, seconds: float) -> None:
        if self._steps:
            steps = round(1000 * seconds)
            self.call(STEP, Step, steps)
            return
        self._until += seconds
        if self._clock.now >= self._until - HALF_STEP:
            return
        self.call("unpause_physics", Empty)
        self._clock.wait(self._until - HALF_STEP, SLOWEST * max(seconds, 1.0))
        self.call("pause_physics", Empty)

    def now(self) -> float:
        """Return simulated time in s."""
        return self.call("get_world_properties", srv.GetWorldProperties).sim_time

    def close(self) -> None:
        """Give the simulator its speed back, if it is still there."""
        if not self._steps:
            with contextlib.suppress(StageError):
                self._set_rate(self._rate)

    def _set_rate(self, rate: float) -> float:
        """Set how fast it runs, in steps per wall second; return what it was."""
        now = self.call("get_physics_properties", srv.GetPhysicsProperties)
        words = (now.time_step, rate, now.gravity, now.ode_config)
        self.call("set_physics_properties", srv.SetPhysicsProperties, *words)
        return now.max_update_rate

    def call(self, service: str, kind: Any, *words: Any) -> Any:
        """Return the answer of a service, by default of /gazebo; raise StageError."""
        name = service if service.startswith("/") else f"/gazebo/{service}"
        try:
            if name not in self._proxies:
                rospy.wait_for_service(name, ANSWER_SECONDS)
                self._proxies[name] = rospy.ServiceProxy(name, kind)
            answer = self._proxies[name](*words)
        except (rospy.ServiceException, rospy.ROSException, OSError) as error:
            raise StageError(f"{name}: {error}") from error
        if not getattr(answer, "success", True):
            raise StageError(f"{name}: {answer.status_message}")
        return answer


class _Clock:
    """Simulated time as /clock has it."""

    def __init__(self, now: float):
        self._changed = threading.Condition()
        self.now = now
        subscriber = rospy.Subscriber("/clock", Clock, self._take, tcp_nodelay=True)
        _wait(subscriber.get_num_connections, "nobody sends /clock")

    def _take(self, message: Clock) -> None:
        with self._changed:
            self.now = message.clock.to_sec()
            self._changed.notify_all()

    def wait(self, until: float, seconds: float) -> None:
        """Wait until simulated time has reached `until`, at most for some wall seconds."""
        with self._changed:
            if not self._changed.wait_for(lambda: self.now >= until, seconds):
                raise StageError(f"/clock did not reach {until:.3f} s in {seconds:.0f} s")


def arrived(topic: str) -> List[Any]:
    """Return what the nodes that listen to a topic say of their connections: it grows."""
    master = rosgraph.Master(CALLER)
    nodes = dict(master.getSystemState()[1]).get(topic, ())
    found = []
    for node in nodes:
        with xmlrpc.client.ServerProxy(master.lookupNode(node)) as slave:
            answer = slave.getBusStats(CALLER)
            # Nodes in C++ leave out the status and its text.
            incoming = (answer[2] if isinstance(answer[0], int) else answer)[1]
            found += [entry for entry in incoming if entry[0] == topic]
    return found


def _wait(condition: Any, problem: str) -> None:
    until = time.monotonic() + ANSWER_SECONDS
    while not condition():
        if time.monotonic() > until:
            raise StageError(problem)
        time.sleep(0.01)
