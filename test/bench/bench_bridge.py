"""Measures the bridge against the bare engine; run it with scripts/bench.sh.

Prints a table and writes JSON. Starts a ROS master of its own unless one is given.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import signal
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, Dict, List

import psutil
import rospy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

from bullet_lab.ros.launcher.supervision import prepare_master
from bullet_lab.ros.nodes.bridge import BridgeParameters, PyBulletBridge
from bullet_lab.simulation.plugins.samples import PlanarCommand

WORLD = "package://bullet_lab/worlds/empty.world"
ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
AHEAD, TURN = 0.2, 0.3
STOP_SECONDS = 10.0

# The engine and nothing else, as one would write it by hand: the same world and robot, the same
# velocity in the robot's frame before each step.
BARE_LOOP = """
import math, sys, time
from bullet_lab.simulation.physics import pybullet as p
from bullet_lab.simulation.simulation import Simulation
simulation = Simulation.of(sys.argv[1])
robot = simulation.spawn(sys.argv[2])
body, client = robot.bodies["base_footprint"].unique_id, simulation.client
ahead, turn, steps = float(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5])
start = time.perf_counter()
for _ in range(steps):
    _, (x, y, z, w) = p.getBasePositionAndOrientation(body, client)
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    velocity = (ahead * math.cos(yaw), ahead * math.sin(yaw), 0.0)
    p.resetBaseVelocity(body, velocity, (0.0, 0.0, turn), client)
    p.stepSimulation(client)
print(steps * 1e-3 / (time.perf_counter() - start))
"""

LISTENER = """
import rospy
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage
rospy.init_node("bench_listener")
for topic, kind in (("/odom", Odometry), ("/tf", TFMessage), ("/clock", Clock)):
    rospy.Subscriber(topic, kind, lambda message: None)
rospy.spin()
"""


class Bridge:
    """A bridge in a process of its own, with one subscriber to each of its topics."""

    def __init__(self, rtf: float):
        rospy.set_param("/use_sim_time", False)
        command = ["rosrun", "bullet_lab", "pybullet_bridge.py", "__name:=bench_bridge"]
        command += [f"_world:={WORLD}", f"_robot:={ROBOT}", f"_rtf:={rtf}"]
        self._bridge = subprocess.Popen(command, preexec_fn=os.setsid)
        self._listener = subprocess.Popen([sys.executable, "-c", LISTENER])
        self._commands = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        while self._commands.get_num_connections() < 1:
            time.sleep(0.05)
        twist = Twist()
        twist.linear.x, twist.angular.z = AHEAD, TURN
        self._commands.publish(twist)
        time.sleep(2.0)

    @property
    def process(self) -> psutil.Process:
        """The process that runs the node."""
        family = [psutil.Process(self._bridge.pid)]
        family += family[0].children(recursive=True)
        return max(family, key=lambda process: process.memory_info().rss)

    def stop(self) -> None:
        """End both processes and wait for them."""
        self._commands.unregister()
        os.killpg(self._bridge.pid, signal.SIGINT)
        self._listener.send_signal(signal.SIGINT)
        for process in (self._bridge, self._listener):
            try:
                process.wait(STOP_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def newest_stamp() -> float:
    """Return the simulated time of the next odometry, in s."""
    return rospy.wait_for_message("/odom", Odometry, 10.0).header.stamp.to_sec()


def bare_factor(seconds: float) -> float:
    """Return the real-time factor of the bare engine loop."""
    steps = str(int(seconds * 1000))
    command = [sys.executable, "-c", BARE_LOOP, WORLD, ROBOT, str(AHEAD), str(TURN), steps]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def bridge_factor(seconds: float) -> float:
    """Return the real-time factor of the bridge over some wall seconds at full speed."""
    bridge = Bridge(rtf=0.0)
    before, start = newest_stamp(), time.monotonic()
    time.sleep(seconds)
    after, end = newest_stamp(), time.monotonic()
    bridge.stop()
    return (after - before) / (end - start)


def real_time_load(seconds: float) -> Dict[str, float]:
    """Return processor share and memory of the bridge at real-time factor 1."""
    bridge = Bridge(rtf=1.0)
    process = bridge.process
    before, start = sum(process.cpu_times()[:2]), time.monotonic()
    time.sleep(seconds)
    share = (sum(process.cpu_times()[:2]) - before) / (time.monotonic() - start)
    memory = process.memory_info().rss
    bridge.stop()
    return {"cpu_percent_of_a_core": 100.0 * share, "memory_mb": memory / 1e6}


def command_delays(count: int) -> List[int]:
    """Return, for commands at odd moments, the steps from arrival to the first moved pose.

    Arrival is when the bridge's subscriber hands the command on; the bridge runs in real time
    in this process, so that both moments can be seen.
    """
    rospy.set_param("/use_sim_time", False)
    wanted = BridgeParameters(world=WORLD, robot=ROBOT, rtf=1.0)
    bridge = PyBulletBridge(wanted)
    simulation = bridge.simulation
    device = next(d for d in simulation.models["block_robot"].plugins if d.inputs)
    arrivals: List[int] = []
    moved: List[int] = []
    place = simulation.models["block_robot"].pose

    # What the subscriber calls, and each step's pose, both noted without changing anything.
    entry = device.inputs[0]
    handle = entry.handle

    def note_arrival(command: PlanarCommand) -> None:
        arrivals.append(simulation.step)
        handle(command)

    object.__setattr__(entry, "handle", note_arrival)
    last = [place().position]

    def note_pose(step: int) -> None:
        now = place().position
        if math.dist(now[:2], last[0][:2]) > 1e-6 and len(moved) < len(arrivals):
            moved.append(step)
        last[0] = now

    simulation.every(1000.0, note_pose)
    publisher = rospy.Publisher("cmd_vel", Twist, queue_size=1, tcp_nodelay=True)

    def send_commands() -> None:
        while publisher.get_num_connections() < 1:
            time.sleep(0.01)
        for number in range(count):
            time.sleep(0.0537)
            twist = Twist()
            twist.linear.x = AHEAD
            publisher.publish(twist)
            while len(moved) <= number and not rospy.is_shutdown():
                time.sleep(0.001)
            # Back to rest without a command, so that the next one moves it again.
            bridge.stepper.do(lambda: device.reset(simulation.step))
        rospy.signal_shutdown("measured")

    threading.Thread(target=send_commands, daemon=True).start()
    bridge.spin()
    return [after - before for before, after in zip(arrivals, moved)]


def measure(rounds: int, seconds: float) -> Dict[str, Any]:
    """Run everything and return the figures."""
    bare, bridge = [], []
    for number in range(rounds):
        bare.append(bare_factor(100.0))
        bridge.append(bridge_factor(seconds))
        print(f"round {number + 1} of {rounds}: bare {bare[-1]:.0f}, bridge {bridge[-1]:.0f}")
    print("load at real-time factor 1 …")
    load = real_time_load(2.0 * seconds)
    print("delay from command to motion …")
    delays = command_delays(50)
    return {
        "machine": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "bare_real_time_factor": bare,
        "bridge_real_time_factor": bridge,
        "bare_median": statistics.median(bare),
        "bridge_median": statistics.median(bridge),
        "bridge_share_of_bare": statistics.median(b / a for a, b in zip(bare, bridge)),
        **load,
        "commands": len(delays),
        "largest_command_delay_steps": max(delays),
    }


def print_table(figures: Dict[str, Any]) -> None:
    """Print what was measured beside what is asked for."""
    rows = [
        ("bare PyBullet loop, real-time factor", f"{figures['bare_median']:.0f}", ""),
        ("bridge, real-time factor", f"{figures['bridge_median']:.0f}", ">= 50"),
        ("bridge / bare", f"{figures['bridge_share_of_bare']:.2f}", ">= 0.50"),
        ("at rtf 1: % of a core", f"{figures['cpu_percent_of_a_core']:.1f}", "<= 10"),
        ("at rtf 1: memory, MB", f"{figures['memory_mb']:.0f}", "<= 250"),
        (
            f"command to motion, steps (worst of {figures['commands']})",
            f"{figures['largest_command_delay_steps']}",
            "<= 1",
        ),
    ]
    print(f"\n{'':44} {'measured':>9} {'asked':>9}")
    for name, value, asked in rows:
        print(f"{name:44} {value:>9} {asked:>9}")


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="JSON file to write")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0, help="wall seconds of each bridge")
    wanted = parser.parse_args()
    prepare_master()
    rospy.init_node("bench", disable_signals=True)
    figures = measure(wanted.rounds, wanted.seconds)
    print_table(figures)
    wanted.out.parent.mkdir(parents=True, exist_ok=True)
    wanted.out.write_text(json.dumps(figures, indent=2) + "\n")
    print(f"\nwritten to {wanted.out}")


if __name__ == "__main__":
    main()
