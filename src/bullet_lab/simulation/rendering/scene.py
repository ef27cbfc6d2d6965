"""What is to be seen of a simulation, kept where the models are."""

from __future__ import annotations

import weakref
from collections import deque
from typing import Any, Callable, Deque, Dict, List, Mapping, Tuple

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.physics.attached_frame import AttachedFrame
from bullet_lab.simulation.rendering.drawables import Drawable, Drawables
from bullet_lab.simulation.rendering.graphics import Graphics, Target, panda3d, set_pose
from bullet_lab.simulation.rendering.lights import MOVING, STILL, Lighting
from bullet_lab.simulation.rendering.shaders import PLAIN, SLANTED, TEXTURED
from bullet_lab.simulation.world.description import Mesh, World
from bullet_lab.simulation.world.meshes import file_version

# A texture is drawn by the better and slower way where the cosine of its surface's normal with the
# direction of view is less: where a pixel's footprint is 1.3 times as long as wide. (Below that,
# sharper textures only let the smallest markers flicker.)
SLANT = 0.77
KEPT_DRAWABLES = 4


class _LinkNode:
    """What is to be seen of one link, below a node of its own."""

    def __init__(self, root: Any, frame: AttachedFrame, drawable: Drawable):
        self._frame, self._drawable, self._pose = frame, drawable, Pose()
        self.path = root.attach_new_node("link")
        # Corners of the boxes around what throws shadows, (n, 8, 3) in m in the world.
        self.boxes = drawable.boxes
        self._textured = []
        for node, patch in drawable.nodes:
            # The node itself may hang below other links, too, that are seen from elsewhere.
            path = self.path.attach_new_node("look")
            path.attach_new_node(node)
            if patch is not None:
                self._textured.append((path, *patch))

    def follow(self) -> bool:
        """Go where the link is; return whether it has moved."""
        pose = self._frame.pose()
        if pose == self._pose:
            return False
        self._pose = pose
        set_pose(self.path, pose)
        self.boxes = self._drawable.boxes @ pose.rotation_matrix().T + np.asarray(pose.position)
        return True

    def face(self, eye: Vector, programs: Mapping[str, Any]) -> None:
        """Choose how textures are drawn for a place in the world, m, that they are seen from."""
        for path, centre, normal in self._textured:
            way = centre - (self._pose.inverse() * Pose(eye)).position
            slanted = abs(way @ normal) < SLANT * np.linalg.norm(way)
            path.set_shader(programs[SLANTED if slanted else TEXTURED])


class Scene:
    """What is to be seen in a world, all below its `root`, a node path of Panda3D's."""

    def __init__(self, world: World, models: Mapping[str, Any], graphics: Graphics):
        self.root = panda3d().NodePath("scene")
        self._models = models
        self._graphics = graphics
        self._lighting = Lighting(world, graphics, self.root)
        # Links that look the same share one drawable for as long as any of them is there. The last
        # ones are kept, for models that go and come back: glibc, before 2.38, hardly uses again
        # what the driver gives back of a texture.
        self._maker = Drawables(world.ambient)
        self._drawables: Any = weakref.WeakValueDictionary()
        self._last: Deque[Drawable] = deque(maxlen=KEPT_DRAWABLES)
        # Each model with its links, by its name.
        self._shown: Dict[str, Tuple[Any, List[_LinkNode]]] = {}
        # How often what stands still, and what moves, has changed.
        self._versions = {STILL: 0, MOVING: 0}
        self._moves: Dict[str, int] = {}

    def update(self) -> None:
        """Bring everything to where the models are."""
        for name in [n for n, (i, _) in self._shown.items() if self._models.get(n) is not i]:
            self._remove(name)
        for name, instance in self._models.items():
            if name not in self._shown:
                self._shown[name] = (instance, self._nodes_of(instance))
            kind = _kind(instance)
            if kind == STILL and self._moves.get(name) == instance.moves:
                continue
            is_new, self._moves[name] = name not in self._moves, instance.moves
            moved = [link.follow() for link in self._shown[name][1]]
            self._versions[kind] += is_new or any(moved)

    def prepare(self, eye: Vector, in_view: Callable[[np.ndarray], bool]) -> List[Target]:
        """Choose how all is drawn for an eye, m; return shadow maps that must be drawn first.

        `in_view` says whether any of several hulls may be seen, see `Lighting.shadows_of`.
        """
        moving = self._boxes(MOVING)
        seen = len(moving) > 0 and any(map(in_view, self._lighting.shadows_of(moving)))
        programs = self._lighting.programs[seen]
        self.root.set_shader(programs[PLAIN])
        for _, links in self._shown.values():
            for link in links:
                link.face(eye, programs)
        kinds = (STILL, MOVING) if seen else (STILL,)
        return self._lighting.update({kind: self._versions[kind] for kind in kinds}, self._boxes)

    def relight(self, world: World) -> None:
        """Take the lights of a world from now on."""
        self._lighting.remove()
        self._lighting = Lighting(world, self._graphics, self.root)

    def close(self) -> None:
        """Give everything back."""
        for name in list(self._shown):
            self._remove(name)
        self._lighting.remove()
        # A target that drew this scene last still knows its root.
        self.root.set_state(panda3d().RenderState.make_empty())

    def _remove(self, name: str) -> None:
        instance, links = self._shown.pop(name)
        self._moves.pop(name, None)
        self._versions[_kind(instance)] += 1
        for link in links:
            link.path.remove_node()

    def _boxes(self, kind: str) -> np.ndarray:
        """Return the corners of the boxes around what throws shadows, (n, 8, 3)."""
        links = (link for i, links in self._shown.values() if _kind(i) == kind for link in links)
        return np.concatenate([np.zeros((0, 8, 3)), *(link.boxes for link in links)])

    def _nodes_of(self, instance: Any) -> List[_LinkNode]:
        nodes, kind = [], _kind(instance)
        for body in instance.bodies.values():
            for link in filter(lambda link: link.visuals, body.links):
                files = [v.geometry for v in link.visuals if isinstance(v.geometry, Mesh)]
                files += [v.material.texture for v in link.visuals if v.material.texture]
                key = (link.visuals, kind, tuple(map(file_version, files)))
                drawable = self._drawables.get(key)
                if drawable is None:
                    where = f"model '{instance.name}': link '{link.name}'"
                    drawable = self._drawables[key] = self._maker.of(link.visuals, kind, where)
                    self._last.append(drawable)
                nodes.append(_LinkNode(self.root, AttachedFrame(body, link.name), drawable))
        return nodes


def _kind(instance: Any) -> str:
    return STILL if instance.model.static else MOVING
