"""Robots: their links as described on the parameter server, at the poses that TF gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.ros.node.node import MASTER_ERRORS, tf_prefix
from bullet_lab.ros.view.frames import DisplayContext
from bullet_lab.ros.view.scene import Copies, VisualCopies
from bullet_lab.simulation.world.description import Model, Visual
from bullet_lab.simulation.world.urdf import read_urdf
from bullet_lab.simulation.world.xml import ReportOnce, leaving_out
from bullet_lab.srv import DescribeModels

DESCRIPTION = "robot_description"
MODELS = "/bullet_lab/describe_models"
# What a request to the parameter server raises if there is no answer.
ERRORS = (*MASTER_ERRORS, rospy.ROSException)


@dataclass(frozen=True)
class Description:
    """A robot's description, and the prefix of its frames on TF.

    Attributes:
        namespace: of the parameter, without slashes.
        prefix: with its slash, or empty.
        model: what the description defines.
    """

    namespace: str
    prefix: str
    model: Model

    def bodies(self) -> list[tuple[str, tuple[Visual, ...]]]:
        """Return frame and visuals of each link that has any."""
        return [
            (self.prefix + link.name, link.visuals) for link in self.model.links if link.visuals
        ]

    def frames(self) -> list[str]:
        """Return the frames of all links."""
        return [self.prefix + link.name for link in self.model.links]


class Robots:
    """Shows all robots that have a description, with their links at their poses on TF.

    Links with the same visuals are copies in one node, whatever their number.
    """

    def __init__(self, context: DisplayContext):
        self._context = context
        self._texts: dict[str, str] = {}
        self._robots: dict[str, Description] = {}
        self._report = ReportOnce()
        self._copies = VisualCopies(context.scene, "/robots", self._report)
        self._shown: frozenset[str] = frozenset()
        self._links: list[tuple[str, Copies]] = []
        self._updates = 0
        self._asked: tuple[frozenset[str], frozenset[str]] = (frozenset(), frozenset())
        self._found: frozenset[str] = frozenset()

    def follow(self) -> None:
        """Show the robots of the present descriptions."""
        names = _descriptions()
        if names is not None:
            self._update(names)
        shown = frozenset(n for n, robot in self._robots.items() if self._is_placed(robot))
        for name in self._shown - shown:
            self._drop(self._robots[name])
        self._shown = shown
        self._links = [
            (frame, self._copies.group(visuals))
            for name in sorted(shown)
            for frame, visuals in self._robots[name].bodies()
        ]

    def tick(self) -> None:
        """Move all links to their poses."""
        for frame, copies in self._links:
            copies.put(frame, self._context.pose_of(frame))
        self._copies.flush()

    def clear(self) -> None:
        """Show no robots."""
        for name in list(self._texts):
            self._forget(name)
        self._links = []
        self._copies.flush()

    def models(self, names: set[str]) -> frozenset[str]:
        """Return the names of the world's models that are shown as robots.

        A robot's model has the name of its namespace or description. If no model has, it is the
        model with the same links, if there is exactly one.
        """
        asked = (self._shown, frozenset(names))
        if asked != self._asked:
            found: set[str] = set()
            for name in self._shown:
                robot = self._robots[name]
                by_name = [n for n in (robot.namespace, robot.model.name) if n in names]
                found |= set(by_name[:1]) or _with_links(robot, names)
            self._asked, self._found = asked, frozenset(found)
        return self._found

    def place_of(self, namespace: str) -> Pose | None:
        """Return the pose of the robot of a namespace; None if none is shown."""
        for name in self._shown:
            if self._robots[name].namespace == namespace:
                return self._context.pose_of(self._robots[name].frames()[0])
        return None

    def _update(self, names: frozenset[str]) -> None:
        for name in set(self._texts) - names:
            self._forget(name)
        # One of the known descriptions is read again at each update, as it may have changed.
        known = sorted(self._texts)
        self._updates += 1
        again = known[self._updates % len(known) :][:1] if known else []
        for name in (*sorted(names - set(known)), *again):
            text = _text(name)
            if text and self._texts.get(name) != text:
                self._forget(name)
                self._texts[name] = text
                self._take(name, text)

    def _take(self, name: str, text: str) -> None:
        namespace = name.rpartition("/")[0].strip("/")
        with leaving_out(self._report):
            model = read_urdf(text, name)
            self._robots[name] = Description(namespace, tf_prefix(namespace), model)

    def _forget(self, name: str) -> None:
        self._texts.pop(name, None)
        robot = self._robots.pop(name, None)
        self._shown -= {name}
        if robot is not None:
            self._drop(robot)

    def _drop(self, robot: Description) -> None:
        for frame, _ in robot.bodies():
            self._copies.drop(frame)

    def _is_placed(self, robot: Description) -> bool:
        """Return whether TF connects a link of the robot with a frame outside the robot."""
        own = set(robot.frames())
        tree = self._context.frames
        known = set(tree.frames())
        return any(frame in known and tree.root(frame) not in own for frame in own)


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
    links = {link.name for link in robot.model.links}
    try:
        models: Any = rospy.ServiceProxy(MODELS, DescribeModels)().models
    except (rospy.ServiceException, rospy.ROSException):
        return set()
    found = {model.name for model in models if set(model.links) == links} & names
    return found if len(found) == 1 else set()
