import pytest
from shared import PACKAGE, complains

from bullet_lab.core.pose import Pose
from bullet_lab.errors import LabError
from bullet_lab.simulation.world.description import Attenuation, Cone, Light, Mesh, Plane
from bullet_lab.simulation.world.sdf import read_spawned, read_world_file

BEACON = "package://bullet_lab/meshes/beacon.dae"
BALL = "<sphere><radius>1</radius></sphere>"
BEACON_MESH = Mesh(PACKAGE / "meshes/beacon.dae", BEACON, (1, 2, 3))


def sdf(inside):
    return f'<sdf version="1.6">{inside}</sdf>'


def model(inside, name="m"):
    return sdf(f'<model name="{name}">{inside}</model>')


def link(inside="", name="a"):
    return f'<link name="{name}">{inside}</link>'


def shape(geometry, extra="", tag="collision"):
    return f'<{tag} name="{tag}">{extra}<geometry>{geometry}</geometry></{tag}>'


def joint(kind, parent="a", child="b", inside="", name="j"):
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def include(inside):
    return f"<include>{inside}</include>"


def test_the_empty_world_has_a_floor_and_a_sun(package):
    world = read_world_file(package / "worlds" / "empty.world")
    (floor,) = world.models
    assert (floor.name, floor.static) == ("ground_plane", True)
    assert floor.links[0].collisions[0].geometry == Plane((0, 0, 1), (100, 100))
    (sun,) = world.lights
    assert (sun.kind, sun.casts_shadows, sun.diffuse) == ("directional", True, (0.8, 0.8, 0.8, 1))
    assert sun.direction[2] < -0.8
    assert world.gravity == (0, 0, -9.8)
    assert world.ambient == (0.4, 0.4, 0.4, 1.0)


def test_the_beacons_stand_where_the_report_has_them(package):
    _, *beacons = read_world_file(package / "worlds" / "beacons.world").models
    places = {beacon.name: beacon.pose.position for beacon in beacons}
    assert places == {"beacon_0": (1, 1, 0), "beacon_1": (5, 1, 0), "beacon_2": (-5, 1, 0)}
    mesh = Mesh(package / "meshes/beacon.dae", BEACON)
    for beacon in beacons:
        assert beacon.static
        (visual,), (collision,) = beacon.links[0].visuals, beacon.links[0].collisions
        assert visual.colour == (1, 1, 1, 1)
        assert visual.geometry == collision.geometry == mesh


def light(inside, kind="spot"):
    return sdf(f'<light name="lamp" type="{kind}"><pose>1 2 3 0 0 0</pose>{inside}</light>')


def test_a_light_may_be_spawned():
    lamp = read_spawned(light("", "point"), "s")
    assert lamp == Light("lamp", "point", Pose((1, 2, 3)))
    fading = "<range>7</range><constant>0.5</constant><linear>0.1</linear>"
    fading += "<quadratic>0.01</quadratic>"
    cone = "<inner_angle>0.3</inner_angle><outer_angle>0.9</outer_angle><falloff>2</falloff>"
    spot = read_spawned(light(f"<attenuation>{fading}</attenuation><spot>{cone}</spot>"), "s")
    assert spot.attenuation == Attenuation(7.0, 0.5, 0.1, 0.01)
    assert spot.cone == Cone(0.3, 0.9, 2.0)
    # A model stands before it.
    both = light("").replace("</sdf>", '<model name="m"><link name="l"/></model></sdf>')
    assert read_spawned(both, "s").name == "m"


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
def test_impossible_lights_are_named(wrong):
    with complains("light 'lamp'"):
        read_spawned(light(wrong), "s")


@pytest.mark.parametrize(
    ("world", "pose", "height"),
    [(True, "", 0.0), (True, "<pose>0 0 2 0 0 0</pose>", 2.0), (False, "", 0.5)],
)
def test_an_include_in_a_world_has_the_last_word_on_the_pose(tmp_path, world, pose, height):
    (tmp_path / "thing.sdf").write_text(model("<pose>0 0 0.5 0 0 0</pose>" + link()))
    inside = include(f"<uri>thing.sdf</uri>{pose}")
    text = sdf(f'<world name="default">{inside}</world>' if world else inside)
    assert read_spawned(text, "here", tmp_path).pose.position == (0.0, 0.0, height)


def test_an_include_may_let_a_model_go(read_world, save_model):
    save_model("rock", model("<static>true</static>" + link(), "rock"))
    (free,) = read_world(include("<uri>model://rock</uri><static>false</static>")).models
    assert (free.static, free.links[0].inertia.mass) == (False, 1.0)


def test_the_newest_file_of_a_model_config_is_read(read_world, save_model):
    folder = save_model(
        "thing",
        model(link(), "old"),
        '<model><sdf version="1.4">model.sdf</sdf><sdf version="1.6">new.sdf</sdf></model>',
    )
    (folder / "new.sdf").write_text(model(link(), "new"))
    assert [m.name for m in read_world(include("<uri>model://thing</uri>")).models] == ["new"]


MU = "<surface><friction><ode><mu>nan</mu></ode></friction></surface>"
PAIR = link() + link("", "b")
BAD_MODELS = [
    (sdf("<model/>"), "a <model> without a name"),
    (model(""), "model 'm': there is no link"),
    (model("<link/>"), "model 'm': a <link> without a name"),
    (model(link() + link()), "model 'm': link 'a' appears twice"),
    (model("<static>maybe</static>" + link()), "<static>: 'maybe' is not true or false"),
    (model("<pose>1 2 3</pose>" + link()), "<pose>: '1 2 3' is not 6 finite numbers"),
    (model(link(shape("<box/>"))), "link 'a': <collision>: <size>: '' is not 3"),
    (
        model(link(shape("<cylinder><radius>1 2</radius></cylinder>"))),
        "<radius>: '1 2' is not a finite number",
    ),
    (model(link(shape(BALL.replace("1", "0")))), "<radius>: 0 is not positive"),
    (
        model(link(shape(BALL, "<cast_shadows>some</cast_shadows>", "visual"))),
        "link 'a': <cast_shadows>: 'some' is not true or false",
    ),
    (
        model(link(shape("<plane><normal>0 0 0</normal></plane>"))),
        "<normal>: a zero vector has no direction",
    ),
    (model(link(shape(BALL, MU))), "link 'a': <mu>: 'nan' is not a finite number"),
    (model(link(shape("<mesh/>"))), "<collision>: <uri>: no file is named"),
    (
        model(link(shape("<mesh><uri>package://bullet_lab/nix.dae</uri></mesh>"))),
        "link 'a': <collision>: <uri>: 'package://bullet_lab/nix.dae': no such file",
    ),
    (
        model(link(shape(f"<mesh><uri>{BEACON}</uri><scale>1 0 1</scale></mesh>"))),
        "<scale>: a scale of 0 leaves nothing",
    ),
    (
        model(link("<inertial><inertia><izz>3</izz></inertia></inertial>")),
        "no body can have the principal moments 1, 1, 3",
    ),
    (
        model(PAIR + joint("revolute", inside="<axis><xyz>0 0 0</xyz></axis>")),
        "joint 'j': <xyz>: a zero vector has no direction",
    ),
    ("<mesh/>", "the root element is <mesh>, neither <sdf> nor <robot>"),
    (sdf(""), "there is no model"),
    (
        sdf('<model name="a"><link name="l"/></model><model name="b"><link name="l"/></model>'),
        "2 models; only the first is used",
    ),
]


def test_a_missing_model_is_named_once(tmp_path, caplog):
    include = "<include><uri>model://{}</uri><name>{}</name></include>"
    parts = "".join(include.format(uri, n) for n, uri in enumerate(("nix", "none", "nix", "nix")))
    (tmp_path / "a.world").write_text(sdf(f'<world name="w">{parts}</world>'))
    assert not read_world_file(tmp_path / "a.world").models
    assert ["'model://nix'" in line for line in caplog.messages] == [True, False]


def test_a_missing_mesh_is_named_once_where_it_is_used_first(caplog):
    lost = shape("<mesh><uri>package://bullet_lab/nix.dae</uri></mesh>")
    other = shape("<mesh><uri>package://bullet_lab/none.dae</uri></mesh>")
    read_spawned(model(link(lost) + link(lost + other, "b") + link(lost, "c")), "s")
    assert ["nix.dae" in line for line in caplog.messages] == [True, False]
    assert "link 'a'" in caplog.messages[0]


@pytest.mark.parametrize(("text", "message"), BAD_MODELS)
def test_a_bad_model_is_one_line_that_names_source_and_place(text, message):
    with complains(f"^s: (.*: )?{message}"):
        read_spawned(text, "s")


# test_structure.py has more.
BAD_WORLDS = [
    ("<gravity>down</gravity>", "<gravity>: 'down' is not 3 finite numbers"),
    (
        '<light name="l" type="point"><diffuse>red</diffuse></light>',
        "light 'l': <diffuse>: 'red' is not 4 finite numbers",
    ),
    (
        '<light name="l" type="directional"><direction>0 0 0</direction></light>',
        "light 'l': <direction>: a zero vector",
    ),
    (include("<uri>file:///etc/passwd</uri>"), "<include>: .*: outside the folders"),
    (
        include("<uri>model://good</uri><static>2</static>"),
        "<static>: '2' is not true or false",
    ),
    (
        include('<uri>model://good</uri><pose frame="x">0 0 0 0 0 0</pose>'),
        "frame 'x' is unknown; the model's frame is used",
    ),
]


@pytest.mark.parametrize(("inside", "message"), BAD_WORLDS)
def test_a_bad_world_is_one_line_that_names_file_and_place(
    read_world, save_model, tmp_path, inside, message
):
    save_model("good", model(link()))
    with complains(f"^{tmp_path}.*: {message}"):
        assert read_world(inside).name == "w"


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ("<model/>", "model.config: names no <sdf> file"),
        ("<model><sdf>../../secret.sdf</sdf></model>", "leaves its folder"),
        ("<model><sdf>nix.sdf</sdf></model>", "no such file"),
        ("<model>", "model.config: not well-formed XML"),
    ],
)
def test_a_bad_model_config(read_world, save_model, tmp_path, config, message):
    (tmp_path / "secret.sdf").write_text(model(link()))
    save_model("thing", model(link()), config)
    with complains(message):
        read_world(include("<uri>model://thing</uri>"))


def test_a_circle_of_includes_is_named(read_world, save_model):
    save_model("hen", sdf(include("<uri>model://egg</uri>")))
    save_model("egg", sdf(include("<uri>model://hen</uri>")))
    with complains("models include each other in a circle"):
        read_world(include("<uri>model://hen</uri>"))


@pytest.mark.parametrize("text", ["<sdf/>", "<world/>", '<robot name="r"/>'])
def test_no_world(tmp_path, text):
    (tmp_path / "a.world").write_text(text)
    with pytest.raises(LabError, match="a.world: no <sdf> with a <world>$"):
        read_world_file(tmp_path / "a.world")


# What is not simulated

WHOLE = """<model name="m">{model}<link name="l">{link}
  <collision name="c"><geometry><sphere><radius>1</radius></sphere></geometry>{collision}
  </collision><visual name="v"><geometry><sphere><radius>1</radius></sphere></geometry>{visual}
  </visual></link></model>"""


def model_text(**parts):
    empty = dict.fromkeys(("model", "link", "collision", "visual"), "")
    return f"<sdf>{WHOLE.format(**{**empty, **parts})}</sdf>"


@pytest.mark.parametrize(
    ("part", "xml", "said"),
    [
        ("model", "<enable_wind>true</enable_wind>", "<model>: <enable_wind>"),
        ("link", "<kinematic>1</kinematic>", "<link>: <kinematic>"),
        ("link", "<velocity_decay><linear>1</linear></velocity_decay>", "<link>: <velocity_decay>"),
        (
            "collision",
            "<surface><bounce><restitution_coefficient>0.7</restitution_coefficient></bounce>"
            "</surface>",
            "<surface>: <bounce>",
        ),
    ],
)
def test_what_is_not_simulated_is_told_once(part, xml, said, caplog):
    read_spawned(model_text(**{part: xml + xml}), "the text")
    assert caplog.messages == [f"the text: {said} is not simulated"]


@pytest.mark.parametrize(
    ("part", "xml"),
    [
        ("model", "<allow_auto_disable>1</allow_auto_disable><enable_wind>0</enable_wind>"),
        ("link", "<sensor name='s' type='ray'><visualize>true</visualize></sensor>"),
        ("visual", "<cast_shadows>1</cast_shadows><transparency>0.5</transparency><meta/>"),
        ("collision", "<max_contacts>10</max_contacts><laser_retro>0</laser_retro>"),
        ("link", "<velocity_decay><linear>0.00</linear><angular>0</angular></velocity_decay>"),
        (
            "collision",
            "<surface><bounce><restitution_coefficient>0.000</restitution_coefficient>"
            "<threshold>1e5</threshold></bounce></surface>",
        ),
        ("link", "<collision name='e'><geometry><empty/></geometry></collision>"),
        ("collision", "<surface><bounce/><friction><ode><mu>1</mu></ode></friction></surface>"),
    ],
)
def test_what_changes_nothing_is_not_told(part, xml, caplog):
    read_spawned(model_text(**{part: xml}), "the text")
    assert caplog.messages == []


def test_worlds(read_world, tmp_path, caplog):
    inner = (
        "<physics type='ode'><max_step_size>0.005</max_step_size><real_time_update_rate>100"
        "</real_time_update_rate><real_time_factor>1"
        "</real_time_factor><ode><solver><iters>50</iters></solver></ode></physics>"
        "<gui><camera name='user'/></gui><wind/><atmosphere type='adiabatic'/>"
        "<plugin name='wind' filename='libwind.so'/><road name='r'/>"
    )
    read_world(inner)
    path = tmp_path / "test.world"
    rates = "<max_step_size> is not simulated, <real_time_update_rate> is not simulated"
    assert caplog.messages == [
        f"{path}: <physics>: {rates}; the time step is 0.001 s",
        f"{path}: <world>: plugin 'wind' (libwind.so) is not simulated",
        f"{path}: <world>: <road> is not simulated",
    ]


def test_a_model_that_is_included_often_is_told_of_once(read_world, save_model, caplog):
    save_model("m", model_text(link="<kinematic>1</kinematic>"))
    text = "<uri>model://m</uri><name>{}</name>"
    assert len(read_world("".join(include(text.format(name)) for name in "abc")).models) == 3
    (message,) = caplog.messages
    assert message.endswith("model.sdf: <link>: <kinematic> is not simulated")


def test_our_own_worlds_say_nothing_unknown(package, caplog):
    for path in sorted((package / "worlds").glob("*.world")):
        read_world_file(path)
    assert caplog.messages == []
