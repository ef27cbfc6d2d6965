"""Actors of SDF: people and things that walk along a path, as models with the path's plugin."""

from __future__ import annotations

import copy
from xml.etree.ElementTree import Element, SubElement, fromstring

PATH_PLUGIN = "libbullet_lab_path.so"
# An actor's skin is not drawn; m and kg of a grown person instead, just above the floor.
FIGURE = """<link name="link"><inertial><mass>80</mass></inertial>{}</link>"""
SHAPES = (
    ("body", "0 0 0.75 0 0 0", "<cylinder><radius>0.2</radius><length>1.46</length></cylinder>"),
    ("head", "0 0 1.6 0 0 0", "<sphere><radius>0.12</radius></sphere>"),
)


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
        links = [_figure()]
        for pose in (*model.findall("pose"), *script.iter("pose")):
            pose.text = _upright(pose.text or "")
    for link in links:
        if link.find("gravity") is None:
            SubElement(link, "gravity").text = "0"
    model.extend(links)
    return model


def _figure() -> Element:
    parts = (
        f'<{kind} name="{name}"><pose>{pose}</pose><geometry>{shape}</geometry></{kind}>'
        for name, pose, shape in SHAPES
        for kind in ("collision", "visual")
    )
    return fromstring(FIGURE.format("".join(parts)))


def _upright(pose: str) -> str:
    """Return the six numbers of a pose with height, roll and pitch 0; other texts unchanged."""
    words = pose.split()
    return " ".join((*words[:2], "0 0 0", words[5])) if len(words) == 6 else pose
