"""The colours that Gazebo's material names stand for."""

from __future__ import annotations

from typing import Dict, Optional

from bullet_lab.simulation.world.description import Colour

# Diffuse colours of Gazebo's own materials that are drawn without a texture.
_OPAQUE = {
    "Black": (0.0, 0.0, 0.0),
    "Blue": (0.0, 0.0, 1.0),
    "DarkGrey": (0.175, 0.175, 0.175),
    "FlatBlack": (0.1, 0.1, 0.1),
    "Gold": (0.8, 0.64869, 0.120759),
    "Green": (0.0, 1.0, 0.0),
    "Grey": (0.7, 0.7, 0.7),
    "Indigo": (0.33, 0.0, 0.5),
    "LightOff": (1.0, 0.0, 0.0),
    "LightOn": (0.0, 1.0, 0.0),
    "Orange": (1.0, 0.5088, 0.0468),
    "Purple": (1.0, 0.0, 1.0),
    "Red": (1.0, 0.0, 0.0),
    "RedBright": (0.87, 0.26, 0.07),
    "SkyBlue": (0.0, 0.0, 1.0),
    "Turquoise": (0.0, 1.0, 1.0),
    "White": (1.0, 1.0, 1.0),
    "Yellow": (1.0, 1.0, 0.0),
    "ZincYellow": (0.9725, 0.9529, 0.2078),
}
_GLOWING = ("Blue", "Green", "Purple", "Red", "Turquoise", "White", "Yellow")
_TRANSPARENT = {
    "Blue": (0.0, 0.0, 1.0),
    "Green": (0.0, 1.0, 0.0),
    "Grey": (0.5, 0.5, 0.5),
    "Orange": (1.0, 0.44, 0.0),
    "Red": (1.0, 0.0, 0.0),
    "Yellow": (1.0, 1.0, 0.0),
}
PREFIX = "Gazebo/"


def _table() -> Dict[str, Colour]:
    table: Dict[str, Colour] = {name: (*rgb, 1.0) for name, rgb in _OPAQUE.items()}
    table.update({f"{name}Glow": table[name] for name in _GLOWING})
    table.update({f"{name}Transparent": (*rgb, 0.5) for name, rgb in _TRANSPARENT.items()})
    return table


COLOURS = _table()


def gazebo_colour(material: str) -> Optional[Colour]:
    """Return the colour of a material such as "Gazebo/Red", or None for any other name."""
    return COLOURS.get(material[len(PREFIX) :]) if material.startswith(PREFIX) else None
