
import pytest

from bullet_lab.simulation import plugins
from bullet_lab.simulation.plugins import Output, Plugin, known_plugins
from bullet_lab.simulation.plugins.samples import RangeSample
from bullet_lab.simulation.simulation import Simulation
from bullet_lab.simulation.world.urdf import read_urdf

FLOOR = "package://bullet_lab/worlds/empty.world"
ROBOT = """<robot name="r"><link name="base">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial></link>
  <gazebo><plugin name="{0}" filename="{0}"><updateRate>50</updateRate></plugin></gazebo></robot>"""


@pytest.fixture(autouse=True)
def known_kinds(monkeypatch):
    """What a test adds to the kinds that are known is gone after it."""
    monkeypatch.setattr(plugins, "_KINDS", dict(plugins._KINDS))


@pytest.fixture
def altimeter():
    """The plugin of docs/design.md, as a user writes it."""

    class Altimeter(Plugin):
        filenames = ("libtest_altimeter.so", "libtest_altimeter_2.so")

        def __init__(self, mount):
            super().__init__(mount)
            self.height = Output(mount.topic(mount.text("topicName", "height")), RangeSample)
            self.outputs = (self.height,)
            self.schedule = mount.schedule("updateRate", 10.0)

        def produce(self, step):
            if self.height.wanted:
                z = self.mount.body.pose().position[2]
                self.height.send(RangeSample(step, "world", False, 0.0, 0.0, 100.0, z))

    return Altimeter


def heights(filename):
    samples = []
    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(read_urdf(ROBOT.format(filename), "here"))
        robot.listen("height", samples.append)
        simulation.run_for(0.2)
    return [sample.range for sample in samples]


SENSOR = """<gazebo reference="base"><sensor type="{}" name="s">
  <ray><range><max>1</max></range></ray><plugin name="p" filename="{}">
  <topicName>it</topicName><imageTopicName>it</imageTopicName><frameName>f</frameName>{}</plugin>
  </sensor></gazebo></robot>"""


@pytest.mark.parametrize(
    ("name", "sensor", "topic", "missing", "empty"),
    [
        ("planar_move", "", "cmd_vel", "", ""),
        ("joint_state_publisher", "", "joint_states", "/r/", "/r/"),
        ("laser", "ray", "it", "", "/r/"),
        ("camera", "camera", "it", "", "/r/"),
        ("imu_sensor", "imu", "it", "/r/", ""),
        ("range", "ray", "it", "", ""),
    ],
)
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


@pytest.mark.parametrize("filename", ["libtest_altimeter.so", "libtest_altimeter_2"])
def test_a_class_is_all_that_a_plugin_needs(altimeter, filename):
    assert set(altimeter.filenames) <= set(known_plugins())
    found = heights(filename)
    assert len(found) == 10
    assert found == sorted(found, reverse=True)


def test_a_subclass_does_not_take_over_the_files_of_its_base(altimeter):
    class Other(altimeter):
        pass

    with Simulation.of(FLOOR) as simulation:
        robot = simulation.add(read_urdf(ROBOT.format("libtest_altimeter.so"), "here"))
        assert type(robot.plugins[0]) is altimeter
