import pytest
from shared import EMPTY_WORLD, cases, complains

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import Light
from bullet_lab.simulation.world.sdf import read_spawned, read_world_file


def sdf(inside):
    return f'<sdf version="1.6">{inside}</sdf>'


def model(inside, name="m"):
    return sdf(f'<model name="{name}">{inside}</model>')


def link(inside="", name="a"):
    return f'<link name="{name}">{inside}</link>'


def include(inside):
    return f"<include>{inside}</include>"


def test_a_light_may_be_spawned():
    light = '<light name="lamp" type="point"><pose>1 2 3 0 0 0</pose></light>'
    assert read_spawned(sdf(light), "s") == Light("lamp", "point", Pose((1, 2, 3)))
    # A model stands before it.
    assert read_spawned(sdf(f'{light}<model name="m">{link()}</model>'), "s").name == "m"


@cases("""
world, pose, height:
  - [true, '', 0.0]
  - [true, <pose>0 0 2 0 0 0</pose>, 2.0]
  - [false, '', 0.5]
""")
def test_an_include_in_a_world_has_the_last_word_on_the_pose(tmp_path, world, pose, height):
    (tmp_path / "thing.sdf").write_text(model("<pose>0 0 0.5 0 0 0</pose>" + link()))
    inside = include(f"<uri>thing.sdf</uri>{pose}")
    text = sdf(f'<world name="default">{inside}</world>' if world else inside)
    assert read_spawned(text, "here", tmp_path).pose.position == (0.0, 0.0, height)


@cases("""
versions, read:
  - [1.4 1.6, 1.6]
  - [1.6 1.4 1.7 1.8, 1.7]
  - [1.9 1.8, 1.9]
""")
def test_the_newest_known_file_of_a_model_config_is_read(read_world, save_model, versions, read):
    listed = "".join(f'<sdf version="{one}">{one}.sdf</sdf>' for one in versions.split())
    folder = save_model("thing", "", f"<model>{listed}</model>")
    (folder / f"{read}.sdf").write_text(model(link(), "read"))
    assert [m.name for m in read_world(include("<uri>model://thing</uri>")).models] == ["read"]


def test_a_missing_model_is_named_once(tmp_path, caplog):
    include = "<include><uri>model://{}</uri><name>{}</name></include>"
    parts = "".join(include.format(uri, n) for n, uri in enumerate(("nix", "none", "nix", "nix")))
    (tmp_path / "a.world").write_text(sdf(f'<world name="w">{parts}</world>'))
    assert not read_world_file(tmp_path / "a.world").models
    assert ["'model://nix'" in line for line in caplog.messages] == [True, False]


def test_a_missing_mesh_is_named_once_where_it_is_used_first(caplog):
    lost, other = (
        f'<collision name="{name}"><geometry><mesh><uri>package://bullet_lab/{name}.dae</uri></mesh>'
        "</geometry></collision>"
        for name in ("nix", "none")
    )
    read_spawned(model(link(lost) + link(lost + other, "b") + link(lost, "c")), "s")
    assert ["nix.dae" in line for line in caplog.messages] == [True, False]
    assert "link 'a'" in caplog.messages[0]


@cases("""
text, message:
  - [<sdf version="1.6"><model/></sdf>, a <model> without a name]
  - [<sdf version="1.6"><model name="m"></model></sdf>, 'model ''m'': there is no link']
  - [<mesh/>, 'the root element is <mesh>, neither <sdf> nor <robot>']
  - [<sdf version="1.6"></sdf>, there is no model]
  - [<sdf version="1.6"><model name="a"><link name="a"></link></model><model name="a"><link
     name="a"></link></model></sdf>, 2 models; only the first is used]
""")
def test_a_bad_model_is_one_line_that_names_source_and_place(text, message):
    with complains(f"^s: (.*: )?{message}"):
        read_spawned(text, "s")


@cases("""
config, message:
  - [<model/>, 'model.config: names no <sdf> file']
  - [<model><sdf>../../secret.sdf</sdf></model>, leaves its folder]
  - [<model><sdf>nix.sdf</sdf></model>, no such file]
  - [<model>, 'model.config: not well-formed XML']
""")
def test_a_bad_model_config(read_world, save_model, tmp_path, config, message):
    (tmp_path / "secret.sdf").write_text(model(link()))
    save_model("thing", model(link()), config)
    with complains(message):
        read_world(include("<uri>model://thing</uri>"))


def test_a_circle_of_includes_is_named(read_world, save_model):
    for number in range(10):
        save_model(f"m{number}", sdf(include(f"<uri>model://m{number + 1}</uri>")))
    save_model("m10", model(link()))
    # As many as that are taken for none.
    assert read_world(include("<uri>model://m1</uri>")).models
    with complains("models include each other in a circle"):
        read_world(include("<uri>model://m0</uri>"))


@cases("""
text:
  - <sdf/>
  - <world/>
  - <robot name="r"/>
""")
def test_no_world(tmp_path, text):
    (tmp_path / "a.world").write_text(text)
    with pytest.raises(LabError, match="a.world: no <sdf> with a <world>$"):
        read_world_file(tmp_path / "a.world")


def test_a_model_that_is_included_often_is_told_of_once(read_world, save_model, caplog):
    save_model("m", model(link("<kinematic>1</kinematic>")))
    text = "<uri>model://m</uri><name>{}</name>"
    assert len(read_world("".join(include(text.format(name)) for name in "abc")).models) == 3
    (message,) = caplog.messages
    assert message.endswith("model.sdf: <link>: <kinematic> is not simulated")


def test_our_own_worlds_and_robots_say_nothing_unknown(package, caplog):
    for path in sorted((package / "worlds").glob("*.world")):
        read_world_file(path)
    for path in sorted((package / "urdf").glob("*.urdf")):
        with Simulation.of(EMPTY_WORLD) as simulation:
            simulation.spawn(str(path))
    assert caplog.messages == []
