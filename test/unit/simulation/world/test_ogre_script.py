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

    pass first { ambient 1 0 0 // red
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


def test_the_last_of_two_lines_counts():
    (block,) = blocks("pass p { ambient 1 0 0\n ambient 0 0 1\n }").values()
    assert block.words("ambient") == ("0", "0", "1")


VARIABLES = """
set $shade 0.5
abstract material Base
{
  set $file base.png
  set $shade 0.25
  technique { pass { diffuse $shade $shade $shade
    texture_unit { set $file2 $file
      texture $file2 } } }
}
material Plain : Base { }
material Own : Base { set $file own.png }
material Unset { technique { pass { diffuse $nothing } } }
"""


@pytest.mark.parametrize(("name", "file"), [("Plain", "base.png"), ("Own", "own.png")])
def test_variables_of_the_child_stand_for_those_of_its_parent(name, file):
    seen = whole(VARIABLES, name).blocks[0].blocks[0]
    assert seen.words("diffuse") == ("0.25",) * 3
    assert seen.blocks[0].words("texture") == (file,)


def test_a_variable_that_nobody_sets_stays():
    assert whole(VARIABLES, "Unset").blocks[0].blocks[0].words("diffuse") == ("$nothing",)


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


def passes(name):
    return whole(LAYERS, name).blocks[0].all("pass")


def test_children_go_over_the_blocks_of_their_parents():
    one, two = passes("ByName")
    assert one.words("diffuse") == ("1", "0", "0")
    assert two.words("emissive") == ("0", "0", "1")
    (unit,) = two.all("texture_unit")
    assert (unit.words("texture"), unit.words("scale")) == (("b.png",), ("2", "2"))
    one, two = passes("ByPlace")
    assert (one.name, one.words("ambient"), one.words("diffuse")) == (
        "one",
        ("0", "1", "0"),
        ("1", "0", "0"),
    )
    assert two.blocks[0].words("scale") == ("3", "3")
    assert [p.words("emissive") for p in passes("ByPattern")] == [(), ("0", "1", "1")]
    assert [p.name for p in passes("New")] == ["one", "two", "three"]
    assert passes("Deep")[1].words("emissive") == ("1", "1", "1")
    assert passes("Deep")[1].blocks[0].words("texture") == ("b.png",)


@pytest.mark.parametrize(
    ("text", "mistake", "kept"),
    [
        ("material A { }\nmaterial B {\n technique {", "'technique ' is not closed", ["A"]),
        ("material A { } }\nmaterial B { }", "line 1: a '}' that closes nothing", ["A"]),
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
