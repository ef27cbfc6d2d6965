"""OGRE's scripts, with what real ones have in them."""

import pytest

from bullet_lab.simulation.world.ogre_script import (
    ScriptError,
    inherited,
    parse_script,
    substituted,
)

NESTED = """
// A wall, /* not here */
import * from "base.material"
set $file wall.png
material Lab/Wall : Lab/Base, Lab::Other
{ /* braces in
     comments { */
  receive_shadows on
  technique
  {

    pass first { ambient 0 0 1
      ambient 1 0 0 // red, the last of two lines
      diffuse "0 1 0"
      texture_unit base { texture "a wall.png" 2d }
    }
    pass
    {
      texture_unit {
        texture model://things/b.png
      }
    }
  }
}
abstract material Lab/Base{
technique{
pass{
lighting off
}}}
"""


def blocks(text):
    root, mistake = parse_script(text)
    assert mistake == ""
    return {block.name: block for block in root.blocks}


def whole(text, name):
    known = blocks(text)
    return substituted(inherited(known[name], lambda _, other: known.get(other)))


def test_blocks_properties_comments_and_quotes():
    root, mistake = parse_script(NESTED)
    assert mistake == ""
    assert root.properties == [("import", "*", "from", "base.material")]
    assert root.variables == {"file": "wall.png"}
    wall, base = root.blocks
    assert (wall.kind, wall.name, wall.parents) == (
        "material",
        "Lab/Wall",
        ("Lab/Base", "Lab::Other"),
    )
    assert wall.words("receive_shadows") == ("on",)
    (technique,) = wall.all("technique")
    first, second = technique.all("pass")
    assert (first.name, first.words("ambient"), first.words("diffuse")) == (
        "first",
        ("1", "0", "0"),
        ("0", "1", "0"),
    )
    assert first.blocks[0].properties == [("texture", "a wall.png", "2d")]
    assert second.blocks[0].words("texture") == ("model://things/b.png",)
    assert (base.kind, base.name, base.parents) == ("material", "Lab/Base", ())
    assert base.blocks[0].blocks[0].words("lighting") == ("off",)


LAYERS = """
material Base { technique { pass one { ambient 1 0 0
      diffuse 1 0 0 }
    pass two { emissive 0 0 1
      texture_unit { texture a.png
        scale 2 2 } } } }
material ByName : Base { technique { pass two { texture_unit { texture b.png } } } }
material ByPlace : Base { technique { pass { ambient 0 1 0 } pass { texture_unit { scale 3 3 } } } }
material ByPattern : Base { technique { pass t* { emissive 0 1 1 } } }
material New : Base { technique { pass three { diffuse 0 0 0 } } }
material Deep : ByName { technique { pass two { emissive 1 1 1 } } }
"""


@pytest.mark.parametrize(
    ("name", "key", "words"),
    [
        ("ByName", "diffuse", ["1 0 0", ""]),
        ("ByName", "emissive", ["", "0 0 1"]),
        ("ByName", "texture", ["", "b.png"]),
        ("ByName", "scale", ["", "2 2"]),
        ("ByPlace", "ambient", ["0 1 0", ""]),
        ("ByPlace", "diffuse", ["1 0 0", ""]),
        ("ByPlace", "scale", ["", "3 3"]),
        ("ByPattern", "emissive", ["", "0 1 1"]),
        ("New", "diffuse", ["1 0 0", "", "0 0 0"]),
        ("Deep", "emissive", ["", "1 1 1"]),
        ("Deep", "texture", ["", "b.png"]),
    ],
)
def test_children_go_over_the_blocks_of_their_parents(name, key, words):
    passes = whole(LAYERS, name).blocks[0].all("pass")
    assert [block.name for block in passes] == ["one", "two", "three"][: len(words)]
    found = [(block, *block.all("texture_unit")) for block in passes]
    assert ["".join(" ".join(part.words(key)) for part in parts) for parts in found] == words


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
