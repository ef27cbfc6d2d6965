"""A bridge for the rostests that talk with one, and what they ask of it."""

import importlib
import math
import xmlrpc.client

import rosgraph
import rospy
from bullet_lab.srv import Advance, SetRtf, Step
from gazebo_msgs.srv import DeleteModel, GetModelState, GetWorldProperties, SpawnModel
from geometry_msgs.msg import Point, Pose, Quaternion, Twist, Vector3
from lab_testing import PATIENCE, Node, NodeTest, offered, publisher, wait_for
from std_srvs.srv import Empty

ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
BRIDGE = "/pybullet_bridge"
MILLISECOND = 1_000_000
END_OF_TIME = rospy.Time(2**31 - 1)


def call(service, kind, *arguments):
    """Call a service once it is there."""
    rospy.wait_for_service(service, PATIENCE)
    return rospy.ServiceProxy(service, kind)(*arguments)


def milliseconds(stamp):
    """A time in ms."""
    return stamp.to_nsec() // MILLISECOND


def step(steps):
    """Advance by so many steps; return the time reached in ms."""
    answer = call("/bullet_lab/step", Step, steps)
    if not answer.success:
        raise AssertionError(answer.status_message)
    return milliseconds(answer.now)


def advance(until=None, sent=(), node="", epoch=1):
    """Let time go on to so many ms, for ever by default, for all that a node cares.

    Args:
        until: ms, or None.
        sent: numbers of messages that the node has sent to the bridge so far, by topic.
        node: a member of the lock step; this node if empty.
        epoch: as told by the bridge; 0 to join.
    """
    stamp = END_OF_TIME if until is None else rospy.Time(*divmod(until * MILLISECOND, 10**9))
    counts = dict(sent)
    receivers = len(counts) * [BRIDGE]
    words = (node or rospy.get_name(), epoch, stamp, list(counts), receivers, list(counts.values()))
    return call("/bullet_lab/advance", Advance, *words)


def world():
    """What get_world_properties says."""
    return call("/gazebo/get_world_properties", GetWorldProperties)


def names():
    """All models."""
    return world().model_names


def at(x, y, z, yaw=0.0):
    """A pose."""
    return Pose(Point(x, y, z), Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))


def state_of(name):
    """A model's state."""
    return call("/gazebo/get_model_state", GetModelState, name, "")


def place_of(name):
    """Where a model is."""
    position = state_of(name).pose.position
    return position.x, position.y, position.z


def spawn(name, xml, pose=None, namespace="", frame="", service="spawn_sdf_model"):
    """Spawn a model; return the answer."""
    # What messages start with is no rotation, as in Gazebo.
    pose = pose or Pose()
    return call(f"/gazebo/{service}", SpawnModel, name, xml, namespace, pose, frame)


def twist(vx=0.0, wz=0.0):
    """A command in m/s and rad/s."""
    return Twist(Vector3(vx, 0.0, 0.0), Vector3(0.0, 0.0, wz))


def hears():
    """Topics that the bridge sends to this node."""
    with xmlrpc.client.ServerProxy(rosgraph.Master("/test").lookupNode(BRIDGE)) as bridge:
        entries = bridge.getBusInfo("/test")[2]
    return [entry[4] for entry in entries if (entry[1], entry[2]) == (rospy.get_name(), "o")]


class Sender:
    """Publishes what the bridge subscribes to, and knows when it has arrived."""

    def __init__(self, topic="cmd_vel", kind=Twist):
        self._publisher = publisher(topic, kind)
        self._name, self._count = rospy.resolve_name(topic), 0
        # The bridge counts from here, and waits for nothing more.
        advance(0, self.sent(), epoch=0)
        advance()

    def sent(self, more=0):
        """How many messages were sent, and are going to be, as `advance` takes it."""
        return {self._name: self._count + more}

    def publish(self, *messages):
        """Publish messages."""
        for message in messages:
            self._publisher.publish(message)
        self._count += len(messages)

    def send(self, *messages):
        """Publish messages and wait until the bridge has them."""
        self.publish(*messages)
        advance(sent=self.sent())

    def close(self):
        """Publish no more."""
        self._publisher.unregister()


class BridgeCase(NodeTest):
    """All tests of a class have one bridge, which is emptied before each.

    Attributes:
        parameters: of the bridge; by default it is paused and at full speed.
        bridge: as a process.
        models: the names of those that it starts with.
    """

    parameters = {}
    bridge = None
    models = ()

    @classmethod
    def tearDownClass(cls):
        if cls.bridge is not None:
            cls.bridge.end()

    def setUp(self):
        # Not in setUpClass, of whose errors rosunit says nothing.
        if self.bridge is None:
            self.start(**self.parameters)
        else:
            self.empty()

    def start(self, **parameters):
        """Start the bridge; end the one before, if there was one."""
        cls = type(self)
        cls.tearDownClass()
        cls.bridge = Node("pybullet_bridge.py", **{"paused": True, "rtf": 0, **parameters})
        wait_for(self.is_ready, "the bridge's services")
        cls.models = world().model_names

    def is_ready(self):
        """Whether the bridge has all its services."""
        self.assertTrue(self.bridge.runs(), self.bridge.err)
        # The last thing that it offers.
        return offered("/bullet_lab/advance")

    def empty(self):
        """Pause at time 0 with the models of the start, at full speed, without listeners."""
        self.assertTrue(self.bridge.runs(), self.bridge.err)
        call("/gazebo/pause_physics", Empty)
        for name in world().model_names:
            if name not in self.models:
                call("/gazebo/delete_model", DeleteModel, name)
        call("/bullet_lab/set_rtf", SetRtf, 0.0)
        call("/gazebo/reset_simulation", Empty)
        # Or a subscriber of this test is taken for one that is gone.
        wait_for(lambda: not hears(), "the bridge to forget the subscribers of the test before")

    def sender(self, topic="cmd_vel", kind=Twist):
        """A Sender that is there for this test."""
        sender = Sender(topic, kind)
        self.addCleanup(sender.close)
        return sender

    def reconfigured(self, name):
        """A client of dynamic_reconfigure that is there for this test."""
        try:
            client = importlib.import_module("dynamic_reconfigure.client").Client
        except ImportError:
            self.skipTest("dynamic_reconfigure is not installed")
        made = client(name, timeout=PATIENCE)
        self.addCleanup(made.close)
        return made

    def assert_stands(self, expected):
        """Assert that time stands at so many ms; at full speed it would not stay there."""
        for _ in range(20):
            self.assertEqual(expected, round(1000 * world().sim_time))
