"""Reading OGRE's scripts, which Gazebo's materials are written in: blocks within blocks.

Their language has comments, variables that hold in a block and all below it, and blocks that
inherit: what they say goes over what those say that they name after a colon, block by block.
What any of it means is `materials`' business.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Callable, Dict, Iterator, List, Mapping, Optional, Tuple

from bullet_lab.errors import LabError

# Blocks within blocks; real ones have four.
DEEPEST = 20
TOKEN = re.compile(
    r"""(?://[^\n]*|/\*.*?(?:\*/|\Z))        # comments
    | "(?P<quoted>[^"\n]*)"?                 # words, with blanks in them or without; the slashes
    | (?P<sign>[{}\n])                       # of a URI are no comment
    | (?P<word>(?:(?<=:)//|(?!//|/\*)[^\s{}"])+)""",
    re.VERBOSE | re.DOTALL,
)
# Between a name and what it inherits from; not in a name such as Lab::Wall.
COLON = re.compile(r"(?<!:)(:)(?![:/])")


class ScriptError(LabError):
    """A script that OGRE could not read, either."""


@dataclass(frozen=True)
class Block:
    """What stands between braces.

    Attributes:
        kind: its first word: material, technique, pass, texture_unit.
        name: of it, or nothing.
        parents: the names of the blocks that it inherits from.
        properties: the words of each line.
        blocks: that stand in it.
        variables: that it sets, by names without the "$".
        outer: variables of its file.
    """

    kind: str = ""
    name: str = ""
    parents: Tuple[str, ...] = ()
    properties: List[Tuple[str, ...]] = field(default_factory=list)
    blocks: List[Block] = field(default_factory=list)
    variables: Dict[str, str] = field(default_factory=dict)
    outer: Mapping[str, str] = field(default_factory=dict)

    def all(self, kind: str) -> List[Block]:
        """Return the blocks of a kind in it."""
        return [block for block in self.blocks if block.kind == kind]

    def words(self, *keys: str) -> Tuple[str, ...]:
        """Return the words of the last line that begins with one of these, without that."""
        found = [line[1:] for line in self.properties if line[0] in keys]
        return tuple(" ".join(found[-1]).split()) if found else ()


def parse_script(text: str) -> Tuple[Block, str]:
    """Return what a script says, and what is wrong with it: nothing, or a line.

    What stands before a mistake counts.
    """
    stack, line = [Block()], []
    for number, sign, word in _tokens(text):
        if word is not None:
            line.append(word)
            continue
        if sign == "{":
            # The header may stand on a line before.
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


def inherited(block: Block, find: Callable[[str, str], Optional[Block]], below=()) -> Block:
    """Return a block with what it inherits; `find` gives another one by kind and name.

    Raises:
        ScriptError: there is no such block, or they inherit from each other in a circle.
    """
    made = Block(block.kind)
    for name in block.parents:
        parent = find(block.kind, name)
        if parent is None or name in (*below, block.name):
            why = "is not there" if parent is None else "inherits from it"
            raise ScriptError(f"{block.kind} '{block.name}': its parent '{name}' {why}")
        made = _over(inherited(parent, find, (*below, block.name)), made)
    own = [inherited(inner, find, below) if inner.parents else inner for inner in block.blocks]
    return _over(replace(block, blocks=own, parents=()), made)


def substituted(block: Block, above: Optional[Mapping[str, str]] = None) -> Block:
    """Return a block with the values of its variables, and of those above it, for their names."""
    values = {**block.outer, **(above or {}), **block.variables}
    words = [tuple(_value(word, values) for word in line) for line in block.properties]
    blocks = [substituted(inner, values) for inner in block.blocks]
    return replace(block, properties=words, blocks=blocks)


def _tokens(text: str) -> Iterator[Tuple[int, str, Optional[str]]]:
    """Yield the number of the line with a sign or a word."""
    number = 1
    for found in TOKEN.finditer(text):
        word = found["word"] if found["quoted"] is None else found["quoted"]
        if word is not None or found["sign"]:
            yield number, found["sign"] or "", word
        number += found[0].count("\n")


def _header(words: List[str]) -> Block:
    parts = [part for word in words for part in COLON.split(word) if part]
    parts = parts[1:] if parts[:1] == ["abstract"] else parts
    end = parts.index(":") if ":" in parts else len(parts)
    kind, name = (*parts[:end], "", "")[:2]
    return Block(kind, name, tuple(part.strip(",") for part in parts[end + 1 :] if part != ","))


def _add_line(block: Block, words: List[str]) -> None:
    if words[:1] == ["set"] and len(words) > 2:
        block.variables[words[1].lstrip("$")] = " ".join(words[2:])
    elif words:
        block.properties.append(tuple(words))


def _over(upper: Block, lower: Block) -> Block:
    """Return a block laid over another one of its kind."""
    blocks = list(lower.blocks)
    counts: Dict[str, int] = {}
    for block in upper.blocks:
        places = [n for n, other in enumerate(lower.blocks) if other.kind == block.kind]
        if block.name:
            places = [n for n in places if fnmatchcase(lower.blocks[n].name, block.name)]
        else:
            # Those without a name go over what stands at their place.
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
