"""Sends random messages and calls to a running bridge and the nodes around it; see scripts/fuzz.sh.

Every topic that one of them hears gets messages, every service of theirs is called, settings are
changed by dynamic_reconfigure, and the view's page gets messages on both of its sockets. Afterwards
all nodes live, time goes on, nothing that is not finite has come out on the odometry, and what the
view drove stands.
"""

import contextlib
import math
import re
import sys
import tempfile
import threading
import time
from collections import Counter, deque
from pathlib import Path

import numpy as np
import roslib.message
import rospy
import rosservice
import yaml
from bullet_lab.srv import SetRtf
from controller_manager_msgs.srv import LoadController, SwitchController, SwitchControllerRequest
from dynamic_reconfigure.srv import Reconfigure
from gazebo_msgs.srv import SpawnModel
from geometry_msgs.msg import Point, Quaternion, Twist
from geometry_msgs.msg import Pose as PoseMsg
from messages import Messages
from mutations import generator, mutant
from nav_msgs.msg import Odometry
from page import PageFuzzer
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Empty
from tqdm import tqdm
from view_looker import wait_for_url
from ways import WAYS

from bullet_lab.core.files import write_json
from bullet_lab.ros.launcher.supervision import prepare_master
from bullet_lab.ros.view.node import KINDS
from bullet_lab.ros.view.panel import FASTEST, FASTEST_TURN

# `page` has added their folders to the path.
from contract_simulator import wait_until  # isort: skip
from lab_nodes import PACKAGE, Lab, commands, end_all, parser_of  # isort: skip

NODES = commands("""
pybullet_bridge _world:=package://bullet_lab/worlds/docking.world \
  _robot:=package://bullet_lab/urdf/camera_robot.urdf _rtf:=0
noisy_odom _std:=0.1
track_robot _watch:=true
aruco _image:=mycamera/image_raw
dock
drive_to_goal
view _port:=18300
""")
# A robot with controllers, as test/tutorials has it.
CART, CONTROLLERS = "cart", ("joint_state_controller", "drive", "mast")
# rospy's own, and what is there to end things.
LEFT_ALONE = ("get_loggers", "set_logger_level", "/gazebo/shutdown")
HEARD_BY_ALL = ("/clock", "/rosout")
OUTPUTS = ("/odom", "/noisy_odom", "/cart/drive/odom")
# Of types that the view shows, and nobody here publishes.
SHOWN = {f"/fuzz/{kind.rpartition('/')[2]}": kind for one in KINDS for kind in one.displays}
# Wall seconds for a call, and for time to go on afterwards.
CALL_SECONDS, RECOVERY_SECONDS = 30.0, 60.0
# MB that the bridge may grow by.
MOST_GROWTH = 600.0
TEXTS = 200
# Characters of what a node says at each end, messages and calls that are told.
SAID, LAST_SENT = 1500, 40
# Calls among messages, and messages to the page.
CALLS, TO_PAGE = 0.05, 0.1


class FuzzedLab(Lab):
    """The nodes that are fuzzed, and what they say.

    Attributes:
        sent: what was sent last, and in `not_finite_after` what before the first of those.
    """

    def __init__(self, folder):
        super().__init__(folder, NODES)
        self._bridge = self.nodes["pybullet_bridge"]
        self.not_finite = Counter()
        self.sent = deque(maxlen=LAST_SENT)
        self.not_finite_after = {}
        self._ticks = 0
        # The view's last command on each topic.
        self.driven = {}
        self.too_fast = Counter()
        spawn_cart()
        self.url = wait_for_url(self.nodes["view"].output)
        rospy.Subscriber("/clock", Clock, self._note_time, queue_size=1)
        for topic in OUTPUTS:
            rospy.Subscriber(topic, Odometry, self._check, topic, queue_size=50)
        time.sleep(5.0)
        self._memory = self._bridge.megabytes()

    def listen_to_view(self, topics):
        """Note what the view commands, on all topics that commands are heard on."""
        for topic, kind in topics.items():
            if kind == "geometry_msgs/Twist":
                rospy.Subscriber(topic, Twist, self._note_command, topic, queue_size=50)

    def _note_time(self, message):
        self._ticks += 1

    def _check(self, message, topic):
        # What is sent here comes back as well.
        if message._connection_header["callerid"] == rospy.get_name():
            return
        pose, twist = message.pose.pose, message.twist.twist
        numbers = [pose.position.x, pose.position.y, pose.orientation.z, twist.linear.x]
        if not all(map(math.isfinite, numbers)):
            if topic not in self.not_finite:
                came = f"{message._connection_header['callerid']}: {shown(message)}"
                self.not_finite_after[topic] = [*self.sent, came]
            self.not_finite[topic] += 1

    def _note_command(self, message, topic):
        if message._connection_header["callerid"] == "/view":
            speeds = message.linear.x / FASTEST, message.angular.z / FASTEST_TURN
            if not all(-1.0 <= speed <= 1.0 for speed in speeds):
                self.too_fast[topic] += 1
            self.driven[topic] = message

    def view_has_stopped(self):
        """Return whether all that the view has driven is told to stand, once no page is open."""
        return soon(lambda: all(message == Twist() for message in list(self.driven.values())))

    def grown(self):
        """Return by how many MB the bridge has grown."""
        return self._bridge.megabytes() - self._memory

    def resets(self):
        """Return how often the bridge has warned that a model's pose was no longer finite."""
        warning = re.compile(r"model '([^']*)': its pose is no longer finite")
        return Counter(warning.findall(self._bridge.output()))

    def last_words(self, name):
        """Return the status of a node that has ended, and what it printed at the end."""
        text = self.nodes[name].output()
        # Of the fault handler's pages, the thread that died is what counts.
        text = text[max(0, text.find("Current thread")) :]
        words = " ".join(text.split())
        kept = words if len(words) < 2 * SAID else f"{words[:SAID]} … {words[-SAID:]}"
        return f"{self.nodes[name].process.returncode}: {kept}"

    def time_goes_on(self):
        """Return whether there are ticks of the clock again, once physics is not paused."""
        before = self._ticks

        def ticks():
            with contextlib.suppress(rospy.ServiceException):
                rospy.ServiceProxy("/gazebo/unpause_physics", Empty)()
                rospy.ServiceProxy("/bullet_lab/set_rtf", SetRtf)(0.0)
            return self._ticks > before

        return soon(ticks)

    def end(self):
        """End the nodes; return the tracebacks that they have printed."""
        end_all(*self.nodes.values())
        # Libraries that answer calls themselves print theirs, too.
        return [text for text in self.tracebacks() if "bullet_lab/src" in text]


def soon(condition):
    """Return whether a condition holds before long."""
    return wait_until(condition, RECOVERY_SECONDS, 0.2)


def inputs():
    """Return the topics that the nodes hear, with their types, and the services that they offer."""
    mine = {f"/{name}" for name in NODES} | {"/noisy_odom_node"}
    _, subscribed, offered = rospy.get_master().getSystemState()[2]
    types = dict(rospy.get_master().getTopicTypes()[2])
    topics = {
        topic: types[topic]
        for topic, nodes in sorted(subscribed)
        if mine & set(nodes) and topic not in HEARD_BY_ALL and types.get(topic, "*") != "*"
    }
    services = [
        name for name, nodes in offered if mine & set(nodes) and not name.endswith(LEFT_ALONE)
    ]
    return topics, sorted(services)


def texts(seed):
    """Return mutants of descriptions, for the services that take them."""
    found = []
    for number in range(TEXTS):
        way = ("urdf", "sdf")[number % 2]
        data = mutant(WAYS[way].seeds(), generator(seed, way, number))
        found.append(data.decode("utf-8", "replace"))
    return found


def spawn_cart():
    """Spawn a robot with controllers, if it is not there, and have them run."""
    tutorials = PACKAGE / "test" / "tutorials"
    text = (tutorials / "urdf" / "cart.urdf").read_text()
    settings = yaml.safe_load((tutorials / "config" / f"{CART}.yaml").read_text())
    rospy.set_param(f"/{CART}/robot_description", text)
    rospy.set_param(f"/{CART}", {**rospy.get_param(f"/{CART}"), **settings})
    pose = PoseMsg(Point(-2.0, -2.0, 0.0), Quaternion(w=1.0))
    rospy.ServiceProxy("/gazebo/spawn_urdf_model", SpawnModel)(CART, text, "", pose, "")
    for name in CONTROLLERS:
        service(f"/{CART}/controller_manager/load_controller", LoadController)(name)
    switch = service(f"/{CART}/controller_manager/switch_controller", SwitchController)
    switch(CONTROLLERS, (), SwitchControllerRequest.STRICT, False, 0.0)


def service(name, kind):
    """Return a service once it is there."""
    rospy.wait_for_service(name, CALL_SECONDS)
    return rospy.ServiceProxy(name, kind)


class Caller:
    """Calls services, each in a thread of its own, and notes those that do not answer."""

    def __init__(self, services):
        self._proxies = {}
        # Those of dynamic_reconfigure answer an empty request with all that they offer.
        self._settings = {}
        for name in services:
            kind = rosservice.get_service_class_by_name(name)
            if kind is not None:
                self._proxies[name] = (rospy.ServiceProxy(name, kind), kind)
            if kind is Reconfigure:
                self._settings[name] = self._proxies[name][0]().config
        self.names = sorted(self._proxies)
        self.with_settings = sorted(self._settings)
        self.silent = Counter()

    def call(self, name, messages):
        """Call a service with something; return that in words."""
        proxy, kind = self._proxies[name]
        request = messages.fill(kind._request_class())
        if name in self._settings:
            request.config = messages.some_settings(self._settings[name])
        if name == "/bullet_lab/step":
            request.steps = min(request.steps, 500)
        if name == "/bullet_lab/advance":
            # Who says that it is a node that lives holds time as that node may.
            request.node = "somebody"
        thread = threading.Thread(target=self._call, args=(proxy, request), daemon=True)
        thread.start()
        thread.join(CALL_SECONDS)
        if thread.is_alive() and name != "/bullet_lab/advance":
            self.silent[name] += 1
        return shown(request)

    @staticmethod
    def _call(proxy, request):
        with contextlib.suppress(rospy.ServiceException, rospy.ROSException, ValueError):
            proxy(request)


def shown(message):
    """Return a message in some words."""
    return " ".join(str(message).split())[:500]


def publishers(topics):
    """Return publishers on all topics, whose types are known."""
    kinds = {topic: roslib.message.get_message_class(kind) for topic, kind in topics.items()}
    made = [(rospy.Publisher(t, kind, queue_size=100), kind) for t, kind in kinds.items() if kind]
    time.sleep(1.0)
    return made


def fuzz(wanted, folder):
    """Send so many messages; return what became of it."""
    random = np.random.default_rng([wanted.seed, 0xF])
    lab = FuzzedLab(folder)
    page = PageFuzzer(lab.url, random)
    # What is published at last is seen by the view, which is heard to listen then.
    time.sleep(3.0)
    topics, services = inputs()
    lab.listen_to_view(topics)
    caller = Caller(services)
    messages = Messages(random, texts(wanted.seed))
    failures = []
    sent, calls, to_page = Counter(), Counter(), 0
    outlets = publishers({**topics, **SHOWN})
    for number in tqdm(range(wanted.messages), unit=" messages", disable=None):
        messages.now = rospy.get_time()
        kind_of_input = random.random()
        if kind_of_input < TO_PAGE:
            lab.sent.append(page.send())
            to_page += 1
        elif kind_of_input < TO_PAGE + CALLS:
            names = caller.names if random.integers(3) else caller.with_settings
            name = names[random.integers(len(names))]
            lab.sent.append(f"{name}: {caller.call(name, messages)}")
            calls[name] += 1
        else:
            publisher, kind = outlets[random.integers(len(outlets))]
            with contextlib.suppress(rospy.ROSException, rospy.ROSSerializationException):
                message = messages.fill(kind())
                lab.sent.append(f"{publisher.name}: {shown(message)}")
                publisher.publish(message)
            sent[publisher.name] += 1
        if number % 200 == 199:
            if lab.dead():
                break
            with contextlib.suppress(rospy.ROSException, rospy.ServiceException):
                spawn_cart()
    for publisher, _ in outlets:
        publisher.unregister()
    failures += [f"{name} has ended with {lab.last_words(name)}" for name in lab.dead()]
    if not page.lives():
        failures.append(f"the page is no longer served: {lab.nodes['view'].output()[-600:]}")
    page.close()
    if not failures:
        if not lab.view_has_stopped():
            failures.append(f"the view drives on: {lab.driven}")
        if not lab.time_goes_on():
            failures.append(f"time does not go on: {lab.nodes['pybullet_bridge'].output()[-600:]}")
        if lab.grown() > MOST_GROWTH:
            failures.append(f"the bridge has grown by {lab.grown():.0f} MB")
    failures += [f"{name} became NaN: {n} warnings" for name, n in lab.resets().items()]
    failures += [f"{name} has not answered {n} times" for name, n in caller.silent.items()]
    failures += [f"{n} messages on {topic} are not finite" for topic, n in lab.not_finite.items()]
    failures += [f"{n} commands of the view on {t} are too fast" for t, n in lab.too_fast.items()]
    failures += lab.end()
    return {
        "seed": wanted.seed,
        "messages": sum(sent.values()),
        "calls": sum(calls.values()),
        "to_page": to_page,
        "by_topic": dict(sent),
        "by_service": dict(calls),
        "not_finite_after": lab.not_finite_after,
        "failures": failures,
    }


def main():
    """Fuzz, print and write live.json; status 1 where something failed."""
    out = Path("results/fuzz")
    parser = parser_of("fuzz.sh --live", __doc__, seed=1, messages=5000, out=out)
    wanted = parser.parse_args()
    wanted.out.mkdir(parents=True, exist_ok=True)
    prepare_master()
    rospy.init_node("fuzz", disable_signals=True)
    rospy.set_param("/use_sim_time", True)
    with tempfile.TemporaryDirectory(dir=wanted.out) as folder:
        summary = fuzz(wanted, Path(folder).absolute())
    write_json(wanted.out / "live.json", summary)
    for failure in summary["failures"]:
        print(failure)
    print(f"{summary['messages']} messages, {summary['calls']} calls, "
          f"{summary['to_page']} messages to the page, "
          f"{len(summary['failures'])} failures; see {wanted.out}")  # fmt: skip
    sys.exit(1 if summary["failures"] else 0)


if __name__ == "__main__":
    main()
