import pytest

from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_spawned, read_world_file

MODEL = """<model name="m">{model}<link name="l">{link}
  <collision name="c"><geometry><sphere><radius>1</radius></sphere></geometry>{collision}
  </collision><visual name="v"><geometry><sphere><radius>1</radius></sphere></geometry>{visual}
  </visual></link></model>"""


def model_text(**parts):
    empty = dict.fromkeys(("model", "link", "collision", "visual"), "")
    return f"<sdf>{MODEL.format(**{**empty, **parts})}</sdf>"


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
        ("collision", "<surface><bounce/><friction><ode><mu>1</mu></ode></friction></surface>"),
    ],
)
def test_what_changes_nothing_is_not_told(part, xml, caplog):
    read_spawned(model_text(**{part: xml}), "the text")
    assert caplog.messages == []


def write_world(folder, inner):
    path = folder / "some.world"
    path.write_text(f'<sdf version="1.6"><world name="w">{inner}</world></sdf>')
    return path


def test_worlds(tmp_path, caplog):
    inner = (
        "<physics type='ode'><max_step_size>0.005</max_step_size><real_time_update_rate>100"
        "</real_time_update_rate><real_time_factor>1"
        "</real_time_factor><ode><solver><iters>50</iters></solver></ode></physics>"
        "<gui><camera name='user'/></gui><wind/><atmosphere type='adiabatic'/>"
        "<plugin name='wind' filename='libwind.so'/><road name='r'/>"
    )
    path = write_world(tmp_path, inner)
    read_world_file(path)
    rates = "<max_step_size> is not simulated, <real_time_update_rate> is not simulated"
    assert caplog.messages == [
        f"{path}: <physics>: {rates}; the time step is 0.001 s",
        f"{path}: <world>: plugin 'wind' (libwind.so) is not simulated",
        f"{path}: <world>: <road> is not simulated",
    ]


def test_the_known_plugins_are_named_once(caplog):
    plugins = "".join(f'<plugin name="{n}" filename="lib{n}.so"/>' for n in ("fly", "swim"))
    model = read_spawned(model_text(model=plugins), "text")
    with Simulation() as simulation:
        simulation.add(model)
        simulation.add(model, "another")
    first, second = caplog.messages
    what = "2 plugins are not simulated and skipped (libfly.so, libswim.so)"
    assert first.startswith(f"model 'm': {what}; known are lib")
    assert second == f"model 'another': {what}"


def test_a_model_that_is_included_often_is_told_of_once(tmp_path, caplog):
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "model.sdf").write_text(model_text(link="<kinematic>1</kinematic>"))
    include = "<include><uri>m</uri><name>{}</name></include>"
    path = write_world(tmp_path, "".join(include.format(name) for name in "abc"))
    assert len(read_world_file(path).models) == 3
    (message,) = caplog.messages
    assert message.endswith("model.sdf: <link>: <kinematic> is not simulated")


def test_our_own_worlds_say_nothing_unknown(package, caplog):
    for path in sorted((package / "worlds").glob("*.world")):
        read_world_file(path)
    assert caplog.messages == []
