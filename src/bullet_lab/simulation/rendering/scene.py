"""What is to be seen of a simulation, kept where the models are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Callable, Dict, Iterator, List, Mapping, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.rendering.drawables import Drawable, Drawables, Patch
from bullet_lab.simulation.rendering.graphics import Graphics, Target
from bullet_lab.simulation.rendering.lights import MOVING, STILL, Casters, Lighting
from bullet_lab.simulation.rendering.shaders import PLAIN, SLANTED, TEXTURED
from bullet_lab.simulation.world.description import World

# What nodes have PLAIN, TEXTURED or SLANTED in, by which a camera chooses what to draw them with.
PAINT_TAG = "paint"


class _LinkNode:
    """What is to be seen of one link, below a node of its own.

    Args:
        core: Panda3D.
        root: of the scene.
        frame: of the link.
        drawable: what is to be seen.
    """

    def __init__(self, core: Any, root: Any, frame: AttachedFrame, drawable: Drawable):
        self._core = core
        self._frame = frame
        self._drawable = drawable
        self._pose = Pose()
        self.path = root.attach_new_node(core.PandaNode("link"))
        self._textured: List[Tuple[Any, Patch]] = []
        for node, patch in drawable.nodes:
            # The node itself may hang below other links, too, that are seen from elsewhere.
            path = self.path.attach_new_node(core.PandaNode("look"))
            path.attach_new_node(node)
            path.set_tag(PAINT_TAG, PLAIN if patch is None else TEXTURED)
            if patch is not None:
                self._textured.append((path, patch))
        self.boxes = drawable.boxes
        self.bounds = drawable.bounds

    def follow(self) -> bool:
        """Go where the link is; return whether it has moved."""
        pose = self._frame.pose()
        if pose == self._pose:
            return False
        self._pose = pose
        x, y, z, w = pose.quaternion
        core = self._core
        self.path.set_pos_quat(core.LPoint3(*pose.position), core.LQuaternion(w, x, y, z))
        turn, place = pose.rotation_matrix().T, np.asarray(pose.position)
        self.boxes = self._drawable.boxes @ turn + place
        self.bounds = self._drawable.bounds @ turn + place
        return True

    def face(self, eye: Vector) -> None:
        """Choose how textures are drawn for a place in the world, m, that they are seen from."""
        if self._textured:
            local = (self._pose.inverse() * Pose(eye)).position
            for path, patch in self._textured:
                path.set_tag(PAINT_TAG, SLANTED if patch.is_slanted(local) else TEXTURED)


class _ModelNodes:
    """What is to be seen of one model."""

    def __init__(self, instance: Any, links: List[_LinkNode]):
        self.instance = instance
        self.casts = STILL if instance.model.static else MOVING
        self.has_shadows = any(len(link.boxes) for link in links)
        self._links = links
        self._moves = -1

    def follow(self) -> bool:
        """Go where the model is; return whether it has moved."""
        if self.casts == STILL and self._moves == self.instance.moves:
            return False
        self._moves = self.instance.moves
        moved = [link.follow() for link in self._links]
        return any(moved)

    def face(self, eye: Vector) -> None:
        """Choose how textures are drawn for a place in the world, m, that they are seen from."""
        for link in self._links:
            link.face(eye)

    def boxes(self) -> List[np.ndarray]:
        """Return the boxes around what throws shadows, each (n, 8, 3)."""
        return [link.boxes for link in self._links]

    def bounds(self) -> List[np.ndarray]:
        """Return the corners of the boxes around the links, each (8, 3)."""
        return [link.bounds for link in self._links]

    def remove(self) -> None:
        """Take all of it out of the scene."""
        for link in self._links:
            link.path.remove_node()


@dataclass(frozen=True)
class View:
    """How a scene is drawn from somewhere.

    Attributes:
        shadow_maps: that must be drawn first: they count as drawn from now on.
        states: that surfaces are drawn with, by their PAINT_TAG.
    """

    shadow_maps: List[Target]
    states: Mapping[str, Any]


class Scene:
    """What is to be seen in a world.

    Attributes:
        root: Panda3D's node path that all of it hangs on.

    Args:
        world: for its lights.
        models: all model instances by name; read anew at each `update`.
        graphics: draws it.
    """

    def __init__(self, world: World, models: Mapping[str, Any], graphics: Graphics):
        self.root = graphics.core.NodePath("scene")
        self._graphics = graphics
        self._models = models
        self._lighting = Lighting(world, graphics, self.root)
        self._drawables = Drawables(graphics)
        self._shown: Dict[str, _ModelNodes] = {}
        self._versions = {STILL: 0, MOVING: 0}
        # Least and greatest corner of all that stands still, and of all that moves.
        self._bounds: Dict[str, np.ndarray] = {}

    def update(self) -> None:
        """Bring everything to where the models are."""
        for name, shown in list(self._shown.items()):
            if self._models.get(name) is not shown.instance:
                self._changed(self._shown.pop(name)).remove()
        for name, instance in self._models.items():
            if name not in self._shown:
                self._shown[name] = self._changed(self._nodes_of(instance))
        for shown in self._shown.values():
            if shown.follow():
                self._changed(shown)

    def view(self, eye: Vector, in_view: Callable[[np.ndarray], bool]) -> View:
        """Return how everything is drawn, as it was at the last update.

        Args:
            eye: where it is seen from, m in the world.
            in_view: whether any of several hulls of points (n, m, 3) in the world may be seen.
        """
        for shown in self._shown.values():
            shown.face(eye)
        kinds = [STILL, *([MOVING] if self._sees_moving_shadows(in_view) else [])]
        targets = self._lighting.update({kind: self._casters(kind) for kind in kinds})
        return View(targets, self._lighting.states(MOVING in kinds))

    def close(self) -> None:
        """Give everything back."""
        for shown in self._shown.values():
            shown.remove()
        self._shown.clear()
        self._lighting.remove()
        # A target that drew this scene last still knows its root.
        self.root.set_state(self._graphics.core.RenderState.make_empty())

    def _changed(self, shown: _ModelNodes) -> _ModelNodes:
        self._bounds.pop(shown.casts, None)
        if shown.has_shadows:
            self._versions[shown.casts] += 1
        return shown

    def _sees_moving_shadows(self, in_view: Callable[[np.ndarray], bool]) -> bool:
        if not self._lighting.casting:
            return False
        boxes = self._boxes(MOVING)
        if not len(boxes):
            return False
        for kind in (STILL, MOVING):
            if kind not in self._bounds:
                corners = [b for s in self._of(kind) for b in s.bounds()] or [np.zeros((1, 3))]
                self._bounds[kind] = np.stack(
                    (np.min(corners, axis=(0, 1)), np.max(corners, axis=(0, 1)))
                )
        low, high = np.stack(list(self._bounds.values()), axis=1)
        bounds = np.stack((low.min(axis=0), high.max(axis=0)))
        return any(map(in_view, self._lighting.shadows_of(boxes, bounds)))

    def _of(self, kind: str) -> Iterator[_ModelNodes]:
        return (shown for shown in self._shown.values() if shown.casts == kind)

    def _casters(self, kind: str) -> Casters:
        return Casters(lambda: self._boxes(kind), self._versions[kind])

    def _boxes(self, kind: str) -> np.ndarray:
        boxes = (box for shown in self._of(kind) for box in shown.boxes())
        return np.concatenate([np.zeros((0, 8, 3)), *boxes])

    def _nodes_of(self, instance: Any) -> _ModelNodes:
        casts = STILL if instance.model.static else MOVING
        links = []
        for body in instance.bodies.values():
            for link in body.links:
                if link.visuals:
                    where = f"model '{instance.name}': link '{link.name}'"
                    drawable = self._drawables.of(link, casts, where)
                    frame = AttachedFrame(body, link.name)
                    links.append(_LinkNode(self._graphics.core, self.root, frame, drawable))
        return _ModelNodes(instance, links)
