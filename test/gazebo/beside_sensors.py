"""What a robot with a sensor of each kind, and one with a camera, tell in a small world.

Both stand; the one with the sensors turns, stops, and pushes a crate. The figures are those of the
last message on each topic, field by field, in each part.
"""

import re
import time
from pathlib import Path
from xml.etree import ElementTree

import cv2
import genpy
import numpy as np
import roslib.message
import rospy
import yaml
from beside_scenarios import PACKAGE, Played

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import FrameState

WORLD = PACKAGE / "worlds" / "sensors.world"
LONGEST = 36
"""So many numbers of an array are figures."""

ARRIVE_SECONDS = 0.5
"""Wall seconds in which the last messages arrive, while simulated time stands still."""

CAMERA, RGB = "mycamera/image_raw", "camera/rgb/image_raw"
TABLE = yaml.safe_load(Path(__file__).with_name("sensors.yaml").read_text())

# Tags of noise, which are set to 0.
NOISE = re.compile(r"(<(stddev|gaussianNoise)>)[^<]*")
# What was recorded had the bumper's shape under the name that Gazebo gives it, and this frame.
LUMPED = "base_footprint_fixed_joint_lump__bumper_collision_1"
MORE = """
  <gazebo>
    <plugin name="truth" filename="libgazebo_ros_p3d.so">
      <bodyName>base_footprint</bodyName><topicName>truth</topicName><frameName>world</frameName>
      <updateRate>50</updateRate><gaussianNoise>0</gaussianNoise>
    </plugin>
    <plugin name="imu_old" filename="libgazebo_ros_imu.so">
      <bodyName>base_footprint</bodyName><topicName>imu_old</topicName>
      <updateRate>50</updateRate><gaussianNoise>0</gaussianNoise>
    </plugin>
  </gazebo>
</robot>"""


def quiet(robot):
    """Return the description of a robot, without noise."""
    text = (PACKAGE / "urdf" / f"{robot}.urdf").read_text(encoding="utf-8")
    return NOISE.sub(r"\g<1>0", text)


def sensor_robot():
    """Return the sensor robot, with an imu and a p3d besides."""
    text = quiet("sensor_robot").replace("<collision>bumper<", f"<collision>{LUMPED}<")
    text = text.replace("<frameName>world<", "<frameName>bumper_link<")
    return text.replace("</robot>", MORE)


def things():
    """Yield names and SDF texts of what stands in the world."""
    for model in ElementTree.parse(WORLD).getroot().iter("model"):
        text = ElementTree.tostring(model, encoding="unicode")
        yield model.get("name"), f'<sdf version="1.6">{text}</sdf>'


# ---- From messages to figures ----


def fields(name, value):
    """Yield the fields of a message: vectors and short arrays as lists, of long ones the range."""
    if isinstance(value, genpy.Message):
        parts = [getattr(value, field) for field in value.__slots__]
        if all(isinstance(part, float) for part in parts):
            yield name, parts
            return
        for field, part in zip(value.__slots__, parts):
            if field not in ("seq", "stamp"):
                yield from fields(f"{name} {field}", part)
    elif isinstance(value, bytes):
        yield f"{name} bytes", float(len(value))
    elif isinstance(value, str):
        yield name, value
    elif isinstance(value, (bool, int, float)):
        yield name, float(value)
    elif value and isinstance(value[0], (str, genpy.Message)):
        for number, entry in enumerate(value):
            yield from fields(f"{name}[{number}]", entry)
    elif len(value) <= LONGEST:
        yield name, list(map(float, value))
    else:
        numbers = np.asarray(value, dtype=float)
        finite = numbers[np.isfinite(numbers)]
        yield f"{name} finite", float(len(finite))
        for word in ("min", "mean", "max"):
            yield f"{name} {word}", float(getattr(finite, word)())


def figures_of(what, messages, short):
    """Return the figures of the messages on a topic; `short` makes names of shapes comparable."""
    if not messages:
        return {f"{what} messages": 0.0}
    last = messages[-1]
    # The median between two messages by their stamps.
    stamps = [message.header.stamp.to_sec() for message in messages]
    figures = {f"{what} gap ms": float(np.median(np.diff(stamps))) * 1000.0}
    if what.endswith("bumper"):
        touching = [message.states for message in messages if message.states]
        figures[f"{what} share with contacts"] = len(touching) / len(messages)
        figures[f"{what} header frame_id"] = last.header.frame_id
        if touching:
            pairs = [(s.collision1_name, s.collision2_name) for s in touching[-1]]
            shapes = {short(name) for pair in pairs for name in pair}
            figures[f"{what} shapes"] = " ".join(sorted(shapes))
            figures[f"{what} states in the median"] = float(np.median(list(map(len, touching))))
        return figures
    figures.update(fields(what, last))
    if what.endswith("scan"):
        whole = [abs(1000.0 * r - round(1000.0 * r)) < 0.01 for r in last.ranges if r < 5.0]
        figures[f"{what} share of whole mm"] = float(np.mean(whole))
    if what.endswith("points"):
        data = np.frombuffer(last.data, np.uint8).reshape(-1, last.point_step)
        points = data[:, :12].copy().view("<f4")
        figures[f"{what} finite"] = float(np.isfinite(points).all(axis=1).sum())
    if what.endswith("camera_info"):
        figures[f"{what} focal length px"] = last.K[0]
    return figures


class Listener:
    """Writes what was heard in a part into figures.

    Args:
        stage: where the robots are.
        names: words for the names of models.
        topics: types of topics by their full names.

    Attributes:
        heard: the messages of the part by topic.
    """

    def __init__(self, stage, names, topics):
        self._stage, self._names = stage, names
        self.heard = {name: [] for name in topics}
        self._subscribers = [
            rospy.Subscriber(name, roslib.message.get_message_class(kind), self.heard[name].append)
            for name, kind in topics.items()
        ]

    def take(self, part, seconds):
        """Let time pass and return the figures of what was heard."""
        for messages in self.heard.values():
            messages.clear()
        self._stage.run(seconds)
        time.sleep(ARRIVE_SECONDS)
        figures = {}
        for topic, messages in self.heard.items():
            what = self.short(topic[1:])
            if what in TABLE["moving"].get(part, (what,)):
                figures.update(figures_of(f"{part} {what}", list(messages), self.short))
        return figures

    def short(self, name):
        """Return a name with words for the names of models."""
        for own, word in self._names.items():
            name = name.replace(own, word)
        return name

    def close(self):
        for subscriber in self._subscribers:
            subscriber.unregister()


# ---- The scenario ----


def sensors(stage, folder):
    """Play all parts; write the pictures of the first part into a folder."""
    crate = {name: stage.spawn(text, Pose()) for name, text in things()}["crate"]
    robot = stage.spawn(sensor_robot(), Pose())
    camera = stage.spawn(quiet("camera_robot"), Pose((-1.0, -0.6, 0.0)))
    topics = {f"/{robot}/{topic}": kind for topic, kind in TABLE["topics"].items()}
    topics.update({f"/{camera}/{topic}": kind for topic, kind in TABLE["camera_topics"].items()})
    names = {robot: "robot", camera: "cam", crate: "crate"}
    listener = Listener(stage, names, topics)
    figures = dict(fields("physics", stage.must("get_physics_properties")))
    # Without those that other packages bring.
    own = sorted(name[8:] for name in stage.offered() if name.startswith("/gazebo/"))
    others = ("loggers", "level", "parameters")
    figures["services of /gazebo"] = " ".join(name for name in own if not name.endswith(others))
    for name, word in names.items():
        figures.update(properties(stage, word, name))
    stage.run(0.9)
    figures.update(listener.take("rest", 4.0))
    for name, topic in (("cam", f"/{camera}/{CAMERA}"), ("rgb", f"/{robot}/{RGB}")):
        message = listener.heard[topic][-1]
        size = message.height, message.width, 3
        image = np.frombuffer(message.data, np.uint8).reshape(size)
        figures.update(levels(name, image))
        cv2.imwrite(str(folder / f"{name}.png"), image[:, :, ::-1])
    stage.command(robot, 0.0, 0.0, 0.5)
    figures.update(listener.take("turn", 3.014))
    figures.update(_where("turn robot", stage.state(robot)))
    stage.command(robot, 0.0, 0.0, 0.0)
    stage.run(0.5)
    stage.put(robot, FrameState(Pose((1.4, -1.3, 0.0))))
    stage.command(robot, 0.2, 0.0, 0.0)
    figures.update(listener.take("push", 4.634))
    figures.update(_where("push robot", stage.state(robot)))
    figures.update(_where("push crate", stage.state(crate)))
    listener.close()
    return Played(figures)


LINKS = {"robot": ("base_footprint",), "cam": ("base_footprint", "left_wheel"), "crate": ("link",)}


def properties(stage, word, name):
    """Return what the simulator tells of a model and its links."""
    model = stage.must("get_model_properties", model_name=name)
    keys = ("body_names", "geom_names", "joint_names")
    figures = {f"{word} {key}": " ".join(getattr(model, key)) for key in keys}
    for link in LINKS[word]:
        told = stage.must("get_link_properties", link_name=f"{name}::{link}")
        moments = [getattr(told, f"i{axes}") for axes in ("xx", "xy", "xz", "yy", "yz", "zz")]
        centre = told.com.position
        figures[f"{word}::{link} mass kg"] = told.mass
        figures[f"{word}::{link} centre m"] = [centre.x, centre.y, centre.z]
        figures[f"{word}::{link} moments kg m2"] = moments
    return figures


def _where(what, state):
    x, y, _ = state.pose.position
    turned = np.degrees(state.pose.yaw)
    return {f"{what} x m": x, f"{what} y m": y, f"{what} turned deg": float(turned)}


HALF = 4


def levels(name, image):
    """Return the mean level of each colour in each patch of a picture."""
    figures = {}
    for patch, (column, row) in TABLE["patches"][name].items():
        part = image[row - HALF : row + HALF + 1, column - HALF : column + HALF + 1]
        for colour, level in zip(("red", "green", "blue"), part.mean(axis=(0, 1))):
            figures[f"{name} {patch} {colour}"] = float(level)
    return figures
