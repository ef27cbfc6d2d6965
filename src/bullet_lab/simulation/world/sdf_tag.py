"""Reading one element of an SDF document, whatever stands around it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Optional, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import Colour
from bullet_lab.simulation.world.frames import Frames
from bullet_lab.simulation.world.materials import MaterialLibrary
from bullet_lab.simulation.world.report import ReportOnce
from bullet_lab.simulation.world.resources import ResourceError, ResourceFinder
from bullet_lab.simulation.world.shapes import ShapeTag
from bullet_lab.simulation.world.xml import ElementReader, XmlError, numbers

# That the writer writes, and that Gazebo 11 reads.
NEWEST = (1, 7)


class SdfError(XmlError):
    """A text is well-formed XML and yet no world or model."""


def version_of(root: Element) -> Tuple[int, ...]:
    """Return the version that an <sdf> says, the newest by default."""
    try:
        return tuple(int(part) for part in root.get("version", "").split("."))
    except ValueError:
        return NEWEST


@dataclass(frozen=True)
class Document:
    """What an element stands in.

    `version` is the document's; `depth` says how many includes are around it; `report` tells the
    user once each what is not simulated or makes no sense; `materials` are all read so far.
    """

    finder: ResourceFinder
    version: Tuple[int, ...] = NEWEST
    depth: int = 0
    report: ReportOnce = field(default_factory=ReportOnce)
    materials: MaterialLibrary = field(default_factory=MaterialLibrary)


class SdfTag(ElementReader, ShapeTag):
    """An element and the document that it stands in.

    Where `frames` are known, its poses are given in them, and returned in the frame `inside`.
    """

    def __init__(
        self,
        element: Element,
        source: str,
        document: Document,
        frames: Optional[Frames] = None,
        inside: str = "",
    ):
        super().__init__(element, source)
        self.document = document
        self.name = element.get("name", "")
        self.frames, self.inside = frames, inside

    def below(self, element: Element) -> SdfTag:
        """Return an element in it, which messages name."""
        source = f"{self.source}: {element.tag} '{element.get('name', '')}'"
        return SdfTag(element, source, self.document, self.frames, self.inside)

    def named(self, element: Element) -> SdfTag:
        """Return an element in it; raises SdfError for one without a name."""
        if not element.get("name"):
            raise SdfError(f"{self.source}: a <{element.tag}> without a name")
        return self.below(element)

    def doubt(self, error: LabError) -> None:  # noqa: D102
        self.document.report(f"{error}; the default counts")

    def base(self) -> str:
        """Return the frame that its <pose> is given in; empty for the one around it."""
        found = self.element.find("pose")
        return "" if found is None else found.get("relative_to") or found.get("frame") or ""

    def pose(self) -> Pose:  # noqa: D102
        base, pose = self.base(), super().pose()
        if self.frames is None or base in ("", self.inside):
            return pose
        return self.frames.pose(self.inside).inverse() * self.frames.pose(base) * pose

    def colour(self, key: str, default: Colour) -> Colour:
        """Return the colour that a tag says."""
        text = self.text(key)
        # Alpha may be left out.
        padded = text if len(text.split()) != 3 else f"{text} 1"
        try:
            return numbers(padded, 4, self.where(key)) if text else default
        except XmlError as error:
            self.doubt(error)
            return default

    def uri(self) -> str:  # noqa: D102
        uri = self.text("uri")
        if not uri:
            raise SdfError(f"{self.source}: a <mesh> without <uri>")
        return uri

    def find(self, uri: str) -> Path:  # noqa: D102
        try:
            return self.document.finder.find(uri)
        except ResourceError as error:
            raise ResourceError(f"{self.source}: {error}") from error
