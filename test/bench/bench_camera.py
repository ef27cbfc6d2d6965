"""Measures the camera of the bridge; run it with scripts/bench.sh camera.

First, what the bridge adds to the bare picture: the time from the start of a frame to the moment
at which its message is written, over that of `pybullet.getCameraImage` alone, call by call in
turns. Then a whole setup in real time: the bridge with the camera at 30 Hz and `aruco.py`
listening, whether every frame arrives, and what it costs. Prints a table and writes JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Dict, List

import numpy as np
import psutil
import rospy
from bullet_lab.msg import MarkerDetectionArray
from sensor_msgs.msg import CameraInfo

from bullet_lab.ros.bridge import BridgeParameters, PyBulletBridge
from bullet_lab.ros.launcher.master import prepare_master
from bullet_lab.simulation.devices.camera import Camera
from bullet_lab.simulation.engine import pybullet
from bullet_lab.simulation.rendering.choice import EGL, TINY, probe_egl

WORLD = "package://bullet_lab/worlds/docking.world"
ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
RATE = 30.0
STOP_SECONDS = 10.0
PATIENCE = 60.0

LISTENER = """
import rospy
from sensor_msgs.msg import Image
rospy.init_node("bench_listener")
rospy.Subscriber("/mycamera/image_raw", Image, lambda m: None, buff_size=2**24, tcp_nodelay=True)
rospy.spin()
"""


class Stopwatch:
    """Times each frame of a bridge in this process, and a bare picture before each."""

    def __init__(self, bridge: PyBulletBridge, frames: int):
        (robot,) = (m for m in bridge.simulation.models.values() if m.model.name == "camera_robot")
        (self._camera,) = (d for d in robot.devices if isinstance(d, Camera))
        self._frames = frames
        self.bare: List[float] = []
        self.plain: List[float] = []
        self.bridge: List[float] = []
        self._call: Dict[str, Any] = {}
        self._note_the_call()
        self._produce = self._camera.produce
        self._camera.produce = self._timed_produce
        self._after_steps = bridge.stepper._after_steps
        bridge.stepper._after_steps = self._timed_flush
        self._in_frame = 0.0

    def _note_the_call(self) -> None:
        """Keep the arguments with which the bridge draws."""
        draw = pybullet.getCameraImage

        def noting(*arguments: Any, **named: Any) -> Any:
            self._call = {"arguments": arguments, "named": named}
            return draw(*arguments, **named)

        self._draw = draw
        pybullet.getCameraImage = noting

    def _timed_produce(self, step: int) -> None:
        if not self._camera.image.wanted:
            return
        if self._call:
            self.bare.append(self._timed(self._call["named"]))
            everything = {**self._call["named"], "flags": 0, "lightDirection": (1.0, 0.3, 1.0)}
            self.plain.append(self._timed(everything))
        start = time.perf_counter()
        self._produce(step)
        self._in_frame = time.perf_counter() - start

    def _timed(self, named: Dict[str, Any]) -> float:
        start = time.perf_counter()
        self._draw(*self._call["arguments"], **named)
        return time.perf_counter() - start

    def _timed_flush(self) -> None:
        start = time.perf_counter()
        self._after_steps()
        if not self._in_frame:
            return
        # The first frames load the world and compile the driver's programs.
        self.bridge.append(self._in_frame + time.perf_counter() - start)
        self._in_frame = 0.0
        if len(self.bridge) > self._frames:
            pybullet.getCameraImage = self._draw
            rospy.signal_shutdown("measured")


def frame_times(renderer: str, frames: int) -> Dict[str, float]:
    """Return medians in ms of bare pictures, PyBullet's plain ones, and whole frames.

    To be called in a process of its own: a ROS node is set up once.
    """
    rospy.init_node("bench_bridge", disable_signals=True)
    wanted = BridgeParameters(world=WORLD, robot=ROBOT, rtf=1.0, renderer=renderer)
    bridge = PyBulletBridge(wanted)
    watch = Stopwatch(bridge, frames)
    listener = subprocess.Popen([sys.executable, "-c", LISTENER])
    try:
        bridge.spin()
    finally:
        stop(listener)
    skipped = 3
    bare, plain, whole = (
        np.array(values[skipped:frames]) for values in (watch.bare, watch.plain, watch.bridge[1:])
    )
    count = min(map(len, (bare, whole)))
    return {
        "bare_ms": 1e3 * float(np.median(bare)),
        "pybullet_defaults_ms": 1e3 * float(np.median(plain)),
        "render_to_publish_ms": 1e3 * float(np.median(whole)),
        "render_to_publish_over_bare": float(np.median(whole[:count] / bare[:count])),
    }


class Stamps:
    """The simulated times of a topic's messages, in ms."""

    def __init__(self, topic: str, kind: type):
        self.times: List[int] = []
        self._subscriber = rospy.Subscriber(topic, kind, self._receive, tcp_nodelay=True)

    def _receive(self, message: Any) -> None:
        self.times.append(message.header.stamp.to_nsec() // 1_000_000)


def real_time(renderer: str, seconds: float) -> Dict[str, Any]:
    """Return how the camera does at real-time factor 1 with `aruco.py` listening."""
    rospy.set_param("/use_sim_time", True)
    bridge = start("pybullet_bridge.py", f"_world:={WORLD}", f"_robot:={ROBOT}", "_rtf:=1",
                   f"_renderer:={renderer}")  # fmt: skip
    aruco = start("aruco.py", "_image:=/mycamera/image_raw", "__name:=aruco")
    sent = Stamps("/mycamera/camera_info", CameraInfo)
    seen = Stamps("/aruco/detections", MarkerDetectionArray)
    try:
        wait_for(lambda: len(seen.times) > 30, "detections")
        processes = {"bridge": process_of(bridge), "aruco": process_of(aruco)}
        before = {name: cpu_seconds(process) for name, process in processes.items()}
        first, start_time = sent.times[-1], time.monotonic()
        time.sleep(seconds)
        last, passed = sent.times[-1], time.monotonic() - start_time
        share = {n: (cpu_seconds(p) - before[n]) / passed for n, p in processes.items()}
        # The last one may still be looked at.
        wait_for(lambda: seen.times[-1] >= last, "the last frame")
    finally:
        stop(aruco)
        stop(bridge)
    expected = [-(-1000 * k // 30) for k in range(1, 10**6) if first < 1000 * k / 30 <= last]
    return {
        "simulated_s": (last - first) / 1000.0,
        "real_time_factor": (last - first) / 1000.0 / passed,
        "frames_expected": len(expected),
        "frames_sent": len(set(expected) & set(sent.times)),
        "frames_processed": len(set(expected) & set(seen.times)),
        **{f"{name}_cpu_percent_of_a_core": 100.0 * value for name, value in share.items()},
    }


def start(script: str, *words: str) -> subprocess.Popen:
    """Start a node of the package."""
    return subprocess.Popen(["rosrun", "bullet_lab", script, *words], preexec_fn=os.setsid)


def stop(process: subprocess.Popen) -> None:
    """End a process that was started here, and wait for it."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(STOP_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def process_of(node: subprocess.Popen) -> psutil.Process:
    """Return the process that runs a node."""
    family = [psutil.Process(node.pid)]
    family += family[0].children(recursive=True)
    return max(family, key=lambda process: process.memory_info().rss)


def cpu_seconds(process: psutil.Process) -> float:
    """Return the processor time that a process has used, in s."""
    return sum(process.cpu_times()[:2])


def wait_for(condition: Any, what: str) -> None:
    """Wait until a condition holds; raises TimeoutError."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"waited in vain for {what}")
        time.sleep(0.05)


def measure(frames: int, seconds: float) -> Dict[str, Any]:
    """Run everything and return the figures."""
    works, reason = probe_egl()
    renderers = [EGL, TINY] if works else [TINY]
    figures: Dict[str, Any] = {
        "machine": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "egl": reason,
        "load_average": os.getloadavg()[0],
    }
    for renderer in renderers:
        print(f"frames of {renderer} …", flush=True)
        command = [sys.executable, __file__, "--frames-of", renderer, "--frames", str(frames)]
        out = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        figures[renderer] = json.loads(out.strip().splitlines()[-1])
    for renderer in renderers:
        print(f"real time with {renderer} …", flush=True)
        figures[renderer].update(real_time(renderer, seconds))
    return figures


def print_table(figures: Dict[str, Any]) -> None:
    """Print what was measured beside what is asked for."""
    for renderer in (name for name in (EGL, TINY) if name in figures):
        found = figures[renderer]
        expected = found["frames_expected"]
        rows = [
            ("getCameraImage as the bridge calls it, ms", f"{found['bare_ms']:.1f}", ""),
            ("getCameraImage with its defaults, ms", f"{found['pybullet_defaults_ms']:.1f}", ""),
            ("render to publish, ms", f"{found['render_to_publish_ms']:.1f}", ""),
            (
                "render to publish / getCameraImage",
                f"{found['render_to_publish_over_bare']:.2f}",
                "<= 1.30",
            ),
            ("30 Hz, aruco.py: real-time factor", f"{found['real_time_factor']:.3f}", ">= 0.99"),
            ("frames sent", f"{found['frames_sent']}", f"{expected}"),
            ("frames processed by aruco.py", f"{found['frames_processed']}", f"{expected}"),
            ("bridge, % of a core", f"{found['bridge_cpu_percent_of_a_core']:.0f}", ""),
            ("aruco.py, % of a core", f"{found['aruco_cpu_percent_of_a_core']:.0f}", ""),
        ]
        print(f"\n{renderer:44} {'measured':>9} {'asked':>9}")
        for name, value, asked in rows:
            print(f"{name:44} {value:>9} {asked:>9}")


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, nargs="?", help="JSON file to write")
    parser.add_argument("--frames", type=int, default=100, help="timed frames of each renderer")
    parser.add_argument("--seconds", type=float, default=20.0, help="wall seconds in real time")
    parser.add_argument("--frames-of", help=argparse.SUPPRESS)
    wanted = parser.parse_args()
    if wanted.frames_of:
        print(json.dumps(frame_times(wanted.frames_of, wanted.frames)))
        return
    prepare_master()
    rospy.init_node("bench", disable_signals=True)
    figures = measure(wanted.frames, wanted.seconds)
    print_table(figures)
    if wanted.out is not None:
        wanted.out.parent.mkdir(parents=True, exist_ok=True)
        wanted.out.write_text(json.dumps(figures, indent=2) + "\n")
        print(f"\nwritten to {wanted.out}")


if __name__ == "__main__":
    main()
