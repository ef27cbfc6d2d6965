"""Describe worlds and models as plain data.

URDF and SDF are read into these classes; physics, pictures, RViz markers and saved worlds are made
from them. Lengths are metres, masses kilograms, angles radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Mapping, Tuple, Union
from xml.etree.ElementTree import Element

import numpy as np
from numpy import ndarray

from bullet_lab.core.pose import Pose, Quaternion, Vector
from bullet_lab.core.se2 import PlanarPose, between, compose
from bullet_lab.simulation.world.shapes import Box, Cylinder, Mesh, Plane, Sphere

Geometry = Union[Box, Cylinder, Sphere, Plane, Mesh]
Colour = Tuple[float, float, float, float]
Point = Tuple[float, float]

WHITE: Colour = (1.0, 1.0, 1.0, 1.0)
# The parent link of joints to the world; no other link has this name.
WORLD_LINK = "world"
# Between the name of a nested model and the names of its parts.
SEPARATOR = "::"
# The limits of a joint that are read.
LIMITS = ("lower", "upper", "effort", "velocity")
# The limit (rad or m) by which SDF says that there is none.
NO_LIMIT = 1e16
BLACK: Colour = (0.0, 0.0, 0.0, 1.0)
# The corners of a footprint, as shares of its sides.
FOOTPRINT_CORNERS = ((0.5, 0.5, 0.0), (-0.5, 0.5, 0.0), (-0.5, -0.5, 0.0), (0.5, -0.5, 0.0))
# The footprint of a box that leans more than this (rad) is no rectangle.
UPRIGHT = 1e-3


@dataclass(frozen=True)
class Texture:
    """A picture by which the colours of a surface are multiplied.

    As in OGRE, `scale` sizes it about its middle, `scroll` then shifts it by shares of its sides,
    and `rotation` (rad) turns it. Beyond its edges it `repeats`, or its border continues. Where it
    `blends`, its alpha makes it transparent. A `sharp` one has square pixels from near by.
    """

    path: Path
    scale: tuple[float, float] = (1.0, 1.0)
    scroll: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    repeats: bool = True
    blends: bool = False
    sharp: bool = False

    def coordinates(self, surface: ndarray) -> ndarray:
        """Return points in the picture, (…, 2) from its lower left, for points of a surface."""
        usual = Texture.scale, Texture.scroll, Texture.rotation
        if (self.scale, self.scroll, self.rotation) == usual:
            return surface
        # In OGRE, the origin is the upper left.
        offset = ((surface - 0.5) * (1.0, -1.0)) / self.scale + self.scroll
        cosine, sine = math.cos(self.rotation), math.sin(self.rotation)
        return 0.5 + (offset @ np.array(((cosine, sine), (-sine, cosine)))) * (1.0, -1.0)


@dataclass(frozen=True)
class Material:
    """How a surface looks, apart from its diffuse colour.

    Attributes:
        ambient: its colour in ambient light; None for the diffuse one.
        emissive: the light that it emits.
        texture: its picture, or None.
        lit: whether light matters; otherwise its colour is shown as it is.
        covers: whether it replaces the colours and textures of a mesh file.
        name: in OGRE's scripts; empty without one.
        scripts: where it is defined: the URI in the document, and the path.
        shine: brightness of its wide highlights.
    """

    ambient: Colour | None = None
    emissive: Colour = BLACK
    texture: Texture | None = None
    lit: bool = True
    covers: bool = False
    name: str = ""
    scripts: tuple[tuple[str, Path], ...] = ()
    shine: float = 0.0


# The diffuse colour of a surface, and the rest of its look.
Appearance = Tuple[Colour, Material]


@dataclass(frozen=True)
class Visual:
    """A visible shape; `pose` is in the link's frame, `colour` RGBA within [0, 1]."""

    geometry: Geometry
    pose: Pose = Pose()
    colour: Colour = WHITE
    name: str = ""
    casts_shadows: bool = True
    material: Material = Material()


@dataclass(frozen=True)
class Collision:
    """A shape with contacts; `friction` is Coulomb's coefficient.

    With a `direction`, a unit vector in the shape's axes, it is the coefficient along that, and
    `cross_friction` the one across. `stiffness` (N/m) and `damping` (N s/m) make contacts soft;
    None for hard ones.
    """

    geometry: Geometry
    pose: Pose = Pose()
    friction: float = 1.0
    name: str = ""
    stiffness: float | None = None
    damping: float | None = None
    cross_friction: float | None = None
    direction: Vector | None = None


@dataclass(frozen=True)
class Inertia:
    """Mass, centre of mass in the link's frame, and the 3x3 inertia about it (kg m²).

    The axes of `matrix` are those of the link's frame; `axes` has those of the `<inertial>` in it.
    """

    mass: float
    centre: Vector
    matrix: ndarray
    axes: Quaternion = Pose.quaternion

    def elements(self, axes: Quaternion = Pose.quaternion) -> dict[str, float]:
        """Return the elements ixx to izz, in the link's axes or in others in its frame."""
        rows, columns = np.triu_indices(3)
        turn = Pose(quaternion=axes).rotation_matrix()
        values = (turn.T @ self.matrix @ turn)[rows, columns].tolist()
        return {f"i{'xyz'[r]}{'xyz'[c]}": value for r, c, value in zip(rows, columns, values)}


@dataclass(frozen=True)
class Link:
    """A rigid part; `pose` is in the model's frame with all joints at zero.

    With `self_collide`, it collides with other links of its model, but never with its neighbours in
    the tree of joints. An `anchored` link is fixed to the world. Without `gravity`, it floats.
    """

    name: str
    pose: Pose = Pose()
    inertia: Inertia | None = None
    visuals: tuple[Visual, ...] = ()
    collisions: tuple[Collision, ...] = ()
    self_collide: bool = False
    anchored: bool = False
    gravity: bool = True


@dataclass(frozen=True)
class Joint:
    """A joint; `pose` of the child's frame in the parent's, `axis` in the child's frame.

    The axis goes through the point `anchor` (m) in the child's frame.
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
    """A `<plugin>` tag; `link` is the name of its link, if any.

    `tags` holds the text of each child by tag name; `sensor` is the `<sensor>` element around
    the plugin, or None. `element` is the tag as it was read. `scope` is the name of the nested
    model that it is in, with `::`: it comes before names of links and joints in the tags.
    """

    filename: str
    name: str
    tags: Mapping[str, str]
    link: str = ""
    sensor: Element | None = None
    element: Element | None = field(default=None, compare=False, repr=False)
    scope: str = ""

    @property
    def is_bare_sensor(self) -> bool:
        """Whether it is a sensor without a plugin, which another plugin of its model may read."""
        return self.element is None and not self.filename


@dataclass(frozen=True)
class Model:
    """A robot or an object; the pose is that of the model's frame in the world.

    `frames` gives, for each frame that was merged into another link, the name of that link and the
    pose of the frame in it.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...] = ()
    plugins: tuple[PluginTag, ...] = ()
    pose: Pose = Pose()
    static: bool = False
    frames: Mapping[str, tuple[str, Pose]] = field(default_factory=dict)

    def root_links(self) -> tuple[Link, ...]:
        """Return the links that are the child of no joint."""
        children = {joint.child for joint in self.joints}
        return tuple(link for link in self.links if link.name not in children)

    def canonical_link(self) -> Link:
        """Return the link that moves the model: its first root, or the first child of the world."""
        root = self.root_links()[0]
        # WORLD_LINK is the last link.
        if root.name != WORLD_LINK:
            return root
        hanging = {joint.child for joint in self.joints if joint.parent == WORLD_LINK}
        return next(link for link in self.links if link.name in hanging)

    def own_links(self) -> tuple[Link, ...]:
        """Return the links without WORLD_LINK, which carries links that move on the world."""
        return tuple(link for link in self.links if link.name != WORLD_LINK)

    def links_by_name(self) -> dict[str, Link]:
        """Return the links by their names."""
        return {link.name: link for link in self.links}


@dataclass(frozen=True)
class Attenuation:
    """A light's share 1 / (constant + linear d + quadratic d²), at most 1; 0 beyond `range`."""

    range: float = 10.0
    constant: float = 1.0
    linear: float = 0.0
    quadratic: float = 0.0


@dataclass(frozen=True)
class Cone:
    """The cone of a spot: full light within the inner angle, none beyond the outer.

    Angles are whole openings in rad. In between, the share of the cosine is raised to the power
    `falloff`, as in OGRE.
    """

    inner: float = 0.0
    outer: float = math.pi
    falloff: float = 1.0


@dataclass(frozen=True)
class Light:
    """A light: `kind` is point, directional or spot; `direction` in the frame of `pose`.

    `attenuation` is for point and spot lights, `cone` for spots, `specular` for highlights.
    """

    name: str
    kind: str
    pose: Pose
    diffuse: Colour = WHITE
    direction: Vector = (0.0, 0.0, -1.0)
    casts_shadows: bool = False
    attenuation: Attenuation = Attenuation()
    cone: Cone = Cone()
    specular: Colour = (0.1, 0.1, 0.1, 1.0)


@dataclass(frozen=True)
class FrameState:
    """Pose of a frame, velocity of its origin in m/s, angular velocity in rad/s."""

    pose: Pose
    linear: Vector = (0.0, 0.0, 0.0)
    angular: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ModelState:
    """The pose of a model and the states of its links in the world.

    `joints` holds position (rad or m) and velocity of the movable joints.
    """

    pose: Pose
    links: Mapping[str, FrameState] = field(default_factory=dict)
    joints: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class World:
    """A world file; gravity in m/s², ambient light and background as RGBA.

    `coulomb` tells whether friction has a limit along each of two axes, or one for all directions.
    `states` holds saved states of models by name, if they are not as built.
    """

    name: str
    models: tuple[Model, ...] = ()
    lights: tuple[Light, ...] = ()
    gravity: Vector = (0.0, 0.0, -9.8)
    ambient: Colour = (0.4, 0.4, 0.4, 1.0)
    background: Colour = (0.7, 0.7, 0.7, 1.0)
    shadows: bool = True
    states: Mapping[str, ModelState] = field(default_factory=dict)
    coulomb: bool = False


@dataclass(frozen=True)
class Snapshot:
    """A world at a step: its models and their states."""

    world: World
    step: int
    models: tuple[tuple[Model, ModelState], ...]


@dataclass(frozen=True)
class Footprint:
    """An upright box of the model `name` from above; its `size` is along its own x and y, m."""

    name: str
    pose: PlanarPose
    size: tuple[float, float]

    def corners(self) -> tuple[Point, ...]:
        """Return the four corners, counter-clockwise."""
        corners = compose(self.pose, np.multiply(FOOTPRINT_CORNERS, (*self.size, 0.0)))
        return tuple(map(tuple, corners[:, :2].tolist()))

    def distance(self, point: Point) -> float:
        """Return the distance of a point in m, 0 inside."""
        place = np.abs(between(self.pose, (*point, 0.0))[:2])
        return math.hypot(*np.maximum(place - np.multiply(0.5, self.size), 0.0))


def footprints(world: World, below: float) -> tuple[Footprint, ...]:
    """Return the upright boxes of static models that begin below a height in m."""
    found: list[Footprint] = []
    static = [model for model in world.models if model.static]
    shapes = [(m, k, shape) for m in static for k in m.links for shape in k.collisions]
    for model, link, shape in shapes:
        pose, box = model.pose * link.pose * shape.pose, shape.geometry
        is_upright = pose.rotation_matrix()[2, 2] > math.cos(UPRIGHT)
        if isinstance(box, Box) and is_upright and pose.position[2] - 0.5 * box.size[2] < below:
            found.append(Footprint(model.name, pose.planar, box.size[:2]))
    return tuple(found)
