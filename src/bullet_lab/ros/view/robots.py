"""What TF places: robots with their links, and the axes and names of all frames.

Robots are described on the parameter server.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Mapping
from urllib.parse import quote

import rospy
from geometry_msgs.msg import Pose as PoseMessage
from tf2_msgs.msg import TFMessage

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.poses import normalised_pose
from bullet_lab.ros.node.node import MASTER_ERRORS, tf_prefix
from bullet_lab.ros.view.context import DisplayContext, Subscription, reader_of
from bullet_lab.ros.view.scene import Copies, Nodes, VisualCopies
from bullet_lab.simulation.world.description import Visual
from bullet_lab.simulation.world.urdf import read_urdf
from bullet_lab.simulation.world.xml import ReportOnce, leaving_out
from bullet_lab.srv import DescribeModels

# Sizes in m of the axes of a frame.
AXES = {"axes_length": 0.2, "axes_radius": 0.006}
DESCRIPTION = "robot_description"
MODELS = "/bullet_lab/describe_models"
# What a request to the parameter server raises if there is no answer.
ERRORS = (*MASTER_ERRORS, rospy.ROSException)


@dataclass(frozen=True)
class Description:
    """A robot's description, and what it defines.

    Attributes:
        text: of the parameter.
        namespace: of the parameter, without slashes.
        model: name of the robot.
        links: visuals of all links, by their frames on TF; none if the description is invalid.
    """

    text: str
    namespace: str
    model: str = ""
    links: Mapping[str, tuple[Visual, ...]] = field(default_factory=dict)


class Robots:
    """Shows all robots that have a description, with their links at their poses on TF.

    Links with the same visuals are copies in one node, whatever their number.
    """

    def __init__(self, context: DisplayContext):
        self._context = context
        # By the names of their parameters: all, and those that TF places.
        self._known: dict[str, Description] = {}
        self._shown: dict[str, Description] = {}
        self._report = ReportOnce()
        self._copies = VisualCopies(context.scene, "/robots", self._report)
        self._links: list[tuple[str, Copies]] = []
        self._updates = 0
        self._asked: tuple[list[Description], set[str]] = ([], set())
        self._found: frozenset[str] = frozenset()

    def follow(self) -> None:
        """Show the robots of the present descriptions."""
        names = _descriptions()
        if names is not None:
            self._update(names)
        self._show({name: one for name, one in self._known.items() if self._is_placed(one)})

    def tick(self) -> None:
        """Move all links to their poses."""
        for frame, copies in self._links:
            copies.put(frame, self._context.pose_of(frame))
        self._copies.flush()

    def clear(self) -> None:
        """Show no robots."""
        self._known.clear()
        self._show({})
        self._copies.flush()

    def models(self, names: set[str]) -> frozenset[str]:
        """Return the names of the world's models that are shown as robots.

        A robot's model has the name of its namespace or description. If no model has, it is the
        model with the same links, if there is exactly one.
        """
        robots = list(self._shown.values())
        if (robots, names) != self._asked:
            found: set[str] = set()
            for robot in robots:
                by_name = [n for n in (robot.namespace, robot.model) if n in names]
                found |= set(by_name[:1]) or _with_links(robot, names)
            self._asked, self._found = (robots, names), frozenset(found)
        return self._found

    def place_of(self, namespace: str) -> Pose | None:
        """Return the pose of the robot of a namespace; None if none is shown."""
        found = (one for one in self._shown.values() if one.namespace == namespace)
        robot = next(found, None)
        return None if robot is None else self._context.pose_of(next(iter(robot.links)))

    def _update(self, names: frozenset[str]) -> None:
        for name in self._known.keys() - names:
            del self._known[name]
        # One of the known descriptions is read again at each update, as it may have changed.
        known = sorted(self._known)
        self._updates += 1
        again = known[self._updates % len(known) :][:1] if known else []
        for name in (*sorted(names - set(known)), *again):
            text = _text(name)
            if text and (name not in self._known or self._known[name].text != text):
                self._known[name] = self._read(name, text)

    def _read(self, name: str, text: str) -> Description:
        namespace = name.rpartition("/")[0].strip("/")
        with leaving_out(self._report):
            model, prefix = read_urdf(text, name), tf_prefix(namespace)
            links = {prefix + link.name: link.visuals for link in model.links}
            return Description(text, namespace, model.name, links)
        return Description(text, namespace)

    def _show(self, robots: dict[str, Description]) -> None:
        self._shown = robots
        # The next tick places all copies again.
        self._copies.clear()
        links = [link for name in sorted(robots) for link in robots[name].links.items()]
        self._links = [(frame, self._copies.group(visuals)) for frame, visuals in links if visuals]

    def _is_placed(self, robot: Description) -> bool:
        """Return whether TF connects a link of the robot with a frame outside the robot."""
        tree = self._context.frames
        frames = robot.links.keys() & set(tree.frames())
        return any(tree.root(frame) not in robot.links for frame in frames)


def _descriptions() -> frozenset[str] | None:
    """Return the names of all descriptions; None if the master does not answer."""
    try:
        names = rospy.get_param_names()
    except ERRORS:
        return None
    return frozenset(name for name in names if name.rpartition("/")[2] == DESCRIPTION)


def _text(name: str) -> str:
    try:
        return str(rospy.get_param(name, ""))
    except ERRORS:
        return ""


def _with_links(robot: Description, names: set[str]) -> set[str]:
    try:
        models = rospy.ServiceProxy(MODELS, DescribeModels)().models
    except (rospy.ServiceException, rospy.ROSException):
        return set()
    # Frames have a prefix.
    links = {frame.rpartition("/")[2] for frame in robot.links}
    found = {model.name for model in models if set(model.links) == links} & names
    return found if len(found) == 1 else set()


def read_transforms(message: TFMessage) -> list[tuple[str, str, Pose]]:
    """Return frame, parent, and pose of each transform; raises InputError if one is not finite."""
    found = []
    for one in message.transforms:
        pose = normalised_pose(PoseMessage(one.transform.translation, one.transform.rotation))
        frame, parent = one.child_frame_id, one.header.frame_id
        found.append((frame.lstrip("/"), parent.lstrip("/"), pose))
    return found


class FramesDisplay:
    """Reads TF into the context's tree, and shows the axes and names of all frames."""

    def __init__(self, context: DisplayContext):
        self._context = context
        read = reader_of(TFMessage, read_transforms)
        self._subscriptions = [Subscription(t, read, every=True) for t in ("/tf_static", "/tf")]
        self._axes = Copies(partial(context.scene.add_batched_axes, "/frames/axes", **AXES))
        self._names = Nodes(context.scene)

    def read(self) -> None:
        """Read the new transforms."""
        for subscription in self._subscriptions:
            for transforms in subscription.take():
                for frame, parent, pose in transforms:
                    self._context.frames.put(frame, parent, pose)

    def show(self, axes: bool, names: bool) -> None:
        """Show or hide the axes and the names of all frames."""
        if not axes:
            self._axes.clear()
        if not names:
            self._names.clear()
        for frame in self._context.frames.frames() if axes or names else ():
            pose = self._context.pose_of(frame)
            if axes:
                self._axes.put(frame, pose)
            if names:
                # Nodes below a node would move with it.
                name = f"/frames/names/{quote(frame, safe='')}"
                self._names.put_label(name, frame, pose.position)
        self._axes.flush()

    def close(self) -> None:
        """Unsubscribe, and show nothing."""
        for subscription in self._subscriptions:
            subscription.close()
        self.show(axes=False, names=False)
        self._context.frames.clear()
