"""Gazebo's own materials, from its gazebo.material."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Optional, Tuple

PREFIX = "Gazebo/"
Rgb = Tuple[float, float, float]

# Name, diffuse, ambient and emissive colour, alpha, and whether it is lit. "-" means an ambient
# colour like the diffuse one, or no emissive colour.
COLOURED = """
Black                       |0 0 0                     |-                         |-    |1  |yes
Blue                        |0 0 1                     |-                         |-    |1  |yes
DarkGrey                    |0.175 0.175 0.175         |-                         |-    |1  |yes
FlatBlack                   |0.1 0.1 0.1               |-                         |-    |1  |yes
Green                       |0 1 0                     |-                         |-    |1  |yes
Indigo                      |0.33 0 0.5                |-                         |-    |1  |yes
Orange                      |1 0.5088 0.0468           |-                         |-    |1  |yes
Purple                      |1 0 1                     |-                         |-    |1  |yes
Red                         |1 0 0                     |-                         |-    |1  |yes
RedBright                   |0.87 0.26 0.07            |-                         |-    |1  |yes
Turquoise                   |0 1 1                     |-                         |-    |1  |yes
White                       |1 1 1                     |-                         |-    |1  |yes
Yellow                      |1 1 0                     |-                         |-    |1  |yes
ZincYellow                  |0.9725 0.9529 0.2078      |-                         |-    |1  |yes
Gold                        |0.8 0.64869 0.120759      |0.4 0.24869 0.020759      |-    |1  |yes
Grey                        |0.7 0.7 0.7               |0.3 0.3 0.3               |-    |1  |yes
Pioneer2Body                |0.681193 0.000923 0.000923|0.481193 0.000123 0.000123|-    |1  |yes
SkyBlue                     |0 0 1                     |0.13 0.44 0.7             |-    |1  |yes
BlueGlow                    |0 0 1                     |-                         |0 0 1|1  |yes
GreenGlow                   |0 1 0                     |-                         |0 1 0|1  |yes
LightOff                    |1 0 0                     |-                         |1 0 0|1  |yes
LightOn                     |0 1 0                     |-                         |0 1 0|1  |yes
PurpleGlow                  |1 0 1                     |-                         |1 0 1|1  |yes
RedGlow                     |1 0 0                     |-                         |1 0 0|1  |yes
TurquoiseGlow               |0 1 1                     |-                         |0 1 1|1  |yes
TurquoiseGlowOutline        |0 1 1                     |-                         |0 1 1|1  |yes
WhiteGlow                   |1 1 1                     |-                         |1 1 1|1  |yes
YellowGlow                  |1 1 0                     |-                         |1 1 0|1  |yes
BlueLaser                   |0 0 1                     |-                         |-    |0.4|yes
BlueTransparent             |0 0 1                     |-                         |-    |0.5|yes
DarkMagentaTransparent      |0.6 0 0.6                 |-                         |-    |0.5|yes
GreenTransparent            |0 1 0                     |-                         |-    |0.5|yes
GreyTransparent             |0.5 0.5 0.5               |-                         |-    |0.5|yes
LightBlueLaser              |0.5 0.5 1                 |-                         |-    |0.4|yes
OrangeTransparent           |1 0.44 0                  |-                         |-    |0.4|yes
YellowTransparent           |1 1 0                     |-                         |-    |0.5|yes
BlueTransparentOverlay      |0 0 1                     |-                         |-    |0.5|no
DarkOrangeTransparentOverlay|0.6 0.305 0.028           |-                         |-    |0.8|no
GreenTransparentOverlay     |0 1 0                     |-                         |-    |0.5|no
JointAnchor                 |1 1 1                     |-                         |-    |1  |no
OrangeTransparentOverlay    |1 0.5088 0.0468           |-                         |-    |0.8|no
RedTransparent              |1 0 0                     |-                         |-    |0.5|no
RedTransparentOverlay       |1 0 0                     |-                         |-    |0.5|no
"""
# Name, diffuse and ambient colour, picture, and the mean colour that replaces a missing picture.
PICTURED = """
Bricks        | 1 1 1       | 1 1 1       | bricks.png         | 0.55 0.32 0.25
BuildingFrame | 1 1 1       | 1 1 1       | building_frame.png | 0.6 0.6 0.6
CeilingTiled  | 1 1 1       | 0.5 0.5 0.5 | ceiling_tiled.jpg  | 0.8 0.8 0.78
CoM           | 1 1 1       | 0.5 0.5 0.5 | com.png            | 0.9 0.9 0.9
Footway       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | sidewalk.jpg       | 0.4 0.4 0.4
Grass         | 1 1 1       | 0.5 0.5 0.5 | grass.jpg          | 0.3 0.42 0.2
Lane_1        | 0.8 0.8 0.8 | 0.1 0.1 0.1 | secondary.jpg      | 0.4 0.4 0.4
Lanes_2       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | primary.jpg        | 0.4 0.4 0.4
Lanes_4       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | trunk.jpg          | 0.4 0.4 0.4
Lanes_6       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | motorway.jpg       | 0.4 0.4 0.4
Motorway      | 0.8 0.8 0.8 | 0.1 0.1 0.1 | motorway.jpg       | 0.4 0.4 0.4
PaintedWall   | 1 1 1       | 1 1 1       | paintedWall.jpg    | 0.85 0.83 0.78
Pedestrian    | 0.8 0.8 0.8 | 0.1 0.1 0.1 | sidewalk.jpg       | 0.4 0.4 0.4
PioneerBody   | 1 0 0       | 0.5 0 0     | pioneerBody.jpg    | 1 1 1
Primary       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | primary.jpg        | 0.4 0.4 0.4
Residential   | 0.8 0.8 0.8 | 0.1 0.1 0.1 | residential.jpg    | 0.4 0.4 0.4
Road          | 0.8 0.8 0.8 | 0.1 0.1 0.1 | road1.jpg          | 0.4 0.4 0.4
Runway        | 1 1 1       | 0.5 0.5 0.5 | runway.png         | 0.4 0.4 0.4
Secondary     | 0.8 0.8 0.8 | 0.1 0.1 0.1 | secondary.jpg      | 0.4 0.4 0.4
Steps         | 0.8 0.8 0.8 | 0.1 0.1 0.1 | steps.jpeg         | 0.4 0.4 0.4
Tertiary      | 0.8 0.8 0.8 | 0.1 0.1 0.1 | residential.jpg    | 0.4 0.4 0.4
Trunk         | 0.8 0.8 0.8 | 0.1 0.1 0.1 | trunk.jpg          | 0.4 0.4 0.4
WindowFrame   | 1 1 1       | 1 1 1       | window_frame.png   | 0.85 0.85 0.85
Wood          | 1 1 1       | 1 1 1       | wood.jpg           | 0.6 0.45 0.3
WoodFloor     | 1 1 1       | 0.5 0.5 0.5 | hardwood_floor.jpg | 0.6 0.43 0.27
WoodPallet    | 1 1 1       | 0.5 0.5 0.5 | WoodPallet.png     | 0.65 0.52 0.36
"""
SCALES = {"Grass": (0.02, 0.02)}


@dataclass(frozen=True)
class GazeboMaterial:
    """One of Gazebo's materials; `plain` replaces a missing picture."""

    diffuse: Rgb
    ambient: Optional[Rgb] = None
    emissive: Rgb = (0.0, 0.0, 0.0)
    alpha: float = 1.0
    lit: bool = True
    picture: str = ""
    plain: Rgb = (1.0, 1.0, 1.0)
    scale: Tuple[float, float] = (1.0, 1.0)


def _rgb(text: str) -> Optional[Rgb]:
    return None if text == "-" else tuple(map(float, text.split()))


def _read_tables() -> Dict[str, GazeboMaterial]:
    found: Dict[str, GazeboMaterial] = {}
    for line in COLOURED.strip().splitlines():
        name, diffuse, ambient, emissive, alpha, lit = map(str.strip, line.split("|"))
        glow = _rgb(emissive) or GazeboMaterial.emissive
        found[name] = GazeboMaterial(_rgb(diffuse), _rgb(ambient), glow, float(alpha), lit == "yes")
    for line in PICTURED.strip().splitlines():
        name, diffuse, ambient, picture, plain = map(str.strip, line.split("|"))
        found[name] = GazeboMaterial(
            _rgb(diffuse),
            _rgb(ambient),
            picture=picture,
            plain=_rgb(plain),
            scale=SCALES.get(name, GazeboMaterial.scale),
        )
    return found


MATERIALS = _read_tables()


def gazebo_material(name: str) -> Optional[GazeboMaterial]:
    """Return the material with a name such as "Gazebo/Red", or None for any other name."""
    return MATERIALS.get(name[len(PREFIX) :]) if name.startswith(PREFIX) else None
