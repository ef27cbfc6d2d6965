"""The node that stands in for Gazebo: it steps the simulation and speaks its topics.

:ROS Parameters: see `BridgeParameters`.
:ROS Publishers:
    - /clock (rosgraph_msgs/Clock), 100 Hz of simulated time
    - /bullet_lab/world (visualization_msgs/MarkerArray), latched: the shapes of the world
    - /tf, and /tf_static if asked for
    - whatever the plugins of the robot name, such as odom (nav_msgs/Odometry)
:ROS Subscribers: whatever the plugins of the robot name, such as cmd_vel (geometry_msgs/Twist)
:ROS Services:
    - /gazebo/pause_physics, unpause_physics, reset_world, reset_simulation (std_srvs/Empty)
    - /bullet_lab/step (bullet_lab/Step): advance by exactly n steps of 1 ms, paused or not
    - /bullet_lab/advance (bullet_lab/Advance): lock step, see `bullet_lab.ros.lock_step`
"""

from __future__ import annotations

import contextlib
import queue
import sys
import threading
import time
import xmlrpc.client
from collections import Counter
from dataclasses import dataclass
from typing import Any, Callable, List, Optional, Tuple

import rosgraph
import rospy
import rospy.impl.simtime
import rospy.rostime
import tf2_ros
from geometry_msgs.msg import TransformStamped
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Empty, EmptyResponse
from visualization_msgs.msg import MarkerArray

from bullet_lab.ros import parameters
from bullet_lab.ros.conversions import (
    INPUT_CONVERTERS,
    NANOSECONDS_PER_STEP,
    OUTPUT_CONVERTERS,
    first_step_at,
    set_time,
    time_of,
)
from bullet_lab.ros.node import (
    NodeError,
    Publisher,
    Refusals,
    lossless_publisher,
    private_parameters,
    run_node,
)
from bullet_lab.ros.pace import Pace
from bullet_lab.ros.time_gate import FOR_EVER, TimeGate
from bullet_lab.ros.world_markers import world_markers
from bullet_lab.simulation.devices import DeviceError, Input, Output
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.resources import ResourceFinder
from bullet_lab.simulation.samples import OdometrySample, TransformSample
from bullet_lab.simulation.simulation import ModelInstance, Simulation
from bullet_lab.simulation.urdf_reader import read_urdf, read_urdf_file
from bullet_lab.srv import Advance, AdvanceResponse, Step, StepResponse

# Between two looks at what others want, at full speed: about half a millisecond of wall time.
STEPS_AT_A_TIME = 50
# Longest sleep while there is nothing to do, so that Ctrl-C is not kept waiting.
LONGEST_WAIT = 0.2
# Wall seconds after which whoever holds time back is asked whether it is still alive.
PATIENCE = 2.0
# Messages that wait for a slow subscriber while time follows the wall clock.
QUEUE_SIZE = 100
# Hz; this costs more than a message on /clock.
LOG_TIME_RATE = 5.0
# A grant up to here, the end of ROS time, means "for ever".
END_OF_TIME = 2**31 - 1


@dataclass(frozen=True)
class BridgeParameters:
    """Private parameters of the bridge."""

    world: str = parameters.text(
        "package://bullet_lab/worlds/empty.world", "SDF world: a path, package:// or model://"
    )
    robot: str = parameters.text(
        "", "URDF robot: a path or package://; empty for the parameter robot_description"
    )
    robot_name: str = parameters.text("", "name of the robot's model; its own if empty")
    robot_namespace: str = parameters.text("", "robotNamespace of plugins that have none")
    robot_pose: Tuple[float, ...] = parameters.number_list(
        (0.0,) * 6, "where the robot starts: x y z in metres, roll pitch yaw in radians"
    )
    rtf: float = parameters.number(
        1.0, "simulated seconds per wall second; 0 for as fast as it goes", minimum=0.0
    )
    clock_rate: float = parameters.number(
        100.0, "messages on /clock per simulated second", above=0.0, maximum=1000.0
    )
    paused: bool = parameters.boolean(False, "start paused")
    lock_step: Tuple[str, ...] = parameters.name_list("nodes that time waits for")
    world_frame: str = parameters.text("world", "frame of the markers on /bullet_lab/world")
    publish_world_tf: bool = parameters.boolean(
        False, "say on /tf_static that the odometry frames lie in the world frame"
    )


class PyBulletBridge:
    """Runs a simulation for ROS. PyBullet is touched by the thread that calls `spin` alone."""

    def __init__(self, wanted: BridgeParameters):
        self._wanted = wanted
        self._simulation = Simulation.of(wanted.world)
        self._pace = Pace(wanted.rtf)
        self._gate = TimeGate(map(rospy.resolve_name, wanted.lock_step))
        self._refusals = Refusals()
        self._paused = wanted.paused
        self._wake = threading.Condition()
        self._wakeups = 0
        self._tasks: queue.Queue[_Task] = queue.Queue()
        self._commands: Counter = Counter()
        self._stalled_since: Optional[float] = None
        self._subscribers: List[rospy.Subscriber] = []
        _take_over_the_clock()
        self._clock = Clock()
        self._clock_publisher = self._publisher("/clock", Clock)
        self._simulation.every(wanted.clock_rate, self._publish_clock)
        self._simulation.every(LOG_TIME_RATE, _set_log_time)
        self._tf_publishers = {}
        self._static_tf = tf2_ros.StaticTransformBroadcaster()
        self._world_publisher = Publisher(
            "/bullet_lab/world", MarkerArray, queue_size=1, latch=True
        )
        robot = self._add_robot()
        self._publish_world(robot)
        self._services = self._offer_services()

    @property
    def simulation(self) -> Simulation:
        """The simulation; only the thread in `spin` may advance or change it."""
        return self._simulation

    def spin(self) -> None:
        """Run until ROS shuts down."""
        rospy.on_shutdown(self._notify)
        self._pace.restart(self._simulation.step)
        try:
            while not rospy.is_shutdown():
                self._run_tasks()
                self._go_on()
        finally:
            self._notify()
            self._simulation.close()

    def _go_on(self) -> None:
        """Advance as far as is due and allowed, or wait."""
        # Read before anything is looked at: what changes from here on cuts the wait short.
        wakeups = self._wakeups
        step = self._simulation.step
        limit = -1 if self._paused else self._gate.limit()
        if limit is None or limit <= step:
            self._pace.restart(step)
            self._watch_the_stall()
            self._wait(LONGEST_WAIT, wakeups)
            return
        self._stalled_since = None
        due = self._pace.due(step)
        if due <= step:
            # Sleep to the next tick of the clock; a command or a service call wakes earlier.
            tick = step + max(1, round(1000 / self._wanted.clock_rate))
            self._wait(min(LONGEST_WAIT, self._pace.seconds_until(tick)), wakeups)
            due = self._pace.due(step)
        self._simulation.run_until(int(min(limit, due, step + STEPS_AT_A_TIME)))
        self._tell_waiting()

    def _wait(self, seconds: float, wakeups: int) -> None:
        with self._wake:
            if self._wakeups == wakeups and not rospy.is_shutdown():
                self._wake.wait(seconds)

    def _notify(self) -> None:
        with self._wake:
            self._wakeups += 1
            self._wake.notify_all()

    def _tell_waiting(self) -> None:
        if self._gate.limit() != FOR_EVER:
            self._notify()

    def _do(self, action: Callable[[], Any]) -> Any:
        """Have the simulation's thread do something and return what it returns."""
        task = _Task(action)
        self._tasks.put(task)
        self._notify()
        while not task.done.wait(LONGEST_WAIT):
            if rospy.is_shutdown():
                raise rospy.ServiceException("the bridge is shutting down")
        return task.result

    def _run_tasks(self) -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                self._tasks.get_nowait().run()

    # Outputs

    def _publisher(self, topic: str, kind: type) -> Publisher:
        """Return a publisher that fits the pace.

        At full speed nothing may be lost, so the simulation waits for its subscribers. Tied to
        the wall clock it does not wait for anybody, as Gazebo does not.
        """
        if self._pace.free:
            return lossless_publisher(topic, kind)
        return Publisher(topic, kind, queue_size=QUEUE_SIZE, tcp_nodelay=True)

    def _publish_clock(self, step: int) -> None:
        set_time(self._clock.clock, step)
        self._clock_publisher.publish(self._clock)

    def _connect_output(self, output: Output) -> None:
        converter = OUTPUT_CONVERTERS[output.kind]()
        publisher = self._tf_publishers.get(output.topic)
        if publisher is None:
            publisher = self._publisher(output.topic, converter.message_kind)
        if output.kind is TransformSample:
            self._tf_publishers[output.topic] = publisher
        convert, publish = converter.convert, publisher.publish
        output.connect(lambda sample: publish(convert(sample)))

    def _publish_world(self, robot: Optional[ModelInstance]) -> None:
        things = (m for m in self._simulation.models.values() if m is not robot)
        self._world_publisher.publish(world_markers(things, self._wanted.world_frame))

    # Inputs

    def _connect_input(self, entry: Input) -> None:
        converter = INPUT_CONVERTERS[entry.kind]

        def receive(message: Any) -> None:
            command = converter.convert(message)
            if self._pace.free:
                self._command(entry, command)
            else:
                # Simulated time sleeps between ticks: bring it to this moment first, so that
                # the command acts from now on and not from the last tick.
                self._do(lambda: self._command_now(entry, command))
            with self._wake:
                self._commands[message._connection_header["callerid"]] += 1
                self._wake.notify_all()

        self._subscribers.append(
            rospy.Subscriber(entry.topic, converter.message_kind, receive, tcp_nodelay=True)
        )

    def _command_now(self, entry: Input, command: Any) -> None:
        step = self._simulation.step
        limit = self._gate.limit()
        if not self._paused and limit is not None:
            self._simulation.run_until(int(max(step, min(limit, self._pace.due(step)))))
        self._command(entry, command)

    def _command(self, entry: Input, command: Any) -> None:
        try:
            entry.handle(command)
        except DeviceError as error:
            self._refusals.refuse(entry.topic, str(error))

    # The robot

    def _add_robot(self) -> Optional[ModelInstance]:
        model = self._read_robot()
        if model is None:
            return None
        x, y, z, roll, pitch, yaw = self._wanted.robot_pose
        pose = Pose.from_rpy((x, y, z), (roll, pitch, yaw))
        robot = self._simulation.add(
            model, self._wanted.robot_name, pose, self._wanted.robot_namespace
        )
        for device in robot.devices:
            for output in device.outputs:
                self._connect_output(output)
            for entry in device.inputs:
                self._connect_input(entry)
        if self._wanted.publish_world_tf:
            self._publish_odometry_frames(robot)
        return robot

    def _read_robot(self) -> Any:
        if self._wanted.robot:
            return read_urdf_file(ResourceFinder.anywhere().find(self._wanted.robot))
        text = rospy.get_param("robot_description", "")
        return read_urdf(text, "robot_description") if text else None

    def _publish_odometry_frames(self, robot: ModelInstance) -> None:
        """Say that absolute odometry is given in the world's frame."""
        frames = {
            device.odometry.frame
            for device in robot.devices
            if any(output.kind is OdometrySample for output in device.outputs)
        }
        transforms = []
        for frame in sorted(frames):
            transform = TransformStamped()
            transform.header.frame_id = self._wanted.world_frame
            transform.child_frame_id = frame
            transform.transform.rotation.w = 1.0
            transforms.append(transform)
        self._static_tf.sendTransform(transforms)

    # Services

    def _offer_services(self) -> List[rospy.Service]:
        empty = {
            "pause_physics": self._pause,
            "unpause_physics": self._unpause,
            "reset_world": self._simulation.reset_world,
            "reset_simulation": self._reset_simulation,
        }
        services = [
            rospy.Service(f"/gazebo/{name}", Empty, self._empty_service(action))
            for name, action in empty.items()
        ]
        services.append(rospy.Service("/bullet_lab/step", Step, self._handle_step))
        services.append(rospy.Service("/bullet_lab/advance", Advance, self._handle_advance))
        return services

    def _empty_service(self, action: Callable[[], None]) -> Callable[[Any], EmptyResponse]:
        def handle(_request: Any) -> EmptyResponse:
            self._do(action)
            return EmptyResponse()

        return handle

    def _pause(self) -> None:
        self._paused = True

    def _unpause(self) -> None:
        self._paused = False
        self._pace.restart(self._simulation.step)

    def _reset_simulation(self) -> None:
        self._simulation.reset_simulation()
        self._gate.restart()
        self._pace.restart(0)

    def _handle_step(self, request: Any) -> StepResponse:
        def advance() -> int:
            self._simulation.run_until(self._simulation.step + request.steps)
            self._pace.restart(self._simulation.step)
            return self._simulation.step

        now = self._do(advance)
        return StepResponse(now=time_of(now), success=True, status_message="")

    def _handle_advance(self, request: Any) -> AdvanceResponse:
        member = request.node
        if not self._await_commands(member, request.commands):
            arrived = self._commands[member]
            rospy.logwarn("%s sent %d commands, %d arrived", member, request.commands, arrived)
            self._commands[member] = request.commands
        until = FOR_EVER if request.until.secs >= END_OF_TIME else first_step_at(request.until)
        self._gate.grant(member, until)
        self._notify()
        if until != FOR_EVER:
            self._await_step(until)
        now = self._simulation.step
        reached = until == FOR_EVER or now >= until
        message = "" if reached else "time was set back or the bridge shuts down"
        return AdvanceResponse(now=time_of(now), success=reached, status_message=message)

    def _await_commands(self, member: str, count: int) -> bool:
        """Wait for commands that are still under way; False if they do not come."""
        with self._wake:
            return self._wake.wait_for(lambda: self._commands[member] >= count, PATIENCE)

    def _await_step(self, step: int) -> None:
        start = self._simulation.step

        def over() -> bool:
            now = self._simulation.step
            return now >= step or now < start or rospy.is_shutdown()

        with self._wake:
            while not self._wake.wait_for(over, LONGEST_WAIT):
                pass

    # Stalls

    def _watch_the_stall(self) -> None:
        """Report who holds time back for long, and go on without those that have died."""
        if self._paused:
            return
        now = time.monotonic()
        if self._stalled_since is None:
            self._stalled_since = now
        if now - self._stalled_since < PATIENCE:
            return
        self._stalled_since = now
        for member in self._gate.holding():
            started = self._simulation.step > 0
            if started and not _answers(member):
                rospy.logwarn("%s holds simulated time back and is gone: going on", member)
                self._gate.leave(member)
            else:
                rospy.loginfo("simulated time waits for %s", member)


@dataclass
class _Task:
    """Something for the simulation's thread to do."""

    action: Callable[[], Any]

    def __post_init__(self):
        self.done = threading.Event()
        self.result: Any = None

    def run(self) -> None:
        self.result = self.action()
        self.done.set()


def _take_over_the_clock() -> None:
    """Stop this node from listening to the /clock that it sends itself."""
    own = getattr(rospy.impl.simtime, "_clock_sub", None)
    if own is not None:
        own.unregister()


def _set_log_time(step: int) -> None:
    """Give this node's log messages the simulated time, since it does not hear /clock."""
    rospy.rostime._set_rostime(rospy.Time(*divmod(step * NANOSECONDS_PER_STEP, 10**9)))


def _answers(node: str) -> bool:
    """Return whether a node is registered and alive."""
    master = rosgraph.Master(rospy.get_name() if rospy.core.is_initialized() else "/bullet_lab")
    try:
        with xmlrpc.client.ServerProxy(master.lookupNode(node)) as proxy:
            proxy.getPid(master.caller_id)
    except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
        return False
    return True


def refuse_second_simulator() -> None:
    """Make sure that nobody else gives the time.

    Raises:
        NodeError: a living node publishes /clock already.
    """
    master = rosgraph.Master("/bullet_lab")
    publishers, _, _ = master.getSystemState()
    for topic, nodes in publishers:
        for node in nodes if topic == "/clock" else ():
            if _answers(node):
                raise NodeError(
                    f"{node} publishes /clock already: one simulator is enough for a ROS master"
                )


def main() -> None:
    """Run the node."""
    # A waiting thread gets its turn after this long instead of 5 ms: many steps at full speed.
    sys.setswitchinterval(5e-4)

    def body() -> None:
        bridge = PyBulletBridge(private_parameters(BridgeParameters))
        bridge.spin()

    run_node("pybullet_bridge", body, before=refuse_second_simulator)
