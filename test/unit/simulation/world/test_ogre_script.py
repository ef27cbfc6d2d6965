"""OGRE's scripts, with what real ones have in them."""

from pathlib import Path

import pytest
from alike import assert_as_before, lines_of

from bullet_lab.simulation.world.materials import (
    ScriptError,
    inherited,
    parse_script,
    substituted,
)

HERE = Path(__file__).parent
CHILDREN = "ByName", "ByPlace", "ByPattern", "New", "Deep"


def blocks(text):
    root, mistake = parse_script(text)
    assert mistake == ""
    return {block.name: block for block in root.blocks}


def whole(text, name):
    known = blocks(text)
    return substituted(inherited(known[name], lambda _, other: known.get(other)))


def test_blocks_are_read_and_go_over_those_of_their_parents_as_before():
    text = (HERE / "scripts.material").read_text()
    root, mistake = parse_script(text)
    first, _ = root.blocks[0].blocks[0].blocks
    assert (first.words("ambient"), first.all("pass")) == (("1", "0", "0"), [])
    assert first.blocks[0].properties == [("texture", "a wall.png", "2d")]
    told = [*lines_of(root, "read"), f"mistake: {mistake}"]
    for name in CHILDREN:
        told += lines_of(whole(text, name), name)
    assert_as_before(told, HERE / "scripts.txt")


@pytest.mark.parametrize(
    ("text", "mistake", "kept"),
    [
        ("material A { }\nmaterial B {\n technique {", "'technique ' is not closed", ["A"]),
        ("\n\nmaterial A { } }\nmaterial B { }", "line 3: a '}' that closes nothing", ["A"]),
        ("material A { }\n" + "a {\n" * 30, "more than 20 blocks", ["A"]),
        ('material A { technique { name "open\n } }', "", ["A"]),
        ("material A { /* open", "'material A' is not closed", []),
        ("", "", []),
    ],
)
def test_mistakes_are_said_and_what_was_before_them_counts(text, mistake, kept):
    root, found = parse_script(text)
    assert mistake in found
    assert bool(mistake) == bool(found)
    assert [block.name for block in root.blocks] == kept


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("material A : B { }\nmaterial B : A { }", "inherits from it"),
        ("material A : A { }", "inherits from it"),
        ("material A : Gone { }", "its parent 'Gone' is missing"),
    ],
)
def test_parents_that_cannot_be(text, message):
    with pytest.raises(ScriptError, match=message):
        whole(text, "A")
