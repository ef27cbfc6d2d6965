"""What all plugins have in common: their files and their namespaces."""

import pytest
from shared import cases

from bullet_lab.simulation import plugins
from bullet_lab.simulation.plugins import Plugin, kind_of, known_plugins
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.description import PluginTag
from bullet_lab.simulation.world.urdf import read_urdf

ROBOT = """<robot name="r"><link name="base">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
  <gazebo><plugin name="{0}" filename="{0}"><updateRate>50</updateRate></plugin></gazebo></robot>"""


@pytest.fixture(autouse=True)
def known_kinds(monkeypatch):
    """What a test adds to the kinds that are known is gone after it."""
    monkeypatch.setattr(plugins, "_KINDS", dict(plugins._KINDS))


SENSOR = """<gazebo reference="base"><sensor type="{}" name="s">
  <ray><range><max>1</max></range></ray><plugin name="p" filename="{}">
  <topicName>it</topicName><imageTopicName>it</imageTopicName><frameName>f</frameName>{}</plugin>
  </sensor></gazebo></robot>"""


@cases("""
name, sensor, topic, missing, empty:
  - [planar_move, '', cmd_vel, '', '']
  - [joint_state_publisher, '', joint_states, /r/, /r/]
  - [laser, ray, it, '', /r/]
  - [camera, camera, it, '', /r/]
  - [imu_sensor, imu, it, /r/, '']
  - [range, ray, it, '', '']
""")
def test_the_namespace_without_a_tag_is_that_of_gazebos_plugin(
    name, sensor, topic, missing, empty
):
    def topic_of(tag, namespace):
        filename = f"libgazebo_ros_{name}.so"
        text = ROBOT.format(filename).replace("<updateRate>50</updateRate>", tag)
        if sensor:
            text = text[: text.index("<gazebo>")] + SENSOR.format(sensor, filename, tag)
        with Simulation() as simulation:
            robot = simulation.add(read_urdf(text, "here"), namespace=namespace)
            (plugin,) = robot.plugins
            return next(entry.topic for entry in (*plugin.inputs, *plugin.outputs))

    assert topic_of("", "") == f"{missing}{topic}"
    assert topic_of("", "/") == topic
    assert topic_of("", "/one/") == f"/one/{topic}"
    for given in ("", "one"):
        assert topic_of("<robotNamespace></robotNamespace>", given) == f"{empty}{topic}"
    assert topic_of("<robotNamespace>own</robotNamespace>", "one") == f"/own/{topic}"


def test_a_class_serves_all_its_files_and_a_subclass_does_not_take_them_over():
    class Altimeter(Plugin):
        filenames = ("libtest_altimeter.so", "libtest_altimeter_2.so")

    class Other(Altimeter):
        pass

    assert set(Other.filenames) <= set(known_plugins())
    for name in ("libtest_altimeter.so", "libtest_altimeter_2"):
        assert kind_of(PluginTag(name, "", {})) is Altimeter
