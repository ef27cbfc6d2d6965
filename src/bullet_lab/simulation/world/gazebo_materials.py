"""Gazebo's own materials: facts of its gazebo.material, by what stands after "Gazebo/".

Colours are RGB: diffuse, and ambient and emissive where they differ from it and from black.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Optional, Tuple

PREFIX = "Gazebo/"
Rgb = Tuple[float, float, float]
WHITE, GREY = (1.0, 1.0, 1.0), (0.5, 0.5, 0.5)


@dataclass(frozen=True)
class GazeboMaterial:
    """What Gazebo calls by a name; `picture` names the file of a texture of its own."""

    diffuse: Rgb
    ambient: Optional[Rgb] = None
    emissive: Rgb = (0.0, 0.0, 0.0)
    alpha: float = 1.0
    lit: bool = True
    picture: str = ""
    scale: Tuple[float, float] = (1.0, 1.0)


_BLUE, _GREEN, _RED = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
_PURPLE, _TURQUOISE, _YELLOW = (1.0, 0.0, 1.0), (0.0, 1.0, 1.0), (1.0, 1.0, 0.0)
_ORANGE, _DARK_ORANGE = (1.0, 0.5088, 0.0468), (0.6, 0.305, 0.028)
_SIMPLE = {
    "Black": (0.0, 0.0, 0.0),
    "Blue": _BLUE,
    "DarkGrey": (0.175, 0.175, 0.175),
    "FlatBlack": (0.1, 0.1, 0.1),
    "Green": _GREEN,
    "Indigo": (0.33, 0.0, 0.5),
    "Orange": _ORANGE,
    "Purple": _PURPLE,
    "Red": _RED,
    "RedBright": (0.87, 0.26, 0.07),
    "Turquoise": _TURQUOISE,
    "White": WHITE,
    "Yellow": _YELLOW,
    "ZincYellow": (0.9725, 0.9529, 0.2078),
}
_TWO_COLOURED = {
    "Gold": ((0.8, 0.64869, 0.120759), (0.4, 0.24869, 0.020759)),
    "Grey": ((0.7, 0.7, 0.7), (0.3, 0.3, 0.3)),
    "Pioneer2Body": ((0.681193, 0.000923, 0.000923), (0.481193, 0.000123, 0.000123)),
    "SkyBlue": ((0.0, 0.0, 1.0), (0.13, 0.44, 0.7)),
}
_GLOWING = {
    "BlueGlow": _BLUE,
    "GreenGlow": _GREEN,
    "LightOff": _RED,
    "LightOn": _GREEN,
    "PurpleGlow": _PURPLE,
    "RedGlow": _RED,
    "TurquoiseGlow": _TURQUOISE,
    "TurquoiseGlowOutline": _TURQUOISE,
    "WhiteGlow": WHITE,
    "YellowGlow": _YELLOW,
}
_TRANSPARENT = {
    "BlueLaser": (_BLUE, 0.4),
    "BlueTransparent": (_BLUE, 0.5),
    "DarkMagentaTransparent": ((0.6, 0.0, 0.6), 0.5),
    "GreenTransparent": (_GREEN, 0.5),
    "GreyTransparent": (GREY, 0.5),
    "LightBlueLaser": ((0.5, 0.5, 1.0), 0.4),
    "OrangeTransparent": ((1.0, 0.44, 0.0), 0.4),
    "YellowTransparent": (_YELLOW, 0.5),
}
_UNLIT = {
    "BlueTransparentOverlay": (_BLUE, 0.5),
    "DarkOrangeTransparentOverlay": (_DARK_ORANGE, 0.8),
    "GreenTransparentOverlay": (_GREEN, 0.5),
    "JointAnchor": (WHITE, 1.0),
    "OrangeTransparentOverlay": (_ORANGE, 0.8),
    "RedTransparent": (_RED, 0.5),
    "RedTransparentOverlay": (_RED, 0.5),
}
_ROAD = ((0.8, 0.8, 0.8), (0.1, 0.1, 0.1))
# Diffuse, ambient, the texture's file.
_PICTURED = {
    "Bricks": (WHITE, WHITE, "bricks.png"),
    "BuildingFrame": (WHITE, WHITE, "building_frame.png"),
    "CeilingTiled": (WHITE, GREY, "ceiling_tiled.jpg"),
    "CoM": (WHITE, GREY, "com.png"),
    "Footway": (*_ROAD, "sidewalk.jpg"),
    "Grass": (WHITE, GREY, "grass.jpg"),
    "Lane_1": (*_ROAD, "secondary.jpg"),
    "Lanes_2": (*_ROAD, "primary.jpg"),
    "Lanes_4": (*_ROAD, "trunk.jpg"),
    "Lanes_6": (*_ROAD, "motorway.jpg"),
    "Motorway": (*_ROAD, "motorway.jpg"),
    "PaintedWall": (WHITE, WHITE, "paintedWall.jpg"),
    "Pedestrian": (*_ROAD, "sidewalk.jpg"),
    "PioneerBody": (_RED, (0.5, 0.0, 0.0), "pioneerBody.jpg"),
    "Primary": (*_ROAD, "primary.jpg"),
    "Residential": (*_ROAD, "residential.jpg"),
    "Road": (*_ROAD, "road1.jpg"),
    "Runway": (WHITE, GREY, "runway.png"),
    "Secondary": (*_ROAD, "secondary.jpg"),
    "Steps": (*_ROAD, "steps.jpeg"),
    "Tertiary": (*_ROAD, "residential.jpg"),
    "Trunk": (*_ROAD, "trunk.jpg"),
    "WindowFrame": (WHITE, WHITE, "window_frame.png"),
    "Wood": (WHITE, WHITE, "wood.jpg"),
    "WoodFloor": (WHITE, GREY, "hardwood_floor.jpg"),
    "WoodPallet": (WHITE, GREY, "WoodPallet.png"),
}
_SCALES = {"Grass": (0.02, 0.02)}

MATERIALS: Dict[str, GazeboMaterial] = {
    **{name: GazeboMaterial(rgb) for name, rgb in _SIMPLE.items()},
    **{name: GazeboMaterial(*colours) for name, colours in _TWO_COLOURED.items()},
    **{name: GazeboMaterial(rgb, emissive=rgb) for name, rgb in _GLOWING.items()},
    **{name: GazeboMaterial(rgb, alpha=a) for name, (rgb, a) in _TRANSPARENT.items()},
    **{name: GazeboMaterial(rgb, alpha=a, lit=False) for name, (rgb, a) in _UNLIT.items()},
    **{
        name: GazeboMaterial(diffuse, ambient, picture=picture, scale=_SCALES.get(name, (1.0, 1.0)))
        for name, (diffuse, ambient, picture) in _PICTURED.items()
    },
}
# What stands for a texture of Gazebo's where its file is not to be had, about its mean colour.
PLAIN: Dict[str, Rgb] = {
    "bricks.png": (0.55, 0.32, 0.25),
    "grass.jpg": (0.3, 0.42, 0.2),
    "hardwood_floor.jpg": (0.6, 0.43, 0.27),
    "wood.jpg": (0.6, 0.45, 0.3),
    "WoodPallet.png": (0.65, 0.52, 0.36),
    "ceiling_tiled.jpg": (0.8, 0.8, 0.78),
    "paintedWall.jpg": (0.85, 0.83, 0.78),
    "window_frame.png": (0.85, 0.85, 0.85),
    "building_frame.png": (0.6, 0.6, 0.6),
    "com.png": (0.9, 0.9, 0.9),
    "pioneerBody.jpg": (1.0, 1.0, 1.0),
}
ROAD_GREY: Rgb = (0.4, 0.4, 0.4)


def gazebo_material(name: str) -> Optional[GazeboMaterial]:
    """Return what a name such as "Gazebo/Red" means, or None for any other name."""
    return MATERIALS.get(name[len(PREFIX) :]) if name.startswith(PREFIX) else None
