"""What the rostests share: nodes as processes, masters of their own, topics as lists."""

import contextlib
import json
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest
import xmlrpc.client
from pathlib import Path
from typing import NamedTuple

import psutil
import rosgraph
import rospkg
import rospy
import rostest
import tf2_ros
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from nav_msgs.msg import Odometry

from bullet_lab.core.se2 import quaternion_from_yaw
from bullet_lab.ros.messages.poses import stamped_pose
from bullet_lab.ros.node.lock_step import publishers_know_this_node

# Wall seconds after which something is not going to happen any more.
PATIENCE = 180.0
# Likewise for a job.
JOB_PATIENCE = 600.0
# Nodes that are not named as their executables are.
NAMES = {"noisy_odom.py": "noisy_odom_node"}
# About z, as a quaternion.
QUARTER_TURN = quaternion_from_yaw(0.5 * math.pi)
# Of the jobs that are run.
RUNS = tempfile.TemporaryDirectory()
PACKAGE = Path(rospkg.RosPack().get_path("bullet_lab"))


def wait_for(condition, what, seconds=PATIENCE):
    """Wait until a condition holds; return what it returned. AssertionError if it never does.

    `what` is waited for: a text, or a function that says so at the end.
    """
    deadline = time.monotonic() + seconds
    while True:
        found = condition()
        if found:
            return found
        if time.monotonic() > deadline:
            missing = what() if callable(what) else what
            raise AssertionError(f"waited {seconds:g} s in vain for {missing}")
        time.sleep(0.01)


def advertised(topic):
    """Whether the master knows a publisher of a topic."""
    publishers, _, _ = rosgraph.Master("/test").getSystemState()
    return topic in dict(publishers)


def offered(service):
    """Whether the master knows a service."""
    _, _, services = rosgraph.Master("/test").getSystemState()
    return service in dict(services)


def forget_parameters(node, master):
    """Clear the private parameters that an earlier node of this name has left with a master."""
    with contextlib.suppress(OSError):
        xmlrpc.client.ServerProxy(master).deleteParam("/test", f"/{node}")


def processes_with(mark):
    """The processes that have a variable in their environment, as name=value."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        # Zombies have no environment.
        with contextlib.suppress(OSError, psutil.Error):
            if mark.encode() in (entry / "environ").read_bytes().split(b"\0"):
                found.append(psutil.Process(int(entry.name)))
    return found


def command_of(process):
    """The command line of a process, as far as there is one."""
    with contextlib.suppress(psutil.Error):
        return " ".join(process.cmdline())
    return ""


class Process:
    """A command that runs until it ends or is ended.

    Args:
        words: of the command.
        environment: variables in place of or beside this process's.
    """

    def __init__(self, *words, **environment):
        # Open as long as this object is there.
        self._files = [tempfile.TemporaryFile("w+") for _ in range(2)]  # noqa: SIM115
        out, err = self._files
        env = {**os.environ, **environment}
        self.process = subprocess.Popen(words, env=env, stdout=out, stderr=err)

    @property
    def out(self):
        """What it has printed so far."""
        return self._read(0)

    @property
    def err(self):
        """What it has written to standard error so far."""
        return self._read(1)

    @property
    def said(self):
        """What it has written so far, to both."""
        return self.out + self.err

    def runs(self):
        """Whether it is still there."""
        return self.process.poll() is None

    def signal(self, number=signal.SIGINT):
        """Send a signal, Ctrl-C by default."""
        self.process.send_signal(number)

    def wait(self, seconds=PATIENCE):
        """Wait for its end and return the exit status."""
        return self.process.wait(seconds)

    def end(self):
        """Have it end, whatever state it is in."""
        if self.runs():
            # Not at once with SIGKILL, or the master would still know its topics and services.
            self.signal()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.wait()
        self.process.kill()
        self.process.wait()

    def _read(self, index):
        # Another file description, so that the position of the process stays.
        with open(f"/proc/self/fd/{self._files[index].fileno()}") as file:
            return file.read()


class Node(Process):
    """A node of the package as a process.

    Args:
        script: name of its executable, such as "noisy_odom.py".
        name: the node's name; its own if empty.
        master: URI of the ROS master; that of this test if empty.
        remap: topics by their names in the node.
        parameters: private ones.
    """

    def __init__(self, script, name="", master="", remap=(), **parameters):
        master = master or rosgraph.get_master_uri()
        forget_parameters(name or NAMES.get(script, Path(script).stem), master)
        words = [f"_{key}:={value}" for key, value in parameters.items()]
        words += [f"{old}:={new}" for old, new in dict(remap).items()]
        if name:
            words.append(f"__name:={name}")
        path = str(PACKAGE / "scripts" / script)
        super().__init__(sys.executable, path, *words, ROS_MASTER_URI=master)


class Master:
    """A ROS master of its own on a free port of the loopback."""

    def __init__(self):
        # Whoever comes first gets a free port: one that another process has taken is left to it.
        for _ in range(5):
            with contextlib.closing(socket.socket()) as probe:
                probe.bind(("127.0.0.1", 0))
                self._port = probe.getsockname()[1]
            self.uri = f"http://127.0.0.1:{self._port}"
            if self.start():
                return
        raise AssertionError("no free port for a master")

    def start(self):
        """Start it, again after its end, in the same place; return whether that was free."""
        self.process = subprocess.Popen(
            ["rosmaster", "--core", "-p", str(self._port)],
            env=dict(os.environ, ROS_MASTER_URI=self.uri),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            wait_for(lambda: self._answers() or self.process.poll() is not None, "the master")
        except AssertionError:
            self.end()
            raise
        if not self._answers():
            self.end()
            return False
        return True

    def _answers(self):
        try:
            _, _, pid = xmlrpc.client.ServerProxy(self.uri).getPid("/test")
        except (OSError, xmlrpc.client.Error):
            return False
        return pid == self.process.pid

    def knows(self, node):
        """Whether a node has registered."""
        code, _, _ = xmlrpc.client.ServerProxy(self.uri).lookupNode("/test", node)
        return code == 1

    def offers(self, service):
        """The URI of a service; empty if there is none."""
        code, _, uri = xmlrpc.client.ServerProxy(self.uri).lookupService("/test", service)
        return uri if code == 1 else ""

    def set_parameter(self, name, value):
        """Set a parameter."""
        xmlrpc.client.ServerProxy(self.uri).setParam("/test", name, value)

    def end(self):
        """Kill it."""
        self.process.kill()
        self.process.wait()


class Topic:
    """A topic as a growing list of its messages, in the order of their arrival."""

    def __init__(self, name, kind, connected=True):
        self.messages = []
        self._subscriber = rospy.Subscriber(name, kind, self._receive, tcp_nodelay=True)
        self._name = name
        if connected:
            self.connect()

    def connect(self):
        """Wait for a publisher, and until what it publishes comes here."""
        wait_for(self.is_connected, f"somebody on {self._name}")
        topic = self._subscriber.resolved_name
        wait_for(lambda: publishers_know_this_node(topic), f"who publishes {topic} to take note")

    def is_connected(self):
        """Whether there is a publisher."""
        return self._subscriber.get_num_connections() > 0

    def stamps(self):
        """The stamps of the messages so far, in ms."""
        return [message.header.stamp.to_nsec() // 1_000_000 for message in self.messages]

    def position(self):
        """The place that the last message tells, one of odometry or of a pose with covariance."""
        return self.messages[-1].pose.pose.position

    def wait(self, number):
        """Wait until so many messages have come and return them all."""
        wait_for(
            lambda: len(self.messages) >= number,
            f"{number} messages on {self._name}, have {len(self.messages)}",
        )
        return list(self.messages)

    def close(self):
        """Listen no longer."""
        self._subscriber.unregister()

    def _receive(self, message):
        self.messages.append(message)


def publisher(name, kind, **options):
    """A publisher with a subscriber."""
    made = rospy.Publisher(name, kind, queue_size=100, tcp_nodelay=True, **options)
    wait_for(lambda: made.get_num_connections() > 0, f"somebody to listen to {name}")
    return made


class NodeTest(unittest.TestCase):
    """Nodes, topics, publishers and folders that end with a test."""

    def new_folder(self):
        """A temporary folder."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        return Path(folder.name).resolve()

    def node(self, script, name="", **parameters):
        """A node, see `Node`."""
        node = Node(script, name, **parameters)
        self.addCleanup(node.end)
        return node

    def topic(self, name, kind, connected=True):
        """A topic, see `Topic`."""
        topic = Topic(name, kind, connected)
        self.addCleanup(topic.close)
        return topic

    def publisher(self, name, kind, **options):
        """A publisher with a subscriber."""
        made = publisher(name, kind, **options)
        self.addCleanup(made.unregister)
        return made

    def broadcast(self, message):
        """Send a static transform to whoever listens, one at least, for the time of this test."""
        sender = tf2_ros.StaticTransformBroadcaster()
        self.addCleanup(sender.pub_tf.unregister)
        sender.sendTransform(message)
        wait_for(sender.pub_tf.get_num_connections, "somebody to listen to transforms")

    def assert_ends_well(self, *nodes):
        """Assert that nodes end with status 0 and no traceback."""
        for node in nodes:
            self.assertEqual(0, node.wait(), node.err)
            self.assertNotIn("Traceback", node.err)


def odometry(seconds, x=0.0, y=0.0, yaw=0.0, frame="odom", child="base_footprint"):
    """An odometry message."""
    message = Odometry()
    message.header.stamp = rospy.Time.from_sec(seconds)
    message.header.frame_id = frame
    message.child_frame_id = child
    message.pose.pose = stamped_pose(message.header.stamp, frame, (x, y, yaw)).pose
    return message


def transform(parent, child, position=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0, 1.0)):
    """A transform between two frames; `turn` is a quaternion."""
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.transform = Transform(Vector3(*position), Quaternion(*turn))
    return message


def run_tests(node=True):
    """Run all tests of the program that was started, which is a node of its name, or none."""
    name = Path(sys.argv[0]).stem
    if node:
        rospy.init_node(name)
    rostest.rosrun("bullet_lab", name, "__main__")


class JobRun(NamedTuple):
    """What a job has left: its output folder, in one of this run, and what it printed."""

    out: Path
    printed: str

    @property
    def summary(self):
        """What its summary.json says."""
        return json.loads((self.out / "summary.json").read_text())


def run_job(job, *words, status=0, out="out"):
    """Run a job on a master of its own, in a temporary folder of its own.

    Args:
        job: its name.
        words: arguments such as "seed:=1".
        status: that it is to end with.
        out: name of the output folder; empty for the default.
    """
    where = Path(tempfile.mkdtemp(dir=RUNS.name))
    words = (job, *words, f"out:={out}") if out else (job, *words)
    environment = {k: v for k, v in os.environ.items() if k not in ("ROS_MASTER_URI", "ROS_IP")}
    run = subprocess.run(
        [sys.executable, "-m", "bullet_lab.ros.launcher", *words],
        cwd=where,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=JOB_PATIENCE,
    )
    if run.returncode != status:
        raise AssertionError(f"{words} ended with status {run.returncode}:\n{run.stdout}")
    return JobRun(where / (out or f"results/{job}"), run.stdout)
