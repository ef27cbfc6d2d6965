"""What a world and the models in it are made of, as plain data.

URDF and SDF are read into these classes; the physics, the pictures, the RViz markers and the saved
world are made from them. Lengths are metres, masses kilograms, angles radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Dict, Mapping, Optional, Tuple, Union
from xml.etree.ElementTree import Element

import numpy as np

from bullet_lab.core.pose import Pose, Vector
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Plane, Sphere

Geometry = Union[Box, Cylinder, Sphere, Plane, Mesh]
Colour = Tuple[float, float, float, float]

WHITE: Colour = (1.0, 1.0, 1.0, 1.0)
# The link that joints to the world hang on; no document has one of its own with this name.
WORLD_LINK = "world"
# Between the names of a model and of what is in it.
SEPARATOR = "::"
# The limits of a joint that are read.
LIMITS = ("lower", "upper", "effort", "velocity")
BLACK: Colour = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Texture:
    """A picture that the colours of a surface are multiplied by.

    Where it lies on the surface is said as in OGRE: `scale` sizes it about its middle, `scroll`
    then shifts it by shares of its sides, and `rotation` (rad) turns it. Beyond its edges it
    repeats, or its rim goes on. Where it `blends`, it lets through what is behind it. A `sharp`
    one has square pixels from near by.
    """

    path: Path
    scale: Tuple[float, float] = (1.0, 1.0)
    scroll: Tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    repeats: bool = True
    blends: bool = False
    sharp: bool = False

    def coordinates(self, surface: np.ndarray) -> np.ndarray:
        """Return the places in the picture, (…, 2) from its lower left, for those of a surface."""
        if (self.scale, self.scroll, self.rotation) == ((1.0, 1.0), (0.0, 0.0), 0.0):
            return surface
        # OGRE counts downwards, from the upper left.
        offset = ((surface - 0.5) * (1.0, -1.0)) / self.scale + self.scroll
        cosine, sine = math.cos(self.rotation), math.sin(self.rotation)
        return 0.5 + (offset @ np.array(((cosine, sine), (-sine, cosine)))) * (1.0, -1.0)


@dataclass(frozen=True)
class Material:
    """How a surface looks, beside the colour that it shows in the light of lamps.

    Attributes:
        ambient: its colour in ambient light; None for the same.
        emissive: what it shows without any light.
        texture: on it, if there is one.
        lit: whether light counts; where not, the colour is seen as it is.
        covers: whether it covers what a mesh has of its own: colours, textures.
        name: in scripts of OGRE's; empty without one.
        scripts: where that is defined, as was said and as it was found.
    """

    ambient: Optional[Colour] = None
    emissive: Colour = BLACK
    texture: Optional[Texture] = None
    lit: bool = True
    covers: bool = False
    name: str = ""
    scripts: Tuple[Tuple[str, Path], ...] = ()


@dataclass(frozen=True)
class Visual:
    """A shape to be seen; `pose` is in the link's frame, `colour` RGBA within [0, 1]."""

    geometry: Geometry
    pose: Pose = Pose()
    colour: Colour = WHITE
    name: str = ""
    casts_shadows: bool = True
    material: Material = Material()


@dataclass(frozen=True)
class Collision:
    """A shape that touches others; `friction` is Coulomb's coefficient.

    With a `direction`, a unit vector in the shape's own axes, it is the coefficient along it, and
    `cross_friction` that across it. `stiffness` (N/m) and `damping` (N s/m) make its contacts
    springs; None for hard ones.
    """

    geometry: Geometry
    pose: Pose = Pose()
    friction: float = 1.0
    name: str = ""
    stiffness: Optional[float] = None
    damping: Optional[float] = None
    cross_friction: Optional[float] = None
    direction: Optional[Vector] = None


@dataclass(frozen=True)
class Inertia:
    """Mass, centre of mass in the link's frame, and the 3x3 inertia about it (kg m²).

    The axes of `matrix` are those of the link's frame.
    """

    mass: float
    centre: Vector
    matrix: np.ndarray

    def elements(self) -> Dict[str, float]:
        """Return the elements of the matrix by their names, ixx to izz."""
        rows, columns = np.triu_indices(3)
        values = self.matrix[rows, columns].tolist()
        return {f"i{'xyz'[r]}{'xyz'[c]}": value for r, c, value in zip(rows, columns, values)}


@dataclass(frozen=True)
class Link:
    """A rigid part; `pose` is in the model's frame with all joints at zero.

    `self_collide` says whether it touches other links of its model; neighbours in the tree of
    joints never touch. One that is `anchored` is fixed to the world. `gravity` tells whether
    gravity pulls it.
    """

    name: str
    pose: Pose = Pose()
    inertia: Optional[Inertia] = None
    visuals: Tuple[Visual, ...] = ()
    collisions: Tuple[Collision, ...] = ()
    self_collide: bool = False
    anchored: bool = False
    gravity: bool = True


@dataclass(frozen=True)
class Joint:
    """A joint; `pose` of the child's frame in the parent's, `axis` in the child's frame.

    The axis goes through the place `anchor` (m) in the child's frame.
    """

    name: str
    kind: str
    parent: str
    child: str
    pose: Pose = Pose()
    axis: Vector = (1.0, 0.0, 0.0)
    limits: Mapping[str, float] = field(default_factory=dict)
    damping: float = 0.0
    friction: float = 0.0
    anchor: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PluginTag:
    """A `<plugin>` tag; `link` names the link that it refers to, if any.

    `tags` holds the text of each child by tag name; `sensor` is the `<sensor>` element around
    the plugin, if there is one. `element` is the tag itself, as it was read. `scope` stands before
    the names of links and joints that its tags say: that of the nested model it is in, with `::`.
    """

    filename: str
    name: str
    tags: Mapping[str, str]
    link: str = ""
    sensor: Optional[Element] = None
    element: Optional[Element] = field(default=None, compare=False, repr=False)
    scope: str = ""


@dataclass(frozen=True)
class Model:
    """A robot or a thing; the pose is that of the model's frame in the world.

    `frames` gives, for each frame that was merged into another link, that link's name and the
    pose of the frame in it.
    """

    name: str
    links: Tuple[Link, ...]
    joints: Tuple[Joint, ...] = ()
    plugins: Tuple[PluginTag, ...] = ()
    pose: Pose = Pose()
    static: bool = False
    frames: Mapping[str, Tuple[str, Pose]] = field(default_factory=dict)

    def root_links(self) -> Tuple[Link, ...]:
        """Return the links that are no joint's child."""
        children = {joint.child for joint in self.joints}
        return tuple(link for link in self.links if link.name not in children)

    def canonical_link(self) -> Link:
        """Return the link whose motion is the model's: its first root, or what hangs there."""
        root = self.root_links()[0]
        # The world's own link is the last of all.
        if root.name != WORLD_LINK:
            return root
        hanging = {joint.child for joint in self.joints if joint.parent == WORLD_LINK}
        return next(link for link in self.links if link.name in hanging)

    def own_links(self) -> Tuple[Link, ...]:
        """Return the links less the world's own, which carries those that move on it."""
        return tuple(link for link in self.links if link.name != WORLD_LINK)

    def links_by_name(self) -> Dict[str, Link]:
        """Return the links by their names."""
        return {link.name: link for link in self.links}


@dataclass(frozen=True)
class Attenuation:
    """How a light fades: to 1 / (constant + linear d + quadratic d²), and to nothing at `range`."""

    range: float = 10.0
    constant: float = 1.0
    linear: float = 0.0
    quadratic: float = 0.0

    def at(self, distances: np.ndarray) -> np.ndarray:
        """Return what is left at distances in metres, 1 at most."""
        fading = self.constant + distances * (self.linear + distances * self.quadratic)
        return np.where(distances > self.range, 0.0, 1.0 / np.maximum(1.0, fading))


@dataclass(frozen=True)
class Cone:
    """What a spot lights: all within the inner angle (rad, whole opening), none beyond the outer.

    In between it fades with the power `falloff` of the share of the way, as in OGRE.
    """

    inner: float = 0.0
    outer: float = math.pi
    falloff: float = 1.0

    def at(self, cosines: np.ndarray) -> np.ndarray:
        """Return what is left in directions given by their cosine with the spot's axis."""
        inside, outside = math.cos(0.5 * self.inner), math.cos(0.5 * self.outer)
        share = (cosines - outside) / max(1e-9, inside - outside)
        return np.clip(share, 0.0, 1.0) ** self.falloff


@dataclass(frozen=True)
class Light:
    """A light: `kind` is point, directional or spot; `direction` in the frame of `pose`.

    `attenuation` counts for point and spot, `cone` for spot.
    """

    name: str
    kind: str
    pose: Pose
    diffuse: Colour = WHITE
    direction: Vector = (0.0, 0.0, -1.0)
    casts_shadows: bool = False
    attenuation: Attenuation = Attenuation()
    cone: Cone = Cone()


@dataclass(frozen=True)
class FrameState:
    """Pose of a frame, velocity of its origin in m/s, angular velocity in rad/s."""

    pose: Pose
    linear: Vector = (0.0, 0.0, 0.0)
    angular: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ModelState:
    """Where a model and its links are in the world.

    `joints` holds position (rad or m) and velocity of the movable joints.
    """

    pose: Pose
    links: Mapping[str, FrameState] = field(default_factory=dict)
    joints: Mapping[str, Tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class World:
    """All that a world file holds; gravity in m/s², ambient light and background as RGBA.

    `states` says of models by name where their parts are, where this is not as they are built.
    """

    name: str
    models: Tuple[Model, ...] = ()
    lights: Tuple[Light, ...] = ()
    gravity: Vector = (0.0, 0.0, -9.8)
    ambient: Colour = (0.4, 0.4, 0.4, 1.0)
    background: Colour = (0.7, 0.7, 0.7, 1.0)
    shadows: bool = True
    states: Mapping[str, ModelState] = field(default_factory=dict)


@dataclass(frozen=True)
class Snapshot:
    """A world at a step: its models, and where all their parts are."""

    world: World
    step: int
    models: Tuple[Tuple[Model, ModelState], ...]
