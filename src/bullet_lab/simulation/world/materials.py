"""Find materials by name: in OGRE's scripts, which worlds point to, and among Gazebo's own.

As in OGRE, the scripts and pictures that one model names are known to the models after it in a
document, and pictures are found by the bare names of their files. Of a material with several
passes, the last one that is not transparent is shown. Shader programs are not run. A missing
material or picture is reported once.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Sequence, Set, Tuple
from xml.etree.ElementTree import Element

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import WHITE, Appearance, Colour, Material, Texture
from bullet_lab.simulation.world.gazebo_materials import GazeboMaterial, gazebo_material
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
    colour,
    file_bytes,
)

# The limit for a folder that is searched for scripts or pictures.
MOST_FILES = 20_000
# Gazebo's own scripts; documents name them beside others.
GAZEBO_MEDIA = "file://media/materials/"
UNNAMED = ("", "__default__")

# What a document calls a script, and where it is.
Script = Tuple[str, Path]
# The blocks of a script by kind and name.
Blocks = Dict[Tuple[str, str], Block]


class MaterialLibrary:
    """The materials that a document may name."""

    def __init__(self) -> None:
        self._report = ReportOnce()
        self._read: Dict[Path, Blocks] = {}
        # The folders with scripts and pictures, in the order in which they were named.
        self._folders: List[Path] = []
        self._files: Dict[Path, Dict[str, Path]] = {}
        # Names and URIs that were reported as missing.
        self._missing: Set[str] = set()

    def of_element(
        self, element: Optional[Element], source: str, finder: ResourceFinder, default: Colour
    ) -> Appearance:
        """Return the meaning of an SDF `<material>`; `default` is the colour without one."""
        if element is None:
            return default, Material()
        tag = ElementReader(element, source)
        name = tag.text("script/name", tag.text("script", element.get("script", "")))
        found, shown, look = None, default, Material()
        if name not in UNNAMED:
            scripts = tuple(self._scripts(element, source, finder))
            found = self.named(name, source, scripts)
            # An unknown material is written again when the world is saved.
            shown, look = found or (default, Material(name=name, scripts=scripts))
        diffuse, ambient = self._colour(tag, "diffuse"), self._colour(tag, "ambient")
        emissive = self._colour(tag, "emissive")
        fields: Dict[str, Any] = {**vars(look), "covers": bool(found or diffuse or ambient)}
        if ambient is not None and (found or diffuse):
            fields["ambient"] = ambient
        if emissive is not None:
            fields["emissive"] = emissive
        if tag.text("lighting") in ("0", "false"):
            fields["lit"] = False
        # The ambient colour replaces a missing diffuse one.
        return diffuse or (shown if found else ambient or shown), Material(**fields)

    def named(self, name: str, source: str, scripts: Sequence[Script] = ()) -> Optional[Appearance]:
        """Return the meaning of a name; report an unknown one and return None.

        `scripts` are the folders or files with its script and its pictures.
        """
        folders = [path if os.path.isdir(path) else path.parent for _, path in scripts]
        self._folders += [folder for folder in folders if folder not in self._folders]
        places = [*(path for _, path in scripts), *self._folders]
        block, folder = self._block("material", name, places)
        known = gazebo_material(name)
        if block is None and known is not None:
            return self._gazebo_look(name, known)
        if block is None:
            media = gazebo_media_folders()
            places = [path for folder in media for path in sorted(folder.glob("*.material"))]
            block, folder = self._block("material", name, places)
        if block is not None:
            return self._look(name, block, [*folders, folder], scripts)
        if name not in self._missing:
            self._missing.add(name)
            what = "is in none of the named scripts; the default is drawn"
            self._report(f"{source}: material '{name}' {what}")
        return None

    def _colour(self, tag: ElementReader, key: str) -> Optional[Colour]:
        text = tag.text(key)
        try:
            return _clipped(colour(text, tag.where(key))) if text else None
        except XmlError as error:
            self._report(f"{error}; ignored")
            return None

    def _scripts(self, element: Element, source: str, finder: ResourceFinder) -> Iterator[Script]:
        """Yield the scripts and folders that a `<material>` names."""
        for uri in ((found.text or "").strip() for found in element.findall("script/uri")):
            if uri in UNNAMED or uri.startswith(GAZEBO_MEDIA):
                continue
            try:
                yield uri, finder.find(uri)
            except ResourceError as error:
                if uri not in self._missing:
                    self._missing.add(uri)
                    self._report(f"{source}: <script>: {error}")

    def _block(self, kind: str, name: str, places: Iterable[Path]) -> Tuple[Optional[Block], Path]:
        """Return a block of a script in one of the places, and the folder of that script."""
        for place in places:
            files = [place] if os.path.isfile(place) else self._index(place).values()
            for path in files:
                if path == place or path.suffix == ".material":
                    block = self._blocks(path).get((kind, name))
                    if block is not None:
                        return block, path.parent
        return None, Path()

    def _blocks(self, path: Path) -> Blocks:
        """Return the blocks of a script, with those of the scripts that it imports."""
        if path in self._read:
            return self._read[path]
        found = self._read[path] = {}
        try:
            text = file_bytes(path, MAXIMUM_BYTES).decode("utf-8", errors="replace")
        except LabError as error:
            self._report(f"{error}; its materials are ignored")
            return found
        root, mistake = parse_script(text)
        if mistake:
            self._report(f"{path}: {mistake}; the rest is ignored")
        for line in root.properties:
            if line[0] == "import" and "from" in line[:-1]:
                other = self._file(line[-1], [path.parent])
                if other is None:
                    self._report(f"{path}: import: '{line[-1]}' not found")
                else:
                    found.update(self._blocks(other))
        for block in root.blocks:
            # The first block of a name counts.
            found.setdefault((block.kind, block.name), block)
        return found

    def _look(
        self, name: str, block: Block, folders: Sequence[Path], scripts: Sequence[Script]
    ) -> Appearance:
        """Return the look of a material in a script in the last of the folders."""
        where = f"material '{name}' in {folders[-1]}"
        places = [folders[-1], *self._folders]
        try:
            whole = substituted(inherited(block, lambda kind, n: self._block(kind, n, places)[0]))
        except ScriptError as error:
            self._report(f"{where}: {error}; drawn without it")
            whole = substituted(block)
        shown = _shown_pass(whole)
        if shown.all("vertex_program_ref") or shown.all("fragment_program_ref"):
            self._report(f"{where}: its shader programs are ignored")
        blends = _blends(shown)
        diffuse = self._numbers(shown, where, "diffuse") or WHITE
        ambient = self._numbers(shown, where, "ambient") or WHITE
        emissive = self._numbers(shown, where, "emissive", "self_illumination")
        lit = shown.words("lighting") != ("off",)
        (*rgb, alpha) = diffuse if lit else (1.0, 1.0, 1.0, diffuse[3])
        aliases = {
            line[1]: line[2]
            for line in whole.properties
            if line[0] == "set_texture_alias" and len(line) > 2
        }
        texture = None
        for unit in shown.all("texture_unit"):
            manual = _manual(unit, "colour_op_ex", 3)
            if manual:
                rgb, lit = manual, False
            (alpha,) = _manual(unit, "alpha_op_ex", 1) or (alpha,)
            texture = texture or self._texture(unit, aliases, folders, where, blends)
        emissive = emissive or Material.emissive
        material = Material(ambient, emissive, texture, lit, True, name, tuple(scripts))
        return _clipped((*rgb, alpha if blends else 1.0)), material

    def _numbers(self, block: Block, where: str, *keys: str) -> Optional[Colour]:
        """Return the colour in a line of a block; its alpha is 1 by default."""
        words = block.words(*keys)
        if not words or words == ("vertexcolour",):
            return None
        found = _finite(words)
        if len(found) not in (3, 4):
            self._report(f"{where}: {keys[0]} '{' '.join(words)[:80]}' is not a colour")
            return None
        return _clipped((*found, 1.0)[:4])

    def _texture(
        self,
        unit: Block,
        aliases: Mapping[str, str],
        folders: Sequence[Path],
        where: str,
        blends: bool,
    ) -> Optional[Texture]:
        """Return the picture of a texture unit."""
        lines = [line for line in unit.properties if line[0] == "texture" and len(line) > 1]
        alias = " ".join(unit.words("texture_alias")) or unit.name
        file = aliases.get(alias, lines[-1][1] if lines else "")
        if not file:
            return None
        path = self._file(file, folders)
        if path is None:
            self._report(f"{where}: picture '{file}' not found; drawn without it")
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
            # One word is for minification, magnification and mipmaps; of three, the second counts.
            (unit.words("filtering") * 3)[1:2] in (("none",), ("point",)),
        )

    def _gazebo_look(self, name: str, known: GazeboMaterial) -> Appearance:
        texture, diffuse, ambient = None, known.diffuse, known.ambient
        if known.picture:
            path = self._file(known.picture, ())
            if path is None:
                what = f"Gazebo's {known.picture} not found; a plain colour is drawn"
                self._report(f"material '{name}': {what}")
                ambient = _times(known.plain, ambient or diffuse)
                diffuse = _times(known.plain, diffuse)
            else:
                texture = Texture(path, known.scale)
        ambient = None if ambient is None else (*ambient, 1.0)
        rest = Material(ambient, (*known.emissive, 1.0), texture, known.lit, True, name)
        return (*diffuse, known.alpha), rest

    def _file(self, name: str, folders: Sequence[Path]) -> Optional[Path]:
        """Return a file that a script names, where OGRE would look for it.

        These are the given folders, the `textures` beside them, and all folders named so far, each
        by the path in it or by the bare name below it; then Gazebo's media.
        """
        bare = os.path.basename(name)
        beside = [folder.parent / "textures" for folder in folders]
        for folder in (*folders, *beside, *self._folders):
            path = folder / name
            if os.path.isfile(path) and is_below(path, folder):
                return path
            if bare in self._index(folder):
                return self._index(folder)[bare]
        media = (folder / bare for folder in gazebo_media_folders())
        return next((path for path in media if os.path.isfile(path)), None)

    def _index(self, folder: Path) -> Dict[str, Path]:
        """Return the files in and below a folder by their bare names; upper ones come first."""
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
                    self._report(f"{folder}: has over {MOST_FILES} files; the rest is ignored")
                    break
            self._files[folder] = found
        return self._files[folder]


def _shown_pass(material: Block) -> Block:
    """Return the last pass that is not transparent; without any, the first pass."""
    techniques = material.all("technique")
    plain = [t for t in techniques if t.words("scheme") in ((), ("Default",))]
    passes = [p for t in (plain or techniques)[:1] for p in t.all("pass")]
    passes = [p for p in passes if p.words("polygon_mode") in ((), ("solid",))] or passes
    opaque = [p for p in passes if p.words("scene_blend") in ((), ("replace",), ("one", "zero"))]
    return (opaque[-1:] or passes[:1] or [Block("pass")])[0]


def _blends(shown: Block) -> bool:
    blending = (("alpha_blend",), ("src_alpha", "one_minus_src_alpha"))
    rejects = shown.words("alpha_rejection")[:1] not in ((), ("always_pass",))
    return shown.words("scene_blend") in blending or rejects


def _manual(unit: Block, key: str, count: int) -> Tuple[float, ...]:
    """Return the numbers that an operation of a texture unit sets; empty if it sets none."""
    words = unit.words(key)
    found = _finite(words[3:]) if words[:2] == ("source1", "src_manual") else ()
    return found if len(found) == count else ()


def _finite(words: Iterable[str]) -> Tuple[float, ...]:
    """Return the numbers in words; empty if one of them is not a finite number."""
    try:
        found = tuple(float(word) for word in words)
    except ValueError:
        return ()
    return found if all(map(math.isfinite, found)) else ()


def _clipped(values: Sequence[float]) -> Colour:
    return tuple(min(max(value, 0.0), 1.0) for value in values)


def _times(one: Sequence[float], other: Sequence[float]) -> Tuple[float, ...]:
    return tuple(a * b for a, b in zip(one, other))
