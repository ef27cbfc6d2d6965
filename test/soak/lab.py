"""The nodes of a soak, and what they take of the machine."""

import contextlib
import subprocess
import sys
from pathlib import Path

import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from lab_nodes import STOP_SECONDS, Lab, Node, commands, end_all  # noqa: E402

NODES = commands("""
pybullet_bridge _world:=package://bullet_lab/worlds/docking.world \
  _robot:=package://bullet_lab/urdf/camera_robot.urdf _rtf:=0 _camera_rate:=2 \
  _lock_step:='noisy_odom_node drive_squares aruco'
noisy_odom _std:=0.1 _lock_step:=true
drive_squares _mode:=closed_loop _sides:=1000000 _side:=1.5 _lock_step:=true
aruco _image:=mycamera/image_raw _publish_tf:=true _lock_step:=true
track_robot _watch:=true
dock
""")
VISITOR = "canny_edges"
"""A node that comes and goes."""

_MEGABYTE = 2.0**20


class Soaked(Lab):
    """The nodes of a soak, which end with this process."""

    def __init__(self, folder, seed):
        self._folder = folder
        of_bridge = (*NODES["pybullet_bridge"], f"_seed:={seed}", f"_save_folder:={folder}")
        super().__init__(folder, {**NODES, "pybullet_bridge": of_bridge})
        self._visitors = []

    def taken(self):
        """Return each node's memory, see `memory_of`, its descriptors and its threads."""
        found = {}
        for name, node in self.nodes.items():
            with node.usage.oneshot():
                used = (memory_of(node.usage), node.usage.num_fds(), node.usage.num_threads())
                found[name] = used
        return found

    def deaths(self):
        """Return what is to be said of nodes that have ended."""
        statuses = {name: self.nodes[name].process.returncode for name in self.dead()}
        return [f"{name} has ended with status {status}" for name, status in statuses.items()]

    def visit(self):
        """Have a node come, as many as there are calls."""
        words = ("_image:=mycamera/image_raw", f"__name:=visitor{len(self._visitors)}")
        self._visitors.append(Node(VISITOR, *words, log=self._folder / f"{VISITOR}.log"))

    def end_visit(self, how):
        """Send one that has come a signal; return whether there was one."""
        if not self._visitors:
            return False
        visitor = self._visitors.pop().process
        visitor.send_signal(how)
        with contextlib.suppress(subprocess.TimeoutExpired):
            visitor.wait(STOP_SECONDS)
        visitor.kill()
        visitor.wait()
        return True

    def end(self):
        """End all nodes."""
        end_all(*self._visitors, *self.nodes.values())


def memory_of(process):
    """Return what a process has in memory that no file holds, in MB.

    Pages of files are in its `uss` for as long as nobody else has them too: 60 MB of a process that
    draws are the driver's libraries, which go and come with whatever else draws on the machine.
    """
    with contextlib.suppress(psutil.ZombieProcess):
        return sum(part.anonymous for part in process.memory_maps()) / _MEGABYTE
    # It has ended since somebody looked, as `Soaked.dead` will tell.
    return 0.0
