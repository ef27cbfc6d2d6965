
import pytest
from conftest import complains

from bullet_lab.simulation.world.description import Attenuation, Cone
from bullet_lab.simulation.world.sdf import read_spawned, read_world_file


@pytest.fixture
def read(tmp_path):
    def read(inner):
        path = tmp_path / "lit.world"
        path.write_text(f'<sdf version="1.6"><world name="lit">{inner}</world></sdf>')
        return read_world_file(path)

    return read


def light(inner, kind="spot"):
    return f'<light name="lamp" type="{kind}"><pose>1 2 3 0 0 0</pose>{inner}</light>'


def test_a_light_without_anything(read):
    (lamp,) = read(light("", "point")).lights
    assert lamp.attenuation == Attenuation(10.0, 1.0, 0.0, 0.0)
    assert lamp.direction == (0.0, 0.0, -1.0)
    assert not lamp.casts_shadows


def test_attenuation_and_cone(read):
    fading = "<range>7</range><constant>0.5</constant><linear>0.1</linear>"
    fading += "<quadratic>0.01</quadratic>"
    spot = "<inner_angle>0.3</inner_angle><outer_angle>0.9</outer_angle><falloff>2</falloff>"
    (lamp,) = read(light(f"<attenuation>{fading}</attenuation><spot>{spot}</spot>")).lights
    assert lamp.attenuation == Attenuation(7.0, 0.5, 0.1, 0.01)
    assert lamp.cone == Cone(0.3, 0.9, 2.0)


@pytest.mark.parametrize(
    "wrong",
    [
        "<attenuation><range>-1</range></attenuation>",
        "<attenuation><linear>none</linear></attenuation>",
        "<spot><inner_angle>1</inner_angle><outer_angle>0.5</outer_angle></spot>",
        "<spot><outer_angle>9</outer_angle></spot>",
        "<spot><falloff>-1</falloff></spot>",
    ],
)
def test_impossible_lights_are_named(read, wrong):
    with complains("light 'lamp'"):
        read(light(wrong))


@pytest.mark.parametrize(("said", "shadows"), [("", True), ("<shadows>false</shadows>", False)])
def test_shadows(read, said, shadows):
    assert read(f"<scene>{said}</scene>").shadows is shadows


def test_a_light_may_be_spawned_and_a_model_stands_before_it():
    lamp = '<light name="lamp" type="point"><pose>1 2 3 0 0 0</pose></light>'
    found = read_spawned(f"<sdf version='1.6'>{lamp}</sdf>", "here")
    assert (found.name, found.kind, found.pose.position) == ("lamp", "point", (1.0, 2.0, 3.0))
    model = '<model name="m"><static>true</static><link name="l"/></model>'
    assert read_spawned(f"<sdf version='1.6'>{lamp}{model}</sdf>", "here").name == "m"


@pytest.mark.parametrize(
    ("world", "pose", "height"),
    [(True, "", 0.0), (True, "<pose>0 0 2 0 0 0</pose>", 2.0), (False, "", 0.5)],
)
def test_an_include_in_a_world_has_the_last_word_on_the_pose(tmp_path, world, pose, height):
    (tmp_path / "thing.sdf").write_text(
        '<sdf version="1.6"><model name="m"><pose>0 0 0.5 0 0 0</pose><static>true</static>'
        '<link name="l"/></model></sdf>'
    )
    include = f"<include><uri>thing.sdf</uri>{pose}</include>"
    inner = f'<world name="default">{include}</world>' if world else include
    found = read_spawned(f'<sdf version="1.4">{inner}</sdf>', "here", tmp_path)
    assert found.pose.position == (0.0, 0.0, height)
