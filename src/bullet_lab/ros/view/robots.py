"""Robots as their descriptions on the parameter server say, where TF says that their links are."""

from __future__ import annotations

import logging
import xmlrpc.client
from dataclasses import dataclass
from typing import Any, Dict, FrozenSet, List, Optional, Set, Tuple

import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.ros.node.node import TF_PREFIX, NodeError, search_parameter
from bullet_lab.ros.view.displays import Stage
from bullet_lab.simulation.world.description import Model, Visual
from bullet_lab.simulation.world.urdf import read_urdf
from bullet_lab.simulation.world.xml import ReportOnce
from bullet_lab.srv import DescribeModels
from bullet_lab.view.looks import glb_of
from bullet_lab.view.scene import Copies, glb_copies

LOG = logging.getLogger(__name__)
DESCRIPTION = "robot_description"
MODELS = "/bullet_lab/describe_models"


@dataclass(frozen=True)
class Description:
    """A robot's description, and what stands before its frames on TF.

    Attributes:
        namespace: that the parameter is in, without slashes.
        prefix: with its slash, or empty.
        model: what the text says.
    """

    namespace: str
    prefix: str
    model: Model

    def bodies(self) -> List[Tuple[str, Tuple[Visual, ...]]]:
        """Return the frame of each link that is seen, and what is seen of it."""
        return [
            (self.prefix + link.name, link.visuals) for link in self.model.links if link.visuals
        ]

    def frames(self) -> List[str]:
        """Return the frames of all links."""
        return [self.prefix + link.name for link in self.model.links]


class Robots:
    """All robots that there is a description of, each with its links where TF has them.

    Links that look the same are copies of one another, whatever their number.
    """

    def __init__(self, stage: Stage):
        self._stage = stage
        self._texts: Dict[str, str] = {}
        self._robots: Dict[str, Description] = {}
        self._looks: Dict[Tuple[Visual, ...], Copies] = {}
        self._shown: FrozenSet[str] = frozenset()
        self._links: List[Tuple[str, Copies]] = []
        self._looks_taken = 0
        self._asked: Tuple[FrozenSet[str], FrozenSet[str]] = (frozenset(), frozenset())
        self._found: FrozenSet[str] = frozenset()
        self._report = ReportOnce()

    def follow(self) -> None:
        """Take up the descriptions that there are now."""
        names = _descriptions()
        if names is not None:
            self._take_up(names)
        shown = frozenset(n for n, robot in self._robots.items() if self._is_placed(robot))
        for name in self._shown - shown:
            self._drop(self._robots[name])
        self._shown = shown
        self._links = [
            (frame, self._look(visuals))
            for name in sorted(shown)
            for frame, visuals in self._robots[name].bodies()
        ]

    def tick(self) -> None:
        """Put all links where they are."""
        for frame, copies in self._links:
            copies.put(frame, self._stage.where(frame))
        for copies in self._looks.values():
            copies.flush()

    def clear(self) -> None:
        """Show no robots."""
        for name in list(self._texts):
            self._forget(name)
        self._links = []
        for copies in self._looks.values():
            copies.flush()

    def models(self, names: Set[str]) -> FrozenSet[str]:
        """Return those models of the world that are shown as robots.

        They have the name of the robot's namespace or description; elsewhere, and where there is
        one of them, the one with the robot's links is meant.
        """
        asked = (self._shown, frozenset(names))
        if asked != self._asked:
            found: Set[str] = set()
            for name in self._shown:
                robot = self._robots[name]
                alike = {robot.namespace, robot.model.name} & names
                if robot.namespace in names:
                    alike = {robot.namespace}
                found |= alike or _with_links(robot, names)
            self._asked, self._found = asked, frozenset(found)
        return self._found

    def place_of(self, namespace: str) -> Optional[Pose]:
        """Return where the robot of a namespace is; None where none is shown."""
        for name in self._shown:
            if self._robots[name].namespace == namespace:
                return self._stage.where(self._robots[name].frames()[0])
        return None

    def _take_up(self, names: FrozenSet[str]) -> None:
        for name in set(self._texts) - names:
            self._forget(name)
        # Of those that are known, one is read again at each look: it may be another text by now.
        known = sorted(self._texts)
        self._looks_taken += 1
        again = known[self._looks_taken % len(known) :][:1] if known else []
        for name in (*sorted(names - set(known)), *again):
            text = _text(name)
            if text and self._texts.get(name) != text:
                self._forget(name)
                self._texts[name] = text
                self._take(name, text)

    def _take(self, name: str, text: str) -> None:
        namespace = name.rpartition("/")[0].strip("/")
        try:
            model = read_urdf(text, name)
        except LabError as error:
            self._report(str(error))
            return
        self._robots[name] = Description(namespace, tf_prefix(namespace), model)

    def _forget(self, name: str) -> None:
        self._texts.pop(name, None)
        robot = self._robots.pop(name, None)
        self._shown -= {name}
        if robot is not None:
            self._drop(robot)

    def _drop(self, robot: Description) -> None:
        for frame, visuals in robot.bodies():
            if visuals in self._looks:
                self._looks[visuals].drop(frame)

    def _is_placed(self, robot: Description) -> bool:
        """Return whether TF connects a link of the robot with something else than the robot."""
        own = set(robot.frames())
        known = set(self._stage.frames.frames())
        return any(f in known and self._stage.frames.root(f) not in own for f in own)

    def _look(self, visuals: Tuple[Visual, ...]) -> Copies:
        if visuals not in self._looks:
            name, glb = f"/robots/{len(self._looks)}", glb_of(visuals, self._report)
            scene = self._stage.scene
            made = glb_copies(scene, name, glb) if glb else Copies(lambda _: None, ())
            self._looks[visuals] = made
        return self._looks[visuals]


def tf_prefix(namespace: str) -> str:
    """Return the tf_prefix that holds in a namespace, with its slash; empty without one."""
    try:
        prefix = search_parameter(TF_PREFIX, namespace).strip("/")
    except NodeError:
        return ""
    return f"{prefix}/" if prefix else ""


def _descriptions() -> Optional[FrozenSet[str]]:
    """Return the names of all descriptions; None while the master does not answer."""
    try:
        names = rospy.get_param_names()
    except (OSError, xmlrpc.client.Error, rospy.ROSException):
        return None
    return frozenset(name for name in names if name.rpartition("/")[2] == DESCRIPTION)


def _text(name: str) -> str:
    try:
        return str(rospy.get_param(name, ""))
    except (OSError, xmlrpc.client.Error, rospy.ROSException):
        return ""


def _with_links(robot: Description, names: Set[str]) -> Set[str]:
    links = {link.name for link in robot.model.links}
    try:
        models: Any = rospy.ServiceProxy(MODELS, DescribeModels)().models
    except (rospy.ServiceException, rospy.ROSException):
        return set()
    found = {model.name for model in models if set(model.links) == links} & names
    return found if len(found) == 1 else set()
