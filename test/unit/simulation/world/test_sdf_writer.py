"""A saved world is valid SDF and loads again to the same state."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from alike import assert_alike
from shared import BLOCK_ROBOT, EMPTY_WORLD, cases

from bullet_lab.core.pose import Pose
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.sdf import read_spawned, read_world_file
from bullet_lab.simulation.world.sdf_writer import world_text

CAMERA_ROBOT = "package://bullet_lab/urdf/camera_robot.urdf"
# A base that two parts hang on: one turns within limits, one slides.
MACHINE = """<sdf version="1.6"><model name="machine"><pose>1 2 3 0.1 0.2 0.3</pose>
  <link name="base"><self_collide>true</self_collide>
    <inertial><pose>0.1 0 0 0 0 0.3</pose><mass>3</mass>
      <inertia><ixx>0.2</ixx><iyy>0.3</iyy><izz>0.4</izz><ixy>0.01</ixy></inertia></inertial>
    <collision name="c"><geometry><box><size>0.3 0.2 0.1</size></box></geometry>
      <surface><friction><ode><mu>0.3</mu></ode></friction>
        <contact><ode><kp>1e5</kp><kd>10</kd></ode></contact></surface></collision>
    <visual name="v"><cast_shadows>false</cast_shadows>
      <geometry><sphere><radius>0.1</radius></sphere></geometry>
      <material><diffuse>0.1 0.2 0.3 0.5</diffuse></material></visual></link>
  <link name="arm"><pose>0 0 0.5 0 0 0</pose>
    <inertial><mass>1</mass>
      <inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial>
    <sensor name="s" type="ray"><pose>0.1 0 0 0 0 0</pose><update_rate>5</update_rate>
      <ray><scan><horizontal><samples>3</samples><resolution>1</resolution>
        <min_angle>-1</min_angle><max_angle>1</max_angle></horizontal></scan>
        <range><min>0.1</min><max>3</max></range></ray>
      <plugin name="scan" filename="libgazebo_ros_laser.so"><topicName>scan</topicName>
        <frameName>arm</frameName></plugin></sensor></link>
  <link name="slide"><gravity>0</gravity><pose>0.5 0 0 0.2 0.1 0</pose>
    <inertial><mass>1</mass>
      <inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial></link>
  <joint name="turn" type="revolute"><parent>base</parent><child>arm</child>
    <axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>2</upper><effort>5</effort></limit>
      <dynamics><damping>0.1</damping><friction>0.02</friction></dynamics></axis></joint>
  <joint name="push" type="prismatic"><parent>base</parent><child>slide</child>
    <axis><xyz>1 0 0</xyz><limit/></axis></joint>
  <plugin name="states" filename="libgazebo_ros_joint_state_publisher.so">
    <updateRate>10</updateRate><unread><deep kind="x">kept</deep></unread></plugin>
</model></sdf>"""


def save(simulation, folder, name="saved.world"):
    text, notes = world_text(simulation.snapshot(), folder)
    path = folder / name
    path.write_text(text)
    return path, notes


def saved_and_read(simulation, folder):
    return read_world_file(save(simulation, folder)[0])


def states(simulation):
    return {name: instance.state() for name, instance in simulation.models.items()}


@pytest.fixture(scope="module")
def busy():
    """Robots on their way, a fallen column, and a machine that tumbles through the air."""
    with Simulation.of("package://bullet_lab/worlds/beacons.world") as simulation:
        block = simulation.spawn(BLOCK_ROBOT, "block", Pose((0.0, -2.0, 0.0)), "left")
        camera = simulation.spawn(CAMERA_ROBOT, "camera", Pose((-2.0, 0.0, 0.0)))
        tilted = Pose.from_rpy((0.0, 3.0, 0.5), (0.3, 0.2, 0.1))
        simulation.spawn("package://bullet_lab/urdf/beacon.urdf", "falling", tilted)
        machine = simulation.add(read_spawned(MACHINE, "machine"))
        machine.configure({"turn": 0.4, "push": 0.2})
        machine.move(machine.pose(), (0.0, 0.0, 1.0), (1.0, 2.0, 0.5))
        block.command("/left/cmd_vel", PlanarCommand(0.3, 0.0, 0.5))
        camera.command("cmd_vel", PlanarCommand(0.3, 0.0, 0.5))
        simulation.run_for(0.4)
        yield simulation


def test_a_saved_world_loads_again_to_the_same_state(busy, tmp_path):
    path, notes = save(busy, tmp_path)
    assert notes == []
    with Simulation(read_world_file(path)) as again:
        assert_alike(states(busy), states(again))
        rates = [abs(rate) for _, rate in busy.models["machine"].state().joints.values()]
        assert min(rates) > 1e-3
        # A reset goes back to there.
        again.run_for(0.2)
        again.reset_world()
        assert_alike(busy.models["falling"].pose(), again.models["falling"].pose())


def test_a_saved_world_is_valid(busy, tmp_path, package):
    """By SDF 1.6 as an XML schema, mended where Debian's files have gaps."""
    given = sorted(Path("/usr/share").glob("sdformat*/1.6/air_pressure.xsd"))
    if not given or not shutil.which("xmllint"):
        pytest.skip("sdformat-sdf or xmllint is not installed")
    for path in (*given[-1].parent.glob("*.xsd"), *(package / "test/schema").glob("*.xsd")):
        text = path.read_text().replace("http://sdformat.org/schemas/", "")
        (tmp_path / path.name).write_text(text)
    path, _ = save(busy, tmp_path)
    command = ["xmllint", "--noout", "--nonet", "--schema", str(tmp_path / "root.xsd"), str(path)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


@cases("""
tag, given, saved:
  # An empty tag is one; the other plugin has none.
  - ['', left, [left]]
  - ['', /, [/]]
  - [<robotNamespace></robotNamespace>, left, ['', left]]
""")
def test_the_namespace_that_a_plugin_was_given_is_saved(tmp_path, world, tag, given, saved):
    text = MACHINE.replace("<updateRate>", f"{tag}<updateRate>")
    world.add(read_spawned(text, "machine"), namespace=given)
    plugins = saved_and_read(world, tmp_path).models[-1].plugins
    assert sorted({plugin.tags["robotNamespace"] for plugin in plugins}) == saved


def test_meshes_are_named_so_that_they_are_found(tmp_path, package):
    shutil.copy(package / "meshes" / "beacon.dae", tmp_path / "own mesh.dae")
    (tmp_path / "own.sdf").write_text(
        (package / "models/beacon/model.sdf")
        .read_text()
        .replace("package://bullet_lab/meshes/beacon.dae", "own mesh.dae")
    )
    include = "<include><uri>own.sdf</uri></include>"
    (tmp_path / "w.world").write_text(f"<sdf><world name='w'>{include}</world></sdf>")
    inside = tmp_path / "inside"
    inside.mkdir()
    with Simulation(read_world_file(tmp_path / "w.world")) as simulation:
        simulation.spawn(str(package / "urdf" / "beacon.urdf"), "packaged", Pose((3.0, 0, 0)))
        path, notes = save(simulation, tmp_path)
        assert notes == []
        uris = set(re.findall("<uri>(.*)</uri>", path.read_text()))
        assert uris == {"own mesh.dae", "package://bullet_lab/meshes/beacon.dae"}
        with Simulation(read_world_file(path)) as again:
            assert_alike(states(simulation), states(again))
        # A file of a package is named by it, whatever it was called.
        plain = (package / "models/beacon/model.sdf").read_text()
        plain = plain.replace("package://bullet_lab", package.as_uri())
        simulation.remove("packaged")
        simulation.add(read_spawned(plain, "plain"), "plain", Pose((5.0, 0.0, 0.0)))
        text = save(simulation, tmp_path)[0].read_text()
        assert set(re.findall("<uri>(.*)</uri>", text)) == uris
        # Elsewhere, the mesh is named by its place, and whoever saves is told.
        path, notes = save(simulation, inside)
        assert "own%20mesh.dae</uri>" in path.read_text()
        (note,) = notes
        assert "own mesh.dae lies outside all packages" in note


def test_the_state_of_a_world_that_gazebo_has_saved(tmp_path):
    """Gazebo says where links are and leaves the joints to whoever reads it."""
    with Simulation.of(EMPTY_WORLD) as simulation:
        machine = simulation.add(read_spawned(MACHINE, "machine"))
        machine.configure({"turn": 1.3, "push": -0.2})
        path, _ = save(simulation, tmp_path)
        text = path.read_text()
        joints = re.findall(r'\s*<joint name="\w+">\s*<angle.*?</joint>', text, re.DOTALL)
        assert len(joints) == 2
        for joint in joints:
            text = text.replace(joint, "")
        path.write_text(text)
        with Simulation(read_world_file(path)) as again:
            assert_alike(states(simulation), states(again))
