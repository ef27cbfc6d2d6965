"""What of a model acts in a running simulation, and what does not."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Iterator, Optional, Tuple

import numpy as np

from bullet_lab.core.pose import Vector
from bullet_lab.simulation.models import ModelInstance
from bullet_lab.simulation.plugins import Plugin
from bullet_lab.simulation.world.description import PluginTag

# m; a plane goes on for ever, and so has no corners to speak of.
FARTHEST_CORNER = 1e3


@dataclass(frozen=True)
class PluginSurvey:
    """What a `<plugin>` tag does: its topics, the rate (Hz) at which it sends, 0 for none.

    `acts` is false for one that was left out; `refused` are controllers that it could not load.
    """

    tag: PluginTag
    acts: bool
    rate: float = 0.0
    inputs: Tuple[str, ...] = ()
    outputs: Tuple[str, ...] = ()
    unread: Tuple[str, ...] = ()
    refused: Tuple[str, ...] = ()


def survey(instance: ModelInstance) -> Tuple[PluginSurvey, ...]:
    """Return what the plugins of a model do, in the order of their tags."""
    acting = {id(plugin.mount.plugin): plugin for plugin in instance.plugins}
    return tuple(_of(tag, acting.get(id(tag))) for tag in instance.model.plugins)


def _of(tag: PluginTag, plugin: Optional[Plugin]) -> PluginSurvey:
    if plugin is None:
        return PluginSurvey(tag, False)
    rate = 0.0 if plugin.schedule is None else 1.0 / plugin.schedule.period
    inputs = tuple(entry.topic for entry in plugin.inputs)
    outputs = tuple(dict.fromkeys(entry.topic for entry in plugin.outputs))
    unread, refused = plugin.mount.unread_tags(), tuple(plugin.refused.values())
    return PluginSurvey(tag, True, rate, inputs, outputs, unread, refused)


def bounds(instance: ModelInstance) -> Tuple[Vector, Vector]:
    """Return the lower and upper corner of the box around a model's shapes, in the world (m).

    A model without any is a point.
    """
    corners = np.array([*_corners(instance), instance.pose().position])
    near = corners[np.abs(corners).max(axis=1) < FARTHEST_CORNER]
    corners = near if len(near) else corners
    return tuple(corners.min(axis=0).tolist()), tuple(corners.max(axis=0).tolist())


def _corners(instance: ModelInstance) -> Iterator[Vector]:
    for link in instance.model.links:
        place = instance.frame(link.name).pose()
        for shape in (*link.visuals, *link.collisions):
            pose = place * shape.pose
            for corner in product(*shape.geometry.bounds().T.tolist()):
                yield (pose * type(pose)(corner)).position
