"""The nodes of a soak, and what they take of the machine."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from pathlib import Path
from typing import Dict, List, Tuple

import psutil
import rospy

NODES: Dict[str, Tuple[str, ...]] = {
    "pybullet_bridge": (
        "_world:=package://bullet_lab/worlds/docking.world",
        "_robot:=package://bullet_lab/urdf/camera_robot.urdf",
        "_rtf:=0",
        "_camera_rate:=2",
        "_lock_step:=noisy_odom_node drive_squares aruco",
    ),
    "noisy_odom": ("_std:=0.1", "_lock_step:=true"),
    "drive_squares": ("_mode:=closed_loop", "_sides:=1000000", "_side:=1.5", "_lock_step:=true"),
    "aruco": ("_image:=mycamera/image_raw", "_publish_tf:=true", "_lock_step:=true"),
    "track_robot": ("_watch:=true",),
    "dock": (),
}
VISITOR = "canny_edges"
"""A node that comes and goes."""

_MEGABYTE = 2.0**20
_START_SECONDS, _STOP_SECONDS = 120.0, 20.0


class Lab:
    """Nodes as processes, which end with this one."""

    def __init__(self, folder: Path, seed: int):
        self._folder = folder
        self._nodes = {
            n: self._start(n, *words) for n, words in NODES.items() if n != "pybullet_bridge"
        }
        bridge = (*NODES["pybullet_bridge"], f"_seed:={seed}", f"_save_folder:={folder}")
        self._nodes["pybullet_bridge"] = self._start("pybullet_bridge", *bridge)
        self._visitor: List[subprocess.Popen] = []
        rospy.wait_for_service("/bullet_lab/advance", _START_SECONDS)

    def _start(self, name: str, *words: str) -> subprocess.Popen:
        with (self._folder / f"{name}.log").open("a") as log:
            return subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", "rosrun", "bullet_lab", f"{name}.py", *words],
                cwd=self._folder,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONFAULTHANDLER": "1"},
                # Ctrl-C is for whoever looks after it.
                start_new_session=True,
            )

    def taken(self) -> Dict[str, Tuple[float, int, int]]:
        """Return each node's memory, see `memory_of`, its descriptors and its threads."""
        found = {}
        for name in NODES:
            process = psutil.Process(self._nodes[name].pid)
            with process.oneshot():
                found[name] = (memory_of(process), process.num_fds(), process.num_threads())
        return found

    def dead(self) -> List[str]:
        """Return what is to be said of nodes that have ended."""
        ended = {n: p.poll() for n, p in self._nodes.items() if p.poll() is not None}
        return [f"{name} has ended with status {status}" for name, status in ended.items()]

    def tracebacks(self) -> List[str]:
        """Return the nodes that have printed one, with its last line."""
        found = []
        for name in NODES:
            text = (self._folder / f"{name}.log").read_text(errors="replace")
            for part in text.split("Traceback")[1:]:
                found.append(f"{name}: {' '.join(part.split())[-300:]}")
        return found

    def visit(self) -> None:
        """Have a node come, as many as there are calls."""
        name = f"visitor{len(self._visitor)}"
        self._visitor.append(self._start(VISITOR, "_image:=mycamera/image_raw", f"__name:={name}"))

    def end_visit(self, how: signal.Signals) -> bool:
        """Send one that has come a signal; return whether there was one."""
        if not self._visitor:
            return False
        visitor = self._visitor.pop()
        visitor.send_signal(how)
        with contextlib.suppress(subprocess.TimeoutExpired):
            visitor.wait(_STOP_SECONDS)
        visitor.kill()
        visitor.wait()
        return True

    def end(self) -> None:
        """End all nodes."""
        nodes = [*self._visitor, *self._nodes.values()]
        for process in nodes:
            process.terminate()
        for process in nodes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_STOP_SECONDS)
            process.kill()
            process.wait()


def memory_of(process: psutil.Process) -> float:
    """Return what a process has in memory that no file holds, in MB.

    Pages of files are in its `uss` for as long as nobody else has them too: 60 MB of a process that
    draws are the driver's libraries, which go and come with whatever else draws on the machine.
    """
    with contextlib.suppress(psutil.ZombieProcess):
        return sum(part.anonymous for part in process.memory_maps()) / _MEGABYTE
    # It has ended since somebody looked, as `Lab.dead` will tell.
    return 0.0
