"""Measures the bridge against the bare engine; scripts/bench.sh bridge.

The bridge runs in a process of its own, with one subscriber to each of its topics.
--rounds N: of which the median is taken. --seconds S: wall time of each bridge.
"""

import contextlib
import math
import statistics
import threading
import time

import rospy
from common import options, report, start_ros
from geometry_msgs.msg import Twist, Vector3
from lab_nodes import Node, end_all
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

from bullet_lab.ros.nodes.bridge import BridgeParameters, PyBulletBridge
from bullet_lab.simulation.physics import pybullet
from bullet_lab.simulation.simulation import Simulation

WORLD = "package://bullet_lab/worlds/empty.world"
ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
AHEAD, TURN = 0.2, 0.3
BARE_STEPS = 100_000
COMMANDS = 50


@contextlib.contextmanager
def running(rtf):
    """Run a bridge whose robot drives in circles, and a subscriber to each of its topics."""
    bridge = Node("pybullet_bridge", f"_world:={WORLD}", f"_robot:={ROBOT}", f"_rtf:={rtf}")
    topics = (("/odom", Odometry), ("/tf", TFMessage), ("/clock", Clock))
    listeners = [rospy.Subscriber(topic, kind, lambda _: None) for topic, kind in topics]
    commands = rospy.Publisher("cmd_vel", Twist, queue_size=1)
    try:
        while commands.get_num_connections() < 1:
            time.sleep(0.05)
        commands.publish(Twist(linear=Vector3(AHEAD, 0, 0), angular=Vector3(0, 0, TURN)))
        time.sleep(2.0)
        yield bridge
    finally:
        for entry in (commands, *listeners):
            entry.unregister()
        end_all(bridge)


def newest_stamp():
    """Return the simulated time of the next odometry, in s."""
    return rospy.wait_for_message("/odom", Odometry, 10.0).header.stamp.to_sec()


def bare_factor():
    """Return the real-time factor of the engine and nothing else, as one would write it by hand.

    The same world and robot, the same velocity in the robot's frame before each step.
    """
    with Simulation.of(WORLD) as simulation:
        robot = simulation.spawn(ROBOT)
        body, client = robot.bodies["base_footprint"].unique_id, simulation.client
        start = time.perf_counter()
        for _ in range(BARE_STEPS):
            _, (x, y, z, w) = pybullet.getBasePositionAndOrientation(body, client)
            yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            velocity = (AHEAD * math.cos(yaw), AHEAD * math.sin(yaw), 0.0)
            pybullet.resetBaseVelocity(body, velocity, (0.0, 0.0, TURN), client)
            pybullet.stepSimulation(client)
        return BARE_STEPS * 1e-3 / (time.perf_counter() - start)


def bridge_factor(seconds):
    """Return the real-time factor of the bridge over some wall seconds at full speed."""
    with running(rtf=0.0):
        before, start = newest_stamp(), time.monotonic()
        time.sleep(seconds)
        after, end = newest_stamp(), time.monotonic()
    return (after - before) / (end - start)


def command_delays():
    """Return, for commands at odd moments, the steps from arrival to the first moved pose.

    Arrival is when the bridge's subscriber hands the command on; the bridge runs in real time
    in this process, so that both moments can be seen.
    """
    bridge = PyBulletBridge(BridgeParameters(world=WORLD, robot=ROBOT, rtf=1.0))
    simulation = bridge.simulation
    robot = simulation.models["block_robot"]
    device = next(d for d in robot.plugins if d.inputs)
    arrivals = []
    moved = []

    # What the subscriber calls, and each step's pose, both noted without changing anything.
    entry = device.inputs[0]
    handle = entry.handle

    def note_arrival(command):
        arrivals.append(simulation.step)
        handle(command)

    object.__setattr__(entry, "handle", note_arrival)
    last = [robot.pose().position]

    def note_pose(step):
        now = robot.pose().position
        if math.dist(now[:2], last[0][:2]) > 1e-6 and len(moved) < len(arrivals):
            moved.append(step)
        last[0] = now

    simulation.every(1000.0, note_pose)
    publisher = rospy.Publisher("cmd_vel", Twist, queue_size=1, tcp_nodelay=True)

    def send_commands():
        while publisher.get_num_connections() < 1:
            time.sleep(0.01)
        for number in range(COMMANDS):
            time.sleep(0.0537)
            publisher.publish(Twist(linear=Vector3(AHEAD, 0, 0)))
            while len(moved) <= number and not rospy.is_shutdown():
                time.sleep(0.001)
            # Back to rest without a command, so that the next one moves it again.
            bridge.stepper.do(lambda: device.reset(simulation.step))
        rospy.signal_shutdown("measured")

    threading.Thread(target=send_commands, daemon=True).start()
    bridge.spin()
    return [after - before for before, after in zip(arrivals, moved)]


def main():
    """Measure, print and write."""
    wanted = options(__doc__, rounds=3, seconds=5.0)
    start_ros()
    bare, bridge = [], []
    for number in range(wanted.rounds):
        bare.append(bare_factor())
        bridge.append(bridge_factor(wanted.seconds))
        print(f"round {number + 1}: bare {bare[-1]:.0f}, bridge {bridge[-1]:.0f}", flush=True)
    print("load at real-time factor 1 …")
    with running(rtf=1.0) as node:
        percent, memory = node.percent(2.0 * wanted.seconds), node.megabytes()
    print("delay from command to motion …")
    share = statistics.median(b / a for a, b in zip(bare, bridge))
    rows = [
        ("bare PyBullet loop, real-time factor", statistics.median(bare), ".0f", ""),
        ("bridge, real-time factor", statistics.median(bridge), ".0f", ">= 50"),
        ("bridge / bare", share, ".2f", ">= 0.50"),
        ("at rtf 1: % of a core", percent, ".1f", "<= 10"),
        ("at rtf 1: memory, MB", memory, ".0f", "<= 250"),
        (f"command to motion, steps (worst of {COMMANDS})", max(command_delays()), "d", "<= 1"),
    ]
    report(wanted.out, rows, bare_real_time_factor=bare, bridge_real_time_factor=bridge)


if __name__ == "__main__":
    main()
