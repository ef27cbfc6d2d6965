"""What `<gazebo reference="…">` elements say about the links of a URDF."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Dict, Iterable, Optional
from xml.etree.ElementTree import Element

from bullet_lab.simulation.description import Colour, Link
from bullet_lab.simulation.gazebo_materials import gazebo_colour
from bullet_lab.simulation.xml_input import boolean, friction

LOG = logging.getLogger(__name__)

# Read elsewhere, or for the eye alone.
QUIET_TAGS = frozenset(("plugin", "sensor", "visualize", "visual"))
# Texts that ask for what happens anyway.
AS_IT_IS = {"gravity": ("1", "true"), "turnGravityOff": ("0", "false"), "static": ("0", "false")}


@dataclass(frozen=True)
class LinkTags:
    """What Gazebo is told of one link; None where it is told nothing.

    `mu` is Coulomb's coefficient, `stiffness` (N/m) and `damping` (N s/m) are those of its
    contacts.
    """

    colour: Optional[Colour] = None
    mu: Optional[float] = None
    stiffness: Optional[float] = None
    damping: Optional[float] = None
    self_collide: bool = False

    def apply(self, link: Link) -> Link:
        """Return the link as Gazebo would have it."""
        changes = {"friction": self.mu, "stiffness": self.stiffness, "damping": self.damping}
        told = {key: value for key, value in changes.items() if value is not None}
        visuals = link.visuals
        if self.colour is not None:
            visuals = tuple(replace(visual, colour=self.colour) for visual in visuals)
        return replace(
            link,
            visuals=visuals,
            collisions=tuple(replace(shape, **told) for shape in link.collisions),
            self_collide=self.self_collide,
        )


class GazeboTags:
    """Collects the `<gazebo>` elements of a document.

    Tags that are not simulated are reported once each by name, and so are references to nothing.

    Args:
        elements: the `<gazebo>` elements.
        references: names of the links and joints that may be referred to.
        source: names the document in messages.

    Raises:
        XmlError: a tag that is simulated makes no sense.
    """

    def __init__(self, elements: Iterable[Element], references: Iterable[str], source: str):
        self._source = source
        self._tags: Dict[str, LinkTags] = {}
        self._reported: set = set()
        known = set(references)
        for element in elements:
            name = element.get("reference")
            if name is None:
                self._report_unknown(element, ())
                continue
            if name not in known:
                self._report(f"<gazebo reference='{name}'>: there is no such link or joint")
            self._tags[name] = self._read(element, self._tags.get(name, LinkTags()), name)

    def apply(self, link: Link) -> Link:
        """Return a link as Gazebo would have it."""
        tags = self._tags.get(link.name)
        return link if tags is None else tags.apply(link)

    def _read(self, element: Element, tags: LinkTags, link: str) -> LinkTags:
        readers = {
            "material": self._material,
            "mu1": self._mu1,
            "mu2": self._mu2,
            "kp": self._kp,
            "kd": self._kd,
            "selfCollide": self._self_collide,
        }
        for child in element:
            if child.tag in readers:
                # Gazebo reads both spellings: <mu1>1</mu1> and <mu1 value="1"/>.
                text = (child.get("value") or child.text or "").strip()
                where = f"{self._source}: <{child.tag}> of '{link}'"
                tags = readers[child.tag](tags, text, where)
        self._report_unknown(element, readers)
        return tags

    def _material(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        colour = gazebo_colour(text)
        if colour is None:
            self._report(f"{where}: material '{text}' is not known and not drawn")
            return tags
        return replace(tags, colour=colour)

    def _mu1(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        return replace(tags, mu=friction(text, where))

    def _mu2(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        # Bullet's friction is the same in all directions.
        value = friction(text, where)
        if tags.mu is None:
            return replace(tags, mu=value)
        if value != tags.mu:
            self._report(f"{where}: friction has one coefficient here, <mu1>: {tags.mu:g}")
        return tags

    def _kp(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        # A coefficient that must not be negative, like that of friction.
        return replace(tags, stiffness=friction(text, where))

    def _kd(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        return replace(tags, damping=friction(text, where))

    def _self_collide(self, tags: LinkTags, text: str, where: str) -> LinkTags:
        return replace(tags, self_collide=boolean(text, where))

    def _report_unknown(self, element: Element, known: Iterable[str]) -> None:
        for child in element:
            is_as_it_is = (child.text or "").strip() in AS_IT_IS.get(child.tag, ())
            if child.tag not in QUIET_TAGS and child.tag not in known and not is_as_it_is:
                self._report(f"{self._source}: <gazebo>: <{child.tag}> is not simulated")

    def _report(self, message: str) -> None:
        if message not in self._reported:
            self._reported.add(message)
            LOG.warning("%s", message)
