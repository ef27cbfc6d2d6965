"""Reading a model from text that may be SDF or URDF."""

from __future__ import annotations

from typing import Optional

from bullet_lab.simulation.world.description import Model
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.simulation.world.sdf import read_model_text
from bullet_lab.simulation.world.urdf import read_urdf
from bullet_lab.simulation.world.xml import XmlError, parse_text


def read_description(text: str, source: str, finder: Optional[ResourceFinder] = None) -> Model:
    """Return the model that a text describes, SDF or URDF.

    Args:
        text: the description.
        source: names it in messages.
        finder: finds the files that it names.

    Raises:
        LabError: neither, or no model that could exist; the message says what and where.
    """
    root = parse_text(text, source)
    if root.tag == "robot":
        return read_urdf(text, source, finder)
    if root.tag == "sdf":
        return read_model_text(text, source, finder)
    raise XmlError(f"{source}: the root element is <{root.tag}>, neither <sdf> nor <robot>")
