"""Materials by their names: those of OGRE's scripts, which worlds point to, and Gazebo's own.

As in OGRE, what one model has loaded is known to all that come after it in a document, pictures are
found by the bare names of their files, and of a material with several passes the last one that is
not transparent is what is seen. Its programs are not run. What is missing is named once, and drawn
without.
"""

from __future__ import annotations

import logging
import math
import os
from pathlib import Path
from typing import Dict, Iterable, Iterator, List, Optional, Sequence, Set, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import WHITE, Colour, Material, Texture
from bullet_lab.simulation.world.gazebo_materials import (
    PLAIN,
    ROAD_GREY,
    GazeboMaterial,
    gazebo_material,
)
from bullet_lab.simulation.world.ogre_script import (
    Block,
    ScriptError,
    inherited,
    parse_script,
    substituted,
)
from bullet_lab.simulation.world.resources import (
    ResourceError,
    ResourceFinder,
    gazebo_media_folders,
    is_below,
)
from bullet_lab.simulation.world.xml import (
    MAXIMUM_BYTES,
    ElementReader,
    ReportOnce,
    XmlError,
    file_bytes,
    numbers,
)

LOG = logging.getLogger(__name__)
# Of a folder that scripts or pictures are looked for in.
MOST_FILES = 20_000
# Gazebo's own scripts, which its documents name beside those of others.
GAZEBO_MEDIA = "file://media/materials/"
UNSAID = ("", "__default__")

# A colour, and the rest of how a surface looks.
Look = Tuple[Colour, Material]


class MaterialLibrary:
    """The materials that a document may name."""

    def __init__(self, report: Optional[ReportOnce] = None):
        self._report = report or ReportOnce()
        self._read: Dict[Path, Dict[Tuple[str, str], Block]] = {}
        # Where scripts and pictures were declared, the first one first.
        self._declared: List[Path] = []
        self._files: Dict[Path, Dict[str, Path]] = {}
        # Names and URIs that lead nowhere, and were said.
        self._unknown: Set[str] = set()

    def of_element(
        self, element: Optional[Element], source: str, finder: ResourceFinder, default: Colour
    ) -> Look:
        """Return what an SDF's `<material>` means; `default` is the colour without any."""
        if element is None:
            return default, Material()
        tag = ElementReader(element, source)
        name = tag.text("script/name", tag.text("script", element.get("script", "")))
        found, colour, look = None, default, Material()
        if name not in UNSAID:
            uris = [(uri.text or "").strip() for uri in element.findall("script/uri")]
            found = self.named(name, source, finder, uris)
            # What is not known is not forgotten.
            scripts = tuple(self._scripts(uris, source, finder))
            colour, look = found or (default, Material(name=name, scripts=scripts))
        diffuse, ambient = self._colour(tag, "diffuse"), self._colour(tag, "ambient")
        emissive = self._colour(tag, "emissive")
        fields = {**vars(look), "covers": bool(found or diffuse or ambient)}
        if ambient is not None and (found or diffuse):
            fields["ambient"] = ambient
        if emissive is not None:
            fields["emissive"] = emissive
        if tag.text("lighting") in ("0", "false"):
            fields["lit"] = False
        # One of the two stands for both where nobody says the other.
        return diffuse or (colour if found else ambient or colour), Material(**fields)

    def named(
        self, name: str, source: str, finder: ResourceFinder, uris: Sequence[str] = ()
    ) -> Optional[Look]:
        """Return what a name means, None if it is not known, which is said.

        `uris` name the folders or files with its script and its pictures.
        """
        scripts = tuple(self._scripts(uris, source, finder))
        folders = [path if os.path.isdir(path) else path.parent for _, path in scripts]
        self._declared += [folder for folder in folders if folder not in self._declared]
        for path in (*(path for _, path in scripts), *self._declared):
            block, folder = self._block("material", name, [path])
            if block is not None:
                return self._look(name, block, [*folders, folder], scripts)
        known = gazebo_material(name)
        if known is not None:
            return self._gazebo_look(name, known)
        media = gazebo_media_folders()
        scripts_there = [path for folder in media for path in sorted(folder.glob("*.material"))]
        block, folder = self._block("material", name, scripts_there)
        if block is not None:
            return self._look(name, block, [*folders, folder], scripts)
        if name not in self._unknown:
            self._unknown.add(name)
            self._report(f"{source}: material '{name}' is in no script that is named; not drawn")
        return None

    def _colour(self, tag: ElementReader, key: str) -> Optional[Colour]:
        text = tag.text(key)
        # Alpha may be left out.
        padded = f"{text} 1" if len(text.split()) == 3 else text
        try:
            return _clipped(numbers(padded, 4, tag.where(key))) if text else None
        except XmlError as error:
            self._report(f"{error}; not counted")
            return None

    def _scripts(
        self, uris: Iterable[str], source: str, finder: ResourceFinder
    ) -> Iterator[Tuple[str, Path]]:
        """Yield what URIs name, as they were given and as they were found."""
        for uri in uris:
            if uri in UNSAID or uri.startswith(GAZEBO_MEDIA):
                continue
            try:
                yield uri, finder.find(uri)
            except ResourceError as error:
                if uri not in self._unknown:
                    self._unknown.add(uri)
                    self._report(f"{source}: <script>: {error}")

    def _block(self, kind: str, name: str, places: Iterable[Path]) -> Tuple[Optional[Block], Path]:
        """Return a block of one of the scripts in places, and the folder of that script."""
        for place in places:
            for path in self._script_files(place):
                if (kind, name) in self._blocks(path):
                    return self._blocks(path)[(kind, name)], path.parent
        return None, Path()

    def _script_files(self, place: Path) -> List[Path]:
        if os.path.isfile(place):
            return [place]
        files = self._index(place).values()
        return [path for path in files if path.suffix == ".material"]

    def _blocks(self, path: Path) -> Dict[Tuple[str, str], Block]:
        """Return the blocks of a script by kind and name, with those that it imports."""
        if path in self._read:
            return self._read[path]
        found = self._read[path] = {}
        try:
            text = file_bytes(path, MAXIMUM_BYTES).decode("utf-8", errors="replace")
        except LabError as error:
            self._report(f"{error}; its materials are not drawn")
            return found
        root, mistake = parse_script(text)
        if mistake:
            self._report(f"{path}: {mistake}; what follows is not read")
        for line in root.properties:
            if line[0] == "import" and "from" in line[:-1]:
                other = self._file(line[-1], [path.parent])
                if other is None:
                    self._report(f"{path}: import: '{line[-1]}' is not there")
                else:
                    found.update(self._blocks(other))
        for block in root.blocks:
            # The first one of a name counts.
            found.setdefault((block.kind, block.name), block)
        return found

    def _find_block(self, folder: Path, kind: str, name: str) -> Optional[Block]:
        return self._block(kind, name, [folder, *self._declared])[0]

    def _look(
        self, name: str, block: Block, folders: Sequence[Path], scripts: Sequence[Tuple[str, Path]]
    ) -> Look:
        """Return how a material's blocks look."""
        where = f"material '{name}' in {folders[-1]}"
        try:
            whole = substituted(
                inherited(block, lambda kind, n: self._find_block(folders[-1], kind, n))
            )
        except ScriptError as error:
            self._report(f"{where}: {error}; drawn without")
            whole = substituted(block)
        seen = _seen_pass(whole)
        if seen.all("vertex_program_ref") or seen.all("fragment_program_ref"):
            self._report(f"{where}: its programs are not run")
        blends = _blends(seen)
        diffuse = self._numbers(seen, where, "diffuse") or WHITE
        ambient = self._numbers(seen, where, "ambient") or WHITE
        emissive = self._numbers(seen, where, "emissive", "self_illumination")
        lit = seen.words("lighting") != ("off",)
        colour = diffuse if lit else (1.0, 1.0, 1.0, diffuse[3])
        aliases = {line[1]: line[2] for line in whole.properties if _is_alias(line)}
        texture = None
        for unit in seen.all("texture_unit"):
            painted, faded = _manual(unit, "colour_op_ex", 3), _manual(unit, "alpha_op_ex", 1)
            if painted:
                colour, lit = (*painted, colour[3]), False
            colour = (*colour[:3], *(faded or colour[3:]))
            texture = texture or self._texture(unit, aliases, folders, where, blends)
        alpha = colour[3] if blends else 1.0
        material = Material(
            ambient,
            emissive or Material.emissive,
            texture,
            lit,
            True,
            name,
            tuple(scripts),
        )
        return _clipped((*colour[:3], alpha)), material

    def _numbers(self, block: Block, where: str, *keys: str) -> Optional[Colour]:
        """Return the colour that a line of a block says, with alpha 1 if that is left out."""
        words = block.words(*keys)
        if not words or words == ("vertexcolour",):
            return None
        found = _finite(words)
        if len(found) not in (3, 4):
            self._report(f"{where}: {keys[0]} '{' '.join(words)[:80]}' is no colour")
            return None
        return _clipped((*found, 1.0)[:4])

    def _texture(
        self,
        unit: Block,
        aliases: Dict[str, str],
        folders: Sequence[Path],
        where: str,
        blends: bool,
    ) -> Optional[Texture]:
        """Return what a texture unit puts on a surface."""
        lines = [line for line in unit.properties if line[0] == "texture" and len(line) > 1]
        alias = " ".join(unit.words("texture_alias")) or unit.name
        file = aliases.get(alias, lines[-1][1] if lines else "")
        if not file:
            return None
        path = self._file(file, folders)
        if path is None:
            self._report(f"{where}: its picture '{file}' is not there; drawn without")
            return None
        scale = _finite(unit.words("scale"))
        turn = _finite(unit.words("rotate"))
        return Texture(
            path,
            scale if len(scale) == 2 and all(scale) else Texture.scale,
            (*_finite(unit.words("scroll")), 0.0, 0.0)[:2],
            math.radians(turn[0]) if turn else 0.0,
            unit.words("tex_address_mode")[:1] not in (("clamp",), ("border",)),
            blends,
            # For less, more and between: one word stands for all three.
            (unit.words("filtering") * 3)[1:2] in (("none",), ("point",)),
        )

    def _gazebo_look(self, name: str, known: GazeboMaterial) -> Look:
        texture, diffuse, ambient = None, known.diffuse, known.ambient
        if known.picture:
            path = self._file(known.picture, ())
            if path is None:
                self._report(f"material '{name}': Gazebo's {known.picture} is not here: a colour")
                plain = PLAIN.get(known.picture, ROAD_GREY)
                diffuse, ambient = (_times(plain, c or diffuse) for c in (diffuse, ambient))
            else:
                texture = Texture(path, known.scale)
        ambient = None if ambient is None else (*ambient, 1.0)
        rest = Material(ambient, (*known.emissive, 1.0), texture, known.lit, True, name)
        return (*diffuse, known.alpha), rest

    def _file(self, name: str, folders: Sequence[Path]) -> Optional[Path]:
        """Return a file that a script names, in or near the folders where OGRE would look for it.

        That is, in the folders that were named, by its path in them or by its bare name, in the
        `textures` beside a folder of scripts, and where all others have theirs.
        """
        beside = [folder.parent / "textures" for folder in folders]
        for folder in (*folders, *beside, *self._declared):
            path = folder / name
            if os.path.isfile(path) and is_below(path, folder):
                return path
            path = self._index(folder).get(os.path.basename(name))
            if path is not None:
                return path
        media = (folder / os.path.basename(name) for folder in gazebo_media_folders())
        return next((path for path in media if os.path.isfile(path)), None)

    def _index(self, folder: Path) -> Dict[str, Path]:
        """Return the files in a folder and below it by their bare names, the upper ones first."""
        if folder not in self._files:
            found: Dict[str, Path] = {}
            count = 0
            for place, inner, names in os.walk(folder):
                inner.sort()
                for name in sorted(names):
                    path = Path(place) / name
                    if is_below(path, folder):
                        found.setdefault(name, path)
                count += len(names)
                if count > MOST_FILES:
                    self._report(f"{folder}: not all of its files are looked at: over {MOST_FILES}")
                    break
            self._files[folder] = found
        return self._files[folder]


def _seen_pass(material: Block) -> Block:
    """Return the pass that is seen: the last one that is not transparent, or else the first one."""
    techniques = material.all("technique")
    plain = [t for t in techniques if t.words("scheme") in ((), ("Default",))]
    passes = [p for t in (plain or techniques)[:1] for p in t.all("pass")]
    passes = [p for p in passes if p.words("polygon_mode") in ((), ("solid",))] or passes
    opaque = [p for p in passes if p.words("scene_blend") in ((), ("replace",), ("one", "zero"))]
    return (opaque[-1:] or passes[:1] or [Block("pass")])[0]


def _blends(seen: Block) -> bool:
    through = (("alpha_blend",), ("src_alpha", "one_minus_src_alpha"))
    rejects = seen.words("alpha_rejection")[:1] not in ((), ("always_pass",))
    return seen.words("scene_blend") in through or rejects


def _is_alias(line: Sequence[str]) -> bool:
    return line[0] == "set_texture_alias" and len(line) > 2


def _manual(unit: Block, key: str, count: int) -> Tuple[float, ...]:
    """Return the numbers that an operation of a texture unit sets by hand; none if it does not."""
    words = unit.words(key)
    found = _finite(words[3:]) if words[:2] == ("source1", "src_manual") else ()
    return found if len(found) == count else ()


def _finite(words: Iterable[str]) -> Tuple[float, ...]:
    """Return the numbers that words say; none where one of them says none."""
    try:
        found = tuple(float(word) for word in words)
    except ValueError:
        return ()
    return found if all(map(math.isfinite, found)) else ()


def _clipped(colour: Sequence[float]) -> Colour:
    return tuple(min(max(part, 0.0), 1.0) for part in colour)


def _times(one: Sequence[float], other: Sequence[float]) -> Tuple[float, ...]:
    return tuple(a * b for a, b in zip(one, other))
