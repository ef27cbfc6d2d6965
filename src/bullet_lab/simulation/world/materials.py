"""Find materials by name: in OGRE's scripts, which worlds point to, and in our script of Gazebo's.

As in OGRE, the scripts and pictures that one model names are known to the models after it in a
document, and pictures are found by the bare names of their files. Of a material with several
passes, the last one that is not transparent is shown. If its picture is missing, the next technique
is drawn. Shader programs are not run. A missing material or picture is reported once.

The language of the scripts has nested blocks, comments, variables that are valid in a block and
below it, and inheritance: a block overrides the blocks that it names after a colon.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path
from typing import Callable, Dict, Iterable, Iterator, Mapping, Sequence, Tuple

from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import (
    BLACK,
    WHITE,
    Appearance,
    Colour,
    Material,
    Texture,
)
from bullet_lab.simulation.world.resources import (
    ResourceError,
    ResourceFinder,
    gazebo_media_folders,
    is_below,
    package_share,
)
from bullet_lab.simulation.world.xml import (
    MAXIMUM_BYTES,
    ElementReader,
    ReportOnce,
    file_bytes,
    finite,
)

# The limit for a folder that is searched for scripts or pictures.
MOST_FILES = 20_000
# Gazebo's own scripts; documents name them beside others.
GAZEBO_MEDIA = "file://media/materials/"
# What we draw of these, in this package.
GAZEBO_SCRIPT = Path("config") / "gazebo.material"
UNNAMED = ("", "__default__")

# The limit of nested blocks; real scripts have four levels.
DEEPEST = 20
TOKEN = re.compile(
    r"""(?://[^\n]*|/\*.*?(?:\*/|\Z))        # comments
    | "(?P<quoted>[^"\n]*)"?                 # words, with blanks or without
    | (?P<sign>[{}\n])                       # the slashes of a URI are no comment
    | (?P<word>(?:(?<=:)//|(?!//|/\*)[^\s{}"])+)""",
    re.VERBOSE | re.DOTALL,
)
# Between a name and its parents; not in a name such as Lab::Wall.
COLON = re.compile(r"(?<!:)(:)(?![:/])")


class ScriptError(LabError):
    """A script that OGRE cannot read."""


@dataclass(frozen=True)
class Block:
    """The content of a pair of braces.

    Attributes:
        kind: its first word: material, technique, pass, texture_unit.
        name: empty without one.
        parents: names of the blocks that it inherits from.
        properties: the words of each line.
        blocks: the blocks in it.
        variables: the values that it sets, by names without the "$".
        outer: variables of its file.
    """

    kind: str = ""
    name: str = ""
    parents: tuple[str, ...] = ()
    properties: list[tuple[str, ...]] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
    variables: dict[str, str] = field(default_factory=dict)
    outer: Mapping[str, str] = field(default_factory=dict)

    def all(self, kind: str) -> list[Block]:
        """Return the blocks of a kind in it."""
        return [block for block in self.blocks if block.kind == kind]

    def words(self, *keys: str) -> tuple[str, ...]:
        """Return the words after the key in the last line that begins with one of the keys."""
        found = [line[1:] for line in self.properties if line[0] in keys]
        return tuple(" ".join(found[-1]).split()) if found else ()


def parse_script(text: str) -> tuple[Block, str]:
    """Return the blocks of a script up to its first mistake, and the mistake or an empty text."""
    stack, line = [Block()], []
    for number, sign, word in _tokens(text):
        if word is not None:
            line.append(word)
            continue
        if sign == "{":
            # The header may be on the line before.
            if not line and stack[-1].properties:
                line = list(stack[-1].properties.pop())
            stack.append(replace(_header(line), outer=stack[0].variables))
            if len(stack) > DEEPEST:
                return stack[0], f"line {number}: more than {DEEPEST} blocks in each other"
        else:
            _add_line(stack[-1], line)
            if sign == "}" and len(stack) == 1:
                return stack[0], f"line {number}: a '}}' that closes nothing"
            if sign == "}":
                block = stack.pop()
                stack[-1].blocks.append(block)
        line = []
    _add_line(stack[-1], line)
    open_ = stack[-1]
    return stack[0], f"'{open_.kind} {open_.name}' is not closed" if len(stack) > 1 else ""


def inherited(block: Block, find: Callable[[str, str], Block | None], below=()) -> Block:
    """Return a block with the content of its parents; `find` returns one by kind and name.

    Raises:
        ScriptError: a parent is missing, or inherits from the block.
    """
    made = Block(block.kind)
    for name in block.parents:
        parent = find(block.kind, name)
        if parent is None or name in (*below, block.name):
            why = "is missing" if parent is None else "inherits from it"
            raise ScriptError(f"{block.kind} '{block.name}': its parent '{name}' {why}")
        made = _over(inherited(parent, find, (*below, block.name)), made)
    own = [inherited(inner, find, below) if inner.parents else inner for inner in block.blocks]
    return _over(replace(block, blocks=own, parents=()), made)


def substituted(block: Block, above: Mapping[str, str] | None = None) -> Block:
    """Return a block with variables, its own and those above it, replaced by their values."""
    values = {**block.outer, **(above or {}), **block.variables}
    words = [tuple(_value(word, values) for word in line) for line in block.properties]
    blocks = [substituted(inner, values) for inner in block.blocks]
    return replace(block, properties=words, blocks=blocks)


def _tokens(text: str) -> Iterator[tuple[int, str, str | None]]:
    """Yield line number, sign and word; one of the two is missing."""
    number = 1
    for found in TOKEN.finditer(text):
        word = found["word"] if found["quoted"] is None else found["quoted"]
        if word is not None or found["sign"]:
            yield number, found["sign"] or "", word
        number += found[0].count("\n")


def _header(words: list[str]) -> Block:
    parts = [part for word in words for part in COLON.split(word) if part]
    parts = parts[1:] if parts[:1] == ["abstract"] else parts
    end = parts.index(":") if ":" in parts else len(parts)
    kind, name = (*parts[:end], "", "")[:2]
    return Block(kind, name, tuple(part.strip(",") for part in parts[end + 1 :] if part != ","))


def _add_line(block: Block, words: list[str]) -> None:
    if words[:1] == ["set"] and len(words) > 2:
        block.variables[words[1].lstrip("$")] = " ".join(words[2:])
    elif words:
        block.properties.append(tuple(words))


def _over(upper: Block, lower: Block) -> Block:
    """Return a block whose content overrides that of another one of its kind."""
    blocks = list(lower.blocks)
    unnamed: Counter[str] = Counter()
    for block in upper.blocks:
        places = [n for n, other in enumerate(lower.blocks) if other.kind == block.kind]
        if block.name:
            places = [n for n in places if fnmatchcase(lower.blocks[n].name, block.name)]
        else:
            # Blocks without a name override those at the same place.
            places = places[unnamed[block.kind] :][:1]
            unnamed[block.kind] += 1
        for place in places:
            blocks[place] = _over(block, blocks[place])
        if not places:
            blocks.append(block)
    return replace(
        upper,
        name=lower.name if "*" in upper.name else upper.name or lower.name,
        properties=[*lower.properties, *upper.properties],
        blocks=blocks,
        variables={**lower.variables, **upper.variables},
        outer={**lower.outer, **upper.outer},
    )


def _value(word: str, values: Mapping[str, str]) -> str:
    for _ in range(DEEPEST):
        word = values.get(word[1:], word) if word.startswith("$") else word
    return word


# What a document calls a script, and where it is.
Script = Tuple[str, Path]
# The blocks of a script by kind and name.
Blocks = Dict[Tuple[str, str], Block]


class MaterialLibrary:
    """The materials that a document may name."""

    def __init__(self) -> None:
        self._report = ReportOnce()
        self._read: dict[Path, Blocks] = {}
        # The folders with scripts and pictures, in the order in which they were named.
        self._folders: list[Path] = []
        self._files: dict[Path, dict[str, Path]] = {}

    def of_tag(self, tag: ElementReader, finder: ResourceFinder, default: Colour) -> Appearance:
        """Return the meaning of an SDF `<material>`; `default` is the colour of an empty one."""
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
        own = (*(path for _, path in scripts), *self._folders, package_share() / GAZEBO_SCRIPT)
        media = (sorted(folder.glob("*.material")) for folder in gazebo_media_folders())
        block, folder = self._block("material", name, chain(own, chain.from_iterable(media)))
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
        aliases = {
            line[1]: line[2]
            for line in whole.properties
            if line[0] == "set_texture_alias" and len(line) > 2
        }
        shown, texture = Block("pass"), None
        for technique in whole.all("technique"):
            shown = _shown_pass(technique)
            try:
                texture = self._texture(shown, aliases, folders)
                break
            except ResourceError as error:
                self._report(f"{where}: {error}; drawn without it")
        if shown.all("vertex_program_ref") or shown.all("fragment_program_ref"):
            self._report(f"{where}: its shader programs are ignored")
        diffuse = self._numbers(shown, where, "diffuse") or WHITE
        ambient = self._numbers(shown, where, "ambient") or WHITE
        emissive = self._numbers(shown, where, "emissive", "self_illumination") or BLACK
        lit = shown.words("lighting") != ("off",)
        rgb = (diffuse if lit else _manual_colour(shown))[:3]
        colour = (*rgb, diffuse[3] if _blends(shown) else 1.0)
        # Of highlights, only wide ones are drawn: those with an exponent of 1.
        specular = finite(shown.words("specular"))
        shine = specular[0] if specular[-1:] == (1.0,) else 0.0
        return colour, Material(ambient, emissive, texture, lit, True, name, tuple(scripts), shine)

    def _numbers(self, block: Block, where: str, *keys: str) -> Colour | None:
        """Return the colour in a line of a block; its alpha is 1 by default."""
        words = block.words(*keys)
        if not words or words == ("vertexcolour",):
            return None
        found = finite(words)
        if len(found) not in (3, 4):
            self._report(f"{where}: {keys[0]} '{' '.join(words)[:80]}' is not a colour")
            return None
        return _clipped((*found, 1.0)[:4])

    def _texture(
        self, shown: Block, aliases: Mapping[str, str], folders: Sequence[Path]
    ) -> Texture | None:
        """Return the first picture of a pass; raises ResourceError if it is missing."""
        for unit in shown.all("texture_unit"):
            lines = [line for line in unit.properties if line[0] == "texture" and len(line) > 1]
            alias = " ".join(unit.words("texture_alias")) or unit.name
            file = aliases.get(alias, lines[-1][1] if lines else "")
            if file:
                path = self._file(file, folders)
                if path is None:
                    raise ResourceError(f"picture '{file}' not found")
                return _placed(unit, path, _blends(shown))
        return None

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


def _shown_pass(technique: Block) -> Block:
    """Return the last pass that is not transparent; without any, the first pass."""
    passes = technique.all("pass")
    opaque = [p for p in passes if p.words("scene_blend") in ((), ("replace",), ("one", "zero"))]
    return (opaque[-1:] or passes[:1] or [Block("pass")])[0]


def _placed(unit: Block, path: Path, blends: bool) -> Texture:
    """Return a picture as a texture unit places it."""
    scale = finite(unit.words("scale"))
    turn = finite(unit.words("rotate"))
    return Texture(
        path,
        scale if len(scale) == 2 and all(scale) else Texture.scale,
        (*finite(unit.words("scroll")), 0.0, 0.0)[:2],
        math.radians(turn[0]) if turn else 0.0,
        unit.words("tex_address_mode")[:1] not in (("clamp",), ("border",)),
        blends,
        # One word is for minification, magnification and mipmaps; of three, the second counts.
        (unit.words("filtering") * 3)[1:2] in (("none",), ("point",)),
    )


def _manual_colour(shown: Block) -> Colour:
    """Return the colour that the texture units of a pass without light give; white by default."""
    for unit in shown.all("texture_unit"):
        operation, source, _, *words = (*unit.words("colour_op_ex"), "", "", "")
        if (operation, source) == ("source1", "src_manual"):
            return finite(words[:3]) or WHITE
    return WHITE


def _blends(shown: Block) -> bool:
    blending = (("alpha_blend",), ("src_alpha", "one_minus_src_alpha"))
    rejects = shown.words("alpha_rejection")[:1] not in ((), ("always_pass",))
    return shown.words("scene_blend") in blending or rejects


def _clipped(values: Sequence[float]) -> Colour:
    return tuple(min(max(value, 0.0), 1.0) for value in values)
