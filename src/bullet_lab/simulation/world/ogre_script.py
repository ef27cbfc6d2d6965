"""Read OGRE's scripts, in which Gazebo's materials are written, as nested blocks.

The language has comments, variables that are valid in a block and below it, and inheritance: a
block overrides the blocks that it names after a colon. `materials` interprets the blocks.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Callable, Iterator, Mapping

from bullet_lab.errors import LabError

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
    counts: dict[str, int] = {}
    for block in upper.blocks:
        places = [n for n, other in enumerate(lower.blocks) if other.kind == block.kind]
        if block.name:
            places = [n for n in places if fnmatchcase(lower.blocks[n].name, block.name)]
        else:
            # Blocks without a name override those at the same place.
            count = counts.setdefault(block.kind, 0)
            counts[block.kind] += 1
            places = places[count : count + 1]
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
    seen = 0
    while word.startswith("$") and word[1:] in values and seen < DEEPEST:
        word, seen = values[word[1:]], seen + 1
    return word
