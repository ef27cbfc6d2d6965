"""Frames of a document that are given in each other, as in SDF 1.7.

A model's frames are its links, joints, `<frame>`s and nested models; a world's are its models and
`<frame>`s. What is in a nested model is named `model::name`.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Dict, Tuple

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.world.description import WORLD_LINK

LOG = logging.getLogger(__name__)

# The frame of the model or of the world that the others are in.
MODEL_FRAME = "__model__"
OUTERMOST = ("", MODEL_FRAME, WORLD_LINK)


@dataclass(frozen=True)
class _Frame:
    """A frame: `pose` in the frame `base`; it moves with the frame `carrier`."""

    pose: Pose
    base: str
    carrier: str


class Frames:
    """The frames of a model or world by name; `source` names it in messages."""

    def __init__(self, source: str):
        self._source = source
        self._frames: Dict[str, _Frame] = {}

    def add(self, name: str, pose: Pose, base: str = "", carrier: str = "") -> None:
        """Add a frame at a pose in another one, by default the outermost; which carries it.

        Raises nothing: what cannot be resolved is in the outermost frame, with a warning.
        """
        self._frames.setdefault(name, _Frame(pose, base or MODEL_FRAME, carrier))

    def __contains__(self, name: str) -> bool:
        return name in self._frames or name in OUTERMOST

    def pose(self, name: str) -> Pose:
        """Return the pose of a frame in the outermost one."""
        pose, seen = Pose(), {name}
        while name not in OUTERMOST:
            frame = self._frames.get(name)
            if frame is None or frame.base in seen - set(OUTERMOST):
                reason = "is not there" if frame is None else "is given in itself"
                LOG.warning("%s: frame '%s' %s; the model's counts", self._source, name, reason)
                return pose if frame is None else frame.pose * pose
            pose, name = frame.pose * pose, frame.base
            seen.add(name)
        return pose

    def carrier(self, name: str) -> str:
        """Return what a frame moves with that moves with nothing else; empty for an unknown one."""
        seen = set()
        while name in self._frames and self._frames[name].carrier and name not in seen:
            seen.add(name)
            name = self._frames[name].carrier
        return name if name in self else ""

    def place(self, name: str, carrier: str) -> Tuple[str, Pose]:
        """Return a carrier and the pose of a frame in it."""
        return carrier, self.pose(carrier).inverse() * self.pose(name)
