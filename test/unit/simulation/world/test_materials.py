"""Materials of OGRE's scripts, and Gazebo's own, as models name them."""

import logging
from pathlib import Path

import numpy as np
import pytest
from alike import assert_as_before, lines_of
from PIL import Image
from sensor_worlds import carrier
from shared import cases

from bullet_lab.simulation.world import materials, resources
from bullet_lab.simulation.world.description import Texture
from bullet_lab.simulation.world.materials import (
    ScriptError,
    inherited,
    parse_script,
    substituted,
)
from bullet_lab.simulation.world.sdf import read_spawned, read_world_file
from bullet_lab.simulation.world.urdf import read_urdf

SCRIPT = """
material Shop/Crate { technique { pass { diffuse 0.5 0.25 1 0.5
  texture_unit { texture crate.png } } } }
material Shop/Glass { technique { pass { scene_blend alpha_blend
  diffuse 0 0 1 0.25 } } }
material Shop/Plain { }
material Shop/Lost { technique { pass { texture_unit { texture lost.png } } } }
"""


@pytest.fixture
def shop(tmp_path, monkeypatch):
    """The folder of models with a script and a picture, as Gazebo's models have them."""
    model = tmp_path / "models" / "shop"
    for name in ("scripts", "textures"):
        (model / "materials" / name).mkdir(parents=True)
    (model / "model.config").write_text("<model><sdf>model.sdf</sdf></model>")
    (model / "materials" / "scripts" / "shop.material").write_text(SCRIPT)
    picture = model / "materials" / "textures" / "crate.png"
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(picture)
    models = tmp_path / "models"
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(models))
    monkeypatch.setattr(resources, "ros_package_folder", lambda name: models / name)
    return models


BOX = "<geometry><box><size>1 1 1</size></box></geometry>"
URIS = (
    "<uri>model://shop/materials/scripts</uri><uri>model://shop/materials/textures</uri>",
    "<uri>model://shop/materials/scripts/shop.material</uri>",
    "<uri>package://shop/materials/scripts</uri>",
)


def visual_of(material, shape=BOX, more=""):
    text = (
        "<sdf version='1.6'><model name='m'><static>1</static><link name='l'><visual name='v'>"
        f"{shape}<material>{material}</material>{more}</visual></link></model></sdf>"
    )
    (visual,) = read_spawned(text, "m.sdf").links[0].visuals
    return visual


def script(name, uris=URIS[0], more=""):
    return f"<script>{uris}<name>{name}</name></script>{more}"


@pytest.mark.parametrize("uris", URIS)
def test_colours_and_picture_of_a_script(shop, uris):
    """What else a script may say: see whole.material."""
    visual = visual_of(script("Shop/Crate", uris))
    # What is not blended is opaque, whatever its alpha.
    assert visual.colour == (0.5, 0.25, 1.0, 1.0)
    assert visual.material.name == "Shop/Crate"
    assert visual.material.texture == Texture(shop / "shop/materials/textures/crate.png")


def test_file_uris_and_uris_of_several_models(shop, tmp_path):
    other = shop / "other" / "materials" / "scripts"
    other.mkdir(parents=True)
    (other / "a.material").write_text("material Other/A { technique { pass { diffuse 0 1 0 } } }")
    uris = f"<uri>file://{other}</uri>{URIS[0]}"
    assert visual_of(script("Other/A", uris)).colour == (0, 1, 0, 1)
    assert visual_of(script("Shop/Crate", uris)).material.texture is not None


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (script("Shop/Lost"), "picture 'lost.png' not found"),
        (script("Gazebo/Wood"), "wood"),
    ],
)
def test_what_is_missing_is_said_once_and_the_rest_is_drawn(shop, material, message, caplog):
    visuals = "".join(
        f"<visual name='v{n}'>{BOX}<material>{material}</material></visual>" for n in range(3)
    )
    text = f"<sdf><model name='m'><link name='l'>{visuals}</link></model></sdf>"
    with caplog.at_level(logging.WARNING):
        model = read_spawned(text, "m.sdf")
    assert len(model.links[0].visuals) == 3
    (line,) = caplog.messages
    assert message in line


def test_imports_and_parents_in_other_files(shop, monkeypatch):
    media = shop / "share" / "media" / "materials" / "scripts"
    media.mkdir(parents=True)
    monkeypatch.setenv("GAZEBO_RESOURCE_PATH", str(shop / "share"))
    (media / "base.material").write_text(
        'import * from "use.material"\nmaterial Base/A { technique { pass { diffuse 0 1 1 } } }'
    )
    (shop / "shop" / "materials" / "scripts" / "use.material").write_text(
        'import Base/A from "base.material"\nmaterial Use/A : Base/A { }'
    )
    uri = "<uri>model://shop/materials/scripts/use.material</uri>"
    assert visual_of(script("Use/A", uri)).colour == (0, 1, 1, 1)


def test_a_huge_script_is_ignored(shop, monkeypatch, caplog):
    monkeypatch.setattr(materials, "MAXIMUM_BYTES", 10)
    assert visual_of(script("Shop/Plain")).colour == (0.7, 0.7, 0.7, 1)
    assert "larger than 10 bytes; its materials are ignored" in caplog.text


def test_files_of_a_folder_are_known_in_order_up_to_a_limit(shop, monkeypatch, caplog):
    textures, told = shop / "shop/materials/textures", []
    for name in "abcdefgh":
        (textures / name).mkdir()
        (textures / name / "lost.png").touch()
    # With the picture beside these folders, there are nine files.
    for most in (9, 8):
        monkeypatch.setattr(materials, "MOST_FILES", most)
        assert visual_of(script("Shop/Lost")).material.texture.path == textures / "a/lost.png"
        told.append(caplog.messages[:])
    assert told == [[], [f"{textures}: has over 8 files; the rest is ignored"]]


def test_pictures_never_lie_outside_of_the_folders(shop, tmp_path, caplog):
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "secret.png")
    textures = shop / "shop" / "materials" / "textures"
    (textures / "link.png").symlink_to(tmp_path / "secret.png")
    for name in ("link.png", "../../../../secret.png", str(tmp_path / "secret.png")):
        path = shop / "shop" / "materials" / "scripts" / "s.material"
        path.write_text(
            f'material S {{ technique {{ pass {{ texture_unit {{ texture "{name}"\n}}}}}}}}'
        )
        assert visual_of(script("S")).material.texture is None
    assert caplog.text.count("not found; drawn without it") == 3


WORLD = """<sdf version="1.6"><world name="w">
  <include><uri>model://shop</uri></include>
  <model name="m"><static>1</static><link name="l"><visual name="v">{}
    <material><script><name>Shop/Glass</name></script></material></visual></link></model>
</world></sdf>"""


def test_what_one_model_declares_the_next_ones_know(shop, tmp_path):
    (shop / "shop" / "model.sdf").write_text(
        "<sdf version='1.6'><model name='shop'><static>1</static><link name='l'><visual name='v'>"
        f"{BOX}<material>{script('Shop/Crate')}</material></visual></link></model></sdf>"
    )
    (tmp_path / "w.world").write_text(WORLD.format(BOX))
    crate, glass = read_world_file(tmp_path / "w.world").models
    assert crate.links[0].visuals[0].material.texture is not None
    assert glass.links[0].visuals[0].colour == (0, 0, 1, 0.25)


@cases("""
scripts, textures:
  - [media/materials/scripts, media/materials/textures]
  - [Media/materials/scripts, Media/materials/textures]
  - [., .]
""")
def test_gazebos_media_folders(scripts, textures, shop, tmp_path, monkeypatch):
    share = tmp_path / "share"
    for name in (scripts, textures):
        (share / name).mkdir(parents=True, exist_ok=True)
    (share / scripts / "mine.material").write_text(
        "material Mine { technique { pass { texture_unit { texture wood.jpg } } } }"
    )
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(share / textures / "wood.jpg")
    monkeypatch.setenv("GAZEBO_RESOURCE_PATH", f"{tmp_path / 'gone'}:{tmp_path / 'share'}")
    for name in ("Mine", "Gazebo/Wood"):
        texture = visual_of(script(name, "")).material.texture
        assert texture.path == share / textures / "wood.jpg"
        robot = tagged(f"<material>{name}</material>")
        assert robot.links[0].visuals[0].material.texture == texture


def tagged(tags, visual="<visual><geometry><box size='1 1 1'/></geometry></visual>"):
    return carrier(f"<gazebo reference='base'>{tags}</gazebo>", collision=visual)


def test_a_material_as_in_sdf_for_a_link_of_a_urdf(shop):
    text = (
        "<robot name='r'><link name='base'><visual><geometry><box size='1 1 1'/></geometry>"
        "<material name='m'><color rgba='1 0 0 1'/></material></visual></link>"
        f"<gazebo reference='base'><visual><material>{script('Shop/Crate')}</material></visual>"
        "</gazebo></robot>"
    )
    (visual,) = read_urdf(text, "r.urdf").links[0].visuals
    assert visual.colour == (0.5, 0.25, 1.0, 1.0)
    assert visual.material.texture is not None
    colours = "<visual><material><diffuse>0 1 0 1</diffuse></material></visual>"
    assert tagged(colours).links[0].visuals[0].colour == (0, 1, 0, 1)
    nothing = "<visual><material><specular>0 1 0 1</specular></material></visual>"
    assert tagged(nothing).links[0].visuals[0].colour == (1, 1, 1, 1)


# The language of the scripts, with what real ones have in them

HERE = Path(__file__).parent
CHILDREN = "ByName", "ByPlace", "ByPattern", "New", "Deep", "ThreePlaces"


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


@cases(r"""
text, mistake, kept:
  - ["material A { }\nmaterial B {\n technique {", "'technique ' is not closed", [A]]
  - ["\n\nmaterial A { } }\nmaterial B { }", "line 3: a '}' that closes nothing", [A]]
  - ["material A { }\na { a { a { a { a { a { a { a { a { a { a { a { a { a { a { a { a { a { a {
     } } } } } } } } } } } } } } } } } } }", '', [A, '']]
  - ["material A { }\n\na { a { a { a { a { a { a { a { a { a { a { a { a { a { a { a { a { a { a {
     a { } } } } } } } } } } } } } } } } } } } }", 'line 3: more than 20 blocks', [A]]
  - ["material A { technique { name \"open\n } }", '', [A]]
  - ['material A { /* open', "'material A' is not closed", []]
  - ['', '', []]
""")
def test_mistakes_are_said_and_what_was_before_them_counts(text, mistake, kept):
    root, found = parse_script(text)
    assert mistake in found
    assert bool(mistake) == bool(found)
    assert [block.name for block in root.blocks] == kept


@cases(r"""
text, message:
  - ["material A : B { }\nmaterial B : A { }", inherits from it]
  - ["material A : A { }", inherits from it]
  - ["material A : Gone { }", its parent 'Gone' is missing]
""")
def test_parents_that_cannot_be(text, message):
    with pytest.raises(ScriptError, match=message):
        whole(text, "A")
