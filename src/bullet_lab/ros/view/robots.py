"""Robots: their links as described on the parameter server, at the poses that TF gives."""

from __future__ import annotations

from dataclasses import dataclass

import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.ros.node.node import MASTER_ERRORS, tf_prefix
from bullet_lab.ros.view.frames import DisplayContext
from bullet_lab.ros.view.scene import Copies, VisualCopies
from bullet_lab.simulation.world.description import Visual
from bullet_lab.simulation.world.urdf import read_urdf
from bullet_lab.simulation.world.xml import ReportOnce, leaving_out
from bullet_lab.srv import DescribeModels

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
        frames: of all links on TF; none if the description is invalid.
        bodies: frame and visuals of each link that has any.
    """

    text: str
    namespace: str
    model: str = ""
    frames: tuple[str, ...] = ()
    bodies: tuple[tuple[str, tuple[Visual, ...]], ...] = ()


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
        return None if robot is None else self._context.pose_of(robot.frames[0])

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
            links = [(prefix + link.name, link.visuals) for link in model.links]
            frames = tuple(frame for frame, _ in links)
            bodies = tuple(link for link in links if link[1])
            return Description(text, namespace, model.name, frames, bodies)
        return Description(text, namespace)

    def _show(self, robots: dict[str, Description]) -> None:
        before, self._shown = self._links, robots
        bodies = [body for name in sorted(robots) for body in robots[name].bodies]
        self._links = [(frame, self._copies.group(visuals)) for frame, visuals in bodies]
        for link in before:
            if link not in self._links:
                frame, copies = link
                copies.drop(frame)

    def _is_placed(self, robot: Description) -> bool:
        """Return whether TF connects a link of the robot with a frame outside the robot."""
        tree = self._context.frames
        known = set(tree.frames())
        frames = [frame for frame in robot.frames if frame in known]
        return any(tree.root(frame) not in robot.frames for frame in frames)


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
    links = {frame.rpartition("/")[2] for frame in robot.frames}
    found = {model.name for model in models if set(model.links) == links} & names
    return found if len(found) == 1 else set()
