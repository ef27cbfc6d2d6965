"""Find materials by name: in OGRE's scripts, which worlds point to, and among Gazebo's own.

As in OGRE, the scripts and pictures that one model names are known to the models after it in a
document, and pictures are found by the bare names of their files. Of a material with several
passes, the last one that is not transparent is shown. Shader programs are not run. A missing
material or picture is reported once.
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Dict, Iterable, Iterator, Mapping, Sequence, Tuple

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import (
    BLACK,
    WHITE,
    Appearance,
    Colour,
    Material,
    Texture,
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
    file_bytes,
)

# The limit for a folder that is searched for scripts or pictures.
MOST_FILES = 20_000
# Gazebo's own scripts; documents name them beside others.
GAZEBO_MEDIA = "file://media/materials/"
UNNAMED = ("", "__default__")

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
# The same, with a picture, and the mean colour that replaces a missing one.
PICTURED = """
Bricks        | 1 1 1       | 1 1 1       | - | 1 | yes | bricks.png         | 0.55 0.32 0.25
BuildingFrame | 1 1 1       | 1 1 1       | - | 1 | yes | building_frame.png | 0.6 0.6 0.6
CeilingTiled  | 1 1 1       | 0.5 0.5 0.5 | - | 1 | yes | ceiling_tiled.jpg  | 0.8 0.8 0.78
CoM           | 1 1 1       | 0.5 0.5 0.5 | - | 1 | yes | com.png            | 0.9 0.9 0.9
Footway       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | sidewalk.jpg       | 0.4 0.4 0.4
Grass         | 1 1 1       | 0.5 0.5 0.5 | - | 1 | yes | grass.jpg          | 0.3 0.42 0.2
Lane_1        | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | secondary.jpg      | 0.4 0.4 0.4
Lanes_2       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | primary.jpg        | 0.4 0.4 0.4
Lanes_4       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | trunk.jpg          | 0.4 0.4 0.4
Lanes_6       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | motorway.jpg       | 0.4 0.4 0.4
Motorway      | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | motorway.jpg       | 0.4 0.4 0.4
PaintedWall   | 1 1 1       | 1 1 1       | - | 1 | yes | paintedWall.jpg    | 0.85 0.83 0.78
Pedestrian    | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | sidewalk.jpg       | 0.4 0.4 0.4
PioneerBody   | 1 0 0       | 0.5 0 0     | - | 1 | yes | pioneerBody.jpg    | 1 1 1
Primary       | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | primary.jpg        | 0.4 0.4 0.4
Residential   | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | residential.jpg    | 0.4 0.4 0.4
Road          | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | road1.jpg          | 0.4 0.4 0.4
Runway        | 1 1 1       | 0.5 0.5 0.5 | - | 1 | yes | runway.png         | 0.4 0.4 0.4
Secondary     | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | secondary.jpg      | 0.4 0.4 0.4
Steps         | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | steps.jpeg         | 0.4 0.4 0.4
Tertiary      | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | residential.jpg    | 0.4 0.4 0.4
Trunk         | 0.8 0.8 0.8 | 0.1 0.1 0.1 | - | 1 | yes | trunk.jpg          | 0.4 0.4 0.4
WindowFrame   | 1 1 1       | 1 1 1       | - | 1 | yes | window_frame.png   | 0.85 0.85 0.85
Wood          | 1 1 1       | 1 1 1       | - | 1 | yes | wood.jpg           | 0.6 0.45 0.3
WoodFloor     | 1 1 1       | 0.5 0.5 0.5 | - | 1 | yes | hardwood_floor.jpg | 0.6 0.43 0.27
WoodPallet    | 1 1 1       | 0.5 0.5 0.5 | - | 1 | yes | WoodPallet.png     | 0.65 0.52 0.36
"""
# Specular, with an exponent of 1, in Gazebo's scripts for these colours.
SHINE = 0.1
SHINY = ("Red", "Green", "Blue", "SkyBlue", "Purple", "Turquoise")
# The scale of pictures that are not to fill a side.
SCALES = {"Gazebo/Grass": (0.02, 0.02)}

# What a document calls a script, and where it is.
Script = Tuple[str, Path]
# The blocks of a script by kind and name.
Blocks = Dict[Tuple[str, str], Block]


def _rgba(text: str) -> Colour | None:
    return None if text == "-" else (*map(float, text.split()), 1.0)


def _gazebo_materials() -> dict[str, tuple[Colour, Material, str, Colour]]:
    """Return colour, look, picture and the colour without the picture of Gazebo's materials."""
    found = {}
    for line in (COLOURED + PICTURED).split("\n"):
        row = [word.strip() for word in line.split("|")]
        if len(row) > 1:
            name, diffuse, ambient, emissive, alpha, lit, picture, plain = (*row, "", "1 1 1")[:8]
            glow = _rgba(emissive) or BLACK
            shine = SHINE if name in SHINY else 0.0
            name, colour = f"Gazebo/{name}", (*_rgba(diffuse)[:3], float(alpha))
            lit = lit == "yes"
            look = Material(_rgba(ambient), glow, lit=lit, shine=shine, covers=True, name=name)
            found[name] = colour, look, picture, _rgba(plain)
    return found


GAZEBO_MATERIALS = _gazebo_materials()


class MaterialLibrary:
    """The materials that a document may name."""

    def __init__(self) -> None:
        self._report = ReportOnce()
        self._read: dict[Path, Blocks] = {}
        # The folders with scripts and pictures, in the order in which they were named.
        self._folders: list[Path] = []
        self._files: dict[Path, dict[str, Path]] = {}

    def of_tag(
        self, tag: ElementReader | None, finder: ResourceFinder, default: Colour
    ) -> Appearance:
        """Return the meaning of an SDF `<material>`; `default` is the colour without one."""
        if tag is None:
            return default, Material()
        name = tag.text("script/name", tag.text("script", tag.element.get("script", "")))
        found, shown, look = None, default, Material()
        if name not in UNNAMED:
            scripts = tuple(self._scripts(tag, finder))
            found = self.named(name, tag.source, scripts)
            # An unknown material is written again when the world is saved.
            shown, look = found or (default, Material(name=name, scripts=scripts))
        keys = ("diffuse", "ambient", "emissive")
        diffuse, ambient, emissive = (_clipped(tag.colour(key, ())) for key in keys)
        look = replace(
            look,
            ambient=ambient if ambient and (found or diffuse) else look.ambient,
            emissive=emissive or look.emissive,
            lit=look.lit and tag.text("lighting") not in ("0", "false"),
            covers=bool(found or diffuse or ambient),
        )
        # The ambient colour replaces a missing diffuse one.
        return diffuse or (shown if found else ambient or shown), look

    def named(self, name: str, source: str, scripts: Sequence[Script] = ()) -> Appearance | None:
        """Return the meaning of a name; report an unknown one and return None.

        `scripts` are the folders or files with its script and its pictures.
        """
        folders = [path if os.path.isdir(path) else path.parent for _, path in scripts]
        self._folders += [folder for folder in folders if folder not in self._folders]
        places = [*(path for _, path in scripts), *self._folders]
        block, folder = self._block("material", name, places)
        if block is None and name in GAZEBO_MATERIALS:
            return self._gazebo_look(name)
        if block is None:
            media = gazebo_media_folders()
            places = [path for folder in media for path in sorted(folder.glob("*.material"))]
            block, folder = self._block("material", name, places)
        if block is not None:
            return self._look(name, block, [*folders, folder], scripts)
        what = "is in none of the named scripts; the default is drawn"
        self._report(f"{source}: material '{name}' {what}", name)
        return None

    def _scripts(self, tag: ElementReader, finder: ResourceFinder) -> Iterator[Script]:
        """Yield the scripts and folders that a `<material>` names."""
        for uri in ((found.text or "").strip() for found in tag.element.findall("script/uri")):
            if uri in UNNAMED or uri.startswith(GAZEBO_MEDIA):
                continue
            try:
                yield uri, finder.find(uri)
            except ResourceError as error:
                self._report(f"{tag.source}: <script>: {error}", uri)

    def _block(self, kind: str, name: str, places: Iterable[Path]) -> tuple[Block | None, Path]:
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
        emissive = self._numbers(shown, where, "emissive", "self_illumination") or BLACK
        lit = shown.words("lighting") != ("off",)
        colour = (*(diffuse if lit else WHITE)[:3], diffuse[3] if blends else 1.0)
        aliases = {
            line[1]: line[2]
            for line in whole.properties
            if line[0] == "set_texture_alias" and len(line) > 2
        }
        texture = None
        for unit in shown.all("texture_unit"):
            texture = texture or self._texture(unit, aliases, folders, where, blends)
        return colour, Material(ambient, emissive, texture, lit, True, name, tuple(scripts))

    def _numbers(self, block: Block, where: str, *keys: str) -> Colour | None:
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
    ) -> Texture | None:
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

    def _gazebo_look(self, name: str) -> Appearance:
        colour, look, picture, plain = GAZEBO_MATERIALS[name]
        if not picture:
            return colour, look
        path = self._file(picture, ())
        if path is not None:
            return colour, replace(look, texture=Texture(path, SCALES.get(name, Texture.scale)))
        what = f"Gazebo's {picture} not found; a plain colour is drawn"
        self._report(f"material '{name}': {what}")
        return _times(plain, colour), replace(look, ambient=_times(plain, look.ambient))

    def _file(self, name: str, folders: Sequence[Path]) -> Path | None:
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

    def _index(self, folder: Path) -> dict[str, Path]:
        """Return the files in and below a folder by their bare names; upper ones come first."""
        if folder not in self._files:
            found: dict[str, Path] = {}
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
    passes = [p for technique in material.all("technique")[:1] for p in technique.all("pass")]
    opaque = [p for p in passes if p.words("scene_blend") in ((), ("replace",), ("one", "zero"))]
    return (opaque[-1:] or passes[:1] or [Block("pass")])[0]


def _blends(shown: Block) -> bool:
    blending = (("alpha_blend",), ("src_alpha", "one_minus_src_alpha"))
    rejects = shown.words("alpha_rejection")[:1] not in ((), ("always_pass",))
    return shown.words("scene_blend") in blending or rejects


def _finite(words: Iterable[str]) -> tuple[float, ...]:
    """Return the numbers in words; empty if one of them is not a finite number."""
    try:
        found = tuple(float(word) for word in words)
    except ValueError:
        return ()
    return found if all(map(math.isfinite, found)) else ()


def _clipped(values: Sequence[float]) -> Colour:
    return tuple(min(max(value, 0.0), 1.0) for value in values)


def _times(one: Sequence[float], other: Sequence[float]) -> tuple[float, ...]:
    return tuple(a * b for a, b in zip(one, other))
