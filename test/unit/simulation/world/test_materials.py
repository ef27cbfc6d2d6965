"""Materials of OGRE's scripts, and Gazebo's own, as models name them."""

import logging
import math

import numpy as np
import pytest
from PIL import Image
from sensor_worlds import carrier

from bullet_lab.simulation.world import materials, resources
from bullet_lab.simulation.world.description import Texture
from bullet_lab.simulation.world.sdf import read_spawned, read_world_file
from bullet_lab.simulation.world.urdf import read_urdf

SCRIPT = """
material Shop/Crate : Shop/Base
{
  technique { pass { diffuse 0.5 0.25 1 0.5
    ambient 0.1 0.2 0.3
    emissive 0 0 0.5
    texture_unit { texture crate.png
      scale 0.5 0.25
      scroll 0.1 0
      rotate 90
      filtering linear point none
      tex_address_mode clamp } } }
}
abstract material Shop/Base { technique { pass { lighting on } } }
material Shop/Glass { technique { pass { scene_blend alpha_blend
  diffuse 0 0 1 0.25 } } }
material Shop/Lamp { technique { pass { lighting off
  diffuse 1 0.5 0 } } }
material Shop/Layers { technique { pass { diffuse 1 0 0 } pass { diffuse 0 1 0 }
  pass { scene_blend add
    diffuse 0 0 1 } } }
material Shop/Plain { }
material Shop/Bad { technique { pass { diffuse one two three } } }
material Shop/Lost { technique { pass { texture_unit { texture lost.png } } } }
material Shop/Shaded { technique { pass { fragment_program_ref Shop/FS { } } } }
material Shop/Labelled { technique { pass { texture_unit label { texture other.png } } } }
material Shop/Relabelled : Shop/Labelled { set_texture_alias label crate.png
}
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
    visual = visual_of(script("Shop/Crate", uris))
    # What is not blended is opaque, whatever its alpha.
    assert visual.colour == (0.5, 0.25, 1.0, 1.0)
    found = visual.material
    assert (found.ambient, found.emissive) == ((0.1, 0.2, 0.3, 1.0), (0.0, 0.0, 0.5, 1.0))
    assert found.covers
    assert found.name == "Shop/Crate"
    assert found.texture == Texture(
        shop / "shop" / "materials" / "textures" / "crate.png",
        (0.5, 0.25),
        (0.1, 0.0),
        math.pi / 2,
        False,
        sharp=True,
    )


def test_file_uris_and_uris_of_several_models(shop, tmp_path):
    other = shop / "other" / "materials" / "scripts"
    other.mkdir(parents=True)
    (other / "a.material").write_text("material Other/A { technique { pass { diffuse 0 1 0 } } }")
    uris = f"<uri>file://{other}</uri>{URIS[0]}"
    assert visual_of(script("Other/A", uris)).colour == (0, 1, 0, 1)
    assert visual_of(script("Shop/Crate", uris)).material.texture is not None


def test_a_picture_by_its_alias(shop):
    assert visual_of(script("Shop/Relabelled")).material.texture.path.name == "crate.png"


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


@pytest.mark.parametrize(
    ("scripts", "textures"),
    [
        ("media/materials/scripts", "media/materials/textures"),
        ("Media/materials/scripts", "Media/materials/textures"),
        (".", "."),
    ],
)
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
