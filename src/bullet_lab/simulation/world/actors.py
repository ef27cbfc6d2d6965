"""Actors of SDF: people and things that walk along a path, as models with the path's plugin."""

from __future__ import annotations

import copy
from xml.etree.ElementTree import Element, SubElement, fromstring

PATH_PLUGIN = "libbullet_lab_path.so"
# An actor's skin is not drawn; m and kg of a grown person instead, just above the floor.
FIGURE = """<link name="link"><inertial><mass>80</mass></inertial>
  <collision name="body"><pose>0 0 0.75 0 0 0</pose>
    <geometry><cylinder><radius>0.2</radius><length>1.46</length></cylinder></geometry></collision>
  <collision name="head"><pose>0 0 1.6 0 0 0</pose>
    <geometry><sphere><radius>0.12</radius></sphere></geometry></collision>
  <visual name="body"><pose>0 0 0.75 0 0 0</pose>
    <geometry><cylinder><radius>0.2</radius><length>1.46</length></cylinder></geometry></visual>
  <visual name="head"><pose>0 0 1.6 0 0 0</pose>
    <geometry><sphere><radius>0.12</radius></sphere></geometry></visual></link>"""


def actor_model(actor: Element) -> Element:
    """Return the <model> that stands for an <actor>.

    An actor without links is a figure that stands on the floor: of its poses, only x, y and yaw
    count.
    """
    model = Element("model", dict(actor.attrib))
    model.extend(child for child in actor if child.tag in ("pose", "plugin"))
    links = [copy.deepcopy(link) for link in actor.findall("link")]
    script = Element("plugin", name="path", filename=PATH_PLUGIN)
    script.extend(copy.deepcopy(child) for path in actor.findall("script") for child in path)
    # Without a path, a plugin of its own may move it, or it stands.
    if script.find("trajectory/waypoint") is not None:
        model.append(script)
    elif model.find("plugin") is None:
        SubElement(model, "static").text = "1"
    if not links:
        links = [fromstring(FIGURE)]
        for pose in (*model.findall("pose"), *script.iter("pose")):
            pose.text = _upright(pose.text or "")
    for link in links:
        if link.find("gravity") is None:
            SubElement(link, "gravity").text = "0"
    model.extend(links)
    return model


def _upright(pose: str) -> str:
    """Return the six numbers of a pose with height, roll and pitch 0; other texts unchanged."""
    words = pose.split()
    return " ".join((*words[:2], "0 0 0", words[5])) if len(words) == 6 else pose
