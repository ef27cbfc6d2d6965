"""What a robot with a sensor of each kind, and one with a camera, tell in a small world.

Both stand; the one with the sensors turns, stops, and pushes a crate. The figures are those of the
last message on each topic, field by field, in each part.
"""

from __future__ import annotations

import math
import re
import time
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Tuple
from xml.etree import ElementTree

import cv2
import genpy
import numpy as np
import rosgraph
import roslib.message
import rospy
from beside_ros import RosStage
from beside_scenarios import PACKAGE, Figure, Played

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.gazebo_types import srv
from bullet_lab.simulation.world.description import FrameState

WORLD = PACKAGE / "worlds" / "sensors.world"
LONGEST = 36
"""So many numbers of an array are figures."""

ARRIVE_SECONDS = 0.5
"""Wall seconds in which the last messages arrive, while simulated time stands still."""

TOPICS = {
    "scan": "sensor_msgs/LaserScan",
    "sonar": "sensor_msgs/Range",
    "imu_old": "sensor_msgs/Imu",
    "truth": "nav_msgs/Odometry",
    "odom": "nav_msgs/Odometry",
    "bumper": "gazebo_msgs/ContactsState",
    "camera/rgb/image_raw": "sensor_msgs/Image",
    "camera/rgb/camera_info": "sensor_msgs/CameraInfo",
    "camera/depth/image_raw": "sensor_msgs/Image",
    "camera/depth/camera_info": "sensor_msgs/CameraInfo",
    "camera/depth/points": "sensor_msgs/PointCloud2",
}
CAMERA_TOPICS = {
    "mycamera/image_raw": "sensor_msgs/Image",
    "mycamera/camera_info": "sensor_msgs/CameraInfo",
    "odom": "nav_msgs/Odometry",
    "joint_states": "sensor_msgs/JointState",
}
MOVING = {
    "turn": ("robot/imu_old", "robot/truth", "robot/odom"),
    "push": ("robot/truth", "robot/bumper", "robot/sonar", "robot/camera/depth/points"),
}
"""Topics of which figures are kept while the robot moves; at rest, it is all of them."""

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


def quiet(robot: str) -> str:
    """Return the description of a robot, without noise."""
    text = (PACKAGE / "urdf" / f"{robot}.urdf").read_text(encoding="utf-8")
    return NOISE.sub(r"\g<1>0", text)


def sensor_robot() -> str:
    """Return the sensor robot, with an imu and a p3d besides."""
    text = quiet("sensor_robot").replace("<collision>bumper<", f"<collision>{LUMPED}<")
    text = text.replace("<frameName>world<", "<frameName>bumper_link<")
    return text.replace("</robot>", MORE)


def things() -> Iterator[Tuple[str, str]]:
    """Yield names and SDF texts of what stands in the world."""
    for model in ElementTree.parse(WORLD).getroot().iter("model"):
        text = ElementTree.tostring(model, encoding="unicode")
        yield model.get("name", ""), f'<sdf version="1.6">{text}</sdf>'


class Ear:
    """Keeps the messages on topics."""

    def __init__(self, topics: Mapping[str, str]):
        self.heard: Dict[str, List[Any]] = {name: [] for name in topics}
        self._subscribers = [
            rospy.Subscriber(name, roslib.message.get_message_class(kind), self.heard[name].append)
            for name, kind in topics.items()
        ]

    def begin(self) -> None:
        for messages in self.heard.values():
            messages.clear()

    def close(self) -> None:
        for subscriber in self._subscribers:
            subscriber.unregister()


# ---- From messages to figures ----


def fields(name: str, value: Any) -> Iterator[Tuple[str, Figure]]:
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
    elif isinstance(value, (list, tuple)):
        numbers = np.asarray(value, dtype=float)
        finite = numbers[np.isfinite(numbers)]
        if len(numbers) <= LONGEST:
            yield name, numbers.tolist()
        else:
            yield f"{name} finite", float(len(finite))
            for word in ("min", "mean", "max"):
                yield f"{name} {word}", float(getattr(finite, word)())


def gap(messages: List[Any]) -> float:
    """Return the median of the time between two messages by their stamps, in ms."""
    stamps = np.array([message.header.stamp.to_sec() for message in messages])
    return float(np.median(np.diff(stamps))) * 1000.0


class Listener:
    """Writes what was heard in a part into figures."""

    def __init__(self, stage: RosStage, robot: str, camera: str, crate: str):
        self.stage, self.names = stage, {robot: "robot", camera: "cam", crate: "crate"}
        topics = {f"/{robot}/{topic}": kind for topic, kind in TOPICS.items()}
        topics.update({f"/{camera}/{topic}": kind for topic, kind in CAMERA_TOPICS.items()})
        self.ear = Ear(topics)

    def take(self, part: str, seconds: float) -> Dict[str, Figure]:
        """Let time pass and return the figures of what was heard."""
        self.ear.begin()
        self.stage.run(seconds)
        time.sleep(ARRIVE_SECONDS)
        figures: Dict[str, Figure] = {}
        for topic, messages in self.ear.heard.items():
            _, name, rest = topic.split("/", 2)
            what = f"{self.names[name]}/{rest}"
            if what in MOVING.get(part, (what,)):
                figures.update(self._of(f"{part} {what}", list(messages)))
        return figures

    def _of(self, what: str, messages: List[Any]) -> Dict[str, Figure]:
        """Return the figures of the messages on a topic."""
        if not messages:
            return {f"{what} messages": 0.0}
        figures: Dict[str, Figure] = {f"{what} gap ms": gap(messages)}
        last = messages[-1]
        if what.endswith("bumper"):
            figures.update(self._bumper(what, messages))
            return figures
        figures.update(fields(what, last))
        if what.endswith("scan"):
            whole = [abs(1000.0 * r - round(1000.0 * r)) < 0.01 for r in last.ranges if r < 5.0]
            figures[f"{what} share of whole mm"] = float(np.mean(whole))
        if what.endswith("points"):
            figures[f"{what} finite"] = float(np.isfinite(_points(last)).all(axis=1).sum())
        if what.endswith("camera_info"):
            figures[f"{what} focal length px"] = last.K[0]
        return figures

    def _bumper(self, what: str, messages: List[Any]) -> Dict[str, Figure]:
        touching = [message for message in messages if message.states]
        figures: Dict[str, Figure] = {
            f"{what} share with contacts": len(touching) / len(messages),
            f"{what} header frame_id": messages[-1].header.frame_id,
        }
        if touching:
            pairs = [(s.collision1_name, s.collision2_name) for s in touching[-1].states]
            shapes = {self._short(name) for pair in pairs for name in pair}
            figures[f"{what} shapes"] = " ".join(sorted(shapes))
            figures[f"{what} states in the median"] = float(
                np.median([len(message.states) for message in touching])
            )
        return figures

    def _short(self, name: str) -> str:
        for own, word in self.names.items():
            name = name.replace(own, word)
        return name


def _points(message: Any) -> np.ndarray:
    """Return x, y, z of a cloud, (n, 3)."""
    data = np.frombuffer(message.data, np.uint8).reshape(-1, message.point_step)
    return data[:, :12].copy().view("<f4")


def picture(message: Any) -> np.ndarray:
    """Return an image of rgb8 as (height, width, 3) levels."""
    return np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)


# ---- The scenario ----


def sensors(stage: RosStage, folder: Path) -> Played:
    """Play all parts; write the pictures of the first part into a folder."""
    names = {name: stage.spawn(text, Pose()) for name, text in things()}
    robot, crate = stage.spawn(sensor_robot(), Pose()), names["crate"]
    camera = stage.spawn(quiet("camera_robot"), Pose((-1.0, -0.6, 0.0)))
    listener = Listener(stage, robot, camera, crate)
    played = Played()
    physics = stage.call("get_physics_properties", srv.GetPhysicsProperties)
    played.figures.update(fields("physics", physics))
    played.figures["services of /gazebo"] = services()
    for word, name in {"robot": robot, "cam": camera, "crate": crate}.items():
        played.figures.update(properties(stage, word, name))
    stage.run(0.9)
    played.figures.update(listener.take("rest", 4.0))
    images = {
        "cam": listener.ear.heard[f"/{camera}/mycamera/image_raw"][-1],
        "rgb": listener.ear.heard[f"/{robot}/camera/rgb/image_raw"][-1],
    }
    for name, message in images.items():
        played.figures.update(levels(name, picture(message)))
        cv2.imwrite(str(folder / f"{name}.png"), picture(message)[:, :, ::-1])
    stage.command(robot, 0.0, 0.0, 0.5)
    played.figures.update(listener.take("turn", 3.014))
    played.figures.update(_where("turn robot", stage.state(robot)))
    stage.command(robot, 0.0, 0.0, 0.0)
    stage.run(0.5)
    stage.put(robot, FrameState(Pose((1.4, -1.3, 0.0))))
    stage.command(robot, 0.2, 0.0, 0.0)
    played.figures.update(listener.take("push", 4.634))
    played.figures.update(_where("push robot", stage.state(robot)))
    played.figures.update(_where("push crate", stage.state(crate)))
    listener.ear.close()
    return played


LINKS = {"robot": ("base_footprint",), "cam": ("base_footprint", "left_wheel"), "crate": ("link",)}


def services() -> str:
    """Return the names of the services of /gazebo, without those that other packages bring."""
    offered = rosgraph.Master("/beside_gazebo").getSystemState()[2]
    own = sorted(name[8:] for name, _ in offered if name.startswith("/gazebo/"))
    return " ".join(name for name in own if not name.endswith(("loggers", "level", "parameters")))


def properties(stage: RosStage, word: str, name: str) -> Dict[str, Figure]:
    """Return what the simulator tells of a model and its links."""
    model = stage.call("get_model_properties", srv.GetModelProperties, name)
    figures: Dict[str, Figure] = {
        f"{word} {key}": " ".join(getattr(model, key))
        for key in ("body_names", "geom_names", "joint_names")
    }
    for link in LINKS[word]:
        told = stage.call("get_link_properties", srv.GetLinkProperties, f"{name}::{link}")
        moments = [getattr(told, f"i{axes}") for axes in ("xx", "xy", "xz", "yy", "yz", "zz")]
        centre = told.com.position
        figures[f"{word}::{link} mass kg"] = told.mass
        figures[f"{word}::{link} centre m"] = [centre.x, centre.y, centre.z]
        figures[f"{word}::{link} moments kg m2"] = moments
    return figures


def _where(what: str, state: FrameState) -> Dict[str, Figure]:
    x, y, _ = state.pose.position
    return {f"{what} x m": x, f"{what} y m": y, f"{what} turned deg": math.degrees(state.pose.yaw)}


# What is seen where in the pictures: column and row of the middle of a patch of 9 x 9 pixels.
PATCHES: Dict[str, Dict[str, Tuple[int, int]]] = {
    "cam": {
        "sky": (320, 100),
        "floor near": (320, 440),
        "floor far": (60, 260),
        "wall": (250, 260),
        "crate": (440, 295),
        "column": (8, 250),
        "robot's top": (30, 425),
        "robot's side": (50, 455),
    },
    "rgb": {"sky": (80, 15), "floor": (80, 100), "wall": (90, 50)},
}
HALF = 4


def levels(name: str, image: np.ndarray) -> Dict[str, Figure]:
    """Return the mean level of each colour in each patch of a picture."""
    figures: Dict[str, Figure] = {}
    for patch, (column, row) in PATCHES[name].items():
        part = image[row - HALF : row + HALF + 1, column - HALF : column + HALF + 1]
        for colour, level in zip(("red", "green", "blue"), part.mean(axis=(0, 1))):
            figures[f"{name} {patch} {colour}"] = float(level)
    return figures
