import pytest
import yaml
from message_fields import check

from bullet_lab.core.parameters import ArgumentsError
from bullet_lab.core.pose import Pose
from bullet_lab.ros.nodes.spawn_model import packages_to_models, parse_spawn_arguments


def parse(line, namespace="/"):
    return parse_spawn_arguments(line.split(), namespace)


def test_the_line_of_most_launch_files():
    found = parse("-urdf -param robot_description -model rover -x 1 -y -2.5 -z 0.1 -Y 1.57")
    fields = """
        urdf: true
        source: [param, robot_description]
        model: rover
        robot_namespace: /
        gazebo_namespace: /gazebo
        pose.position: [1.0, -2.5, 0.1]
        unpause: false
        bond: false
        package_to_model: false
        wait: ""
        reference_frame: ""
        joints: {}
    """
    check(found, fields)
    assert found.pose.rpy() == pytest.approx((0.0, 0.0, 1.57))


def test_all_of_it():
    found = parse(
        "-sdf -file /a/b.sdf -model m -reference_frame other::link -robot_namespace left "
        "-gazebo_namespace /sim/ -wait ground_plane -unpause -package_to_model -b "
        "-R 0.1 -P -0.2 -Y 3 -J shoulder 0.5 -J elbow -1e-3"
    )
    fields = """
        urdf: false
        source: [file, /a/b.sdf]
        reference_frame: other::link
        robot_namespace: left
        gazebo_namespace: /sim
        wait: ground_plane
        unpause: true
        package_to_model: true
        bond: true
        joints: {shoulder: 0.5, elbow: -0.001}
    """
    check(found, fields)
    assert found.pose.rpy() == pytest.approx((0.1, -0.2, 3.0))


@pytest.mark.parametrize("x", ["-1", "-.5", "-1e-3", "+2", "-2E+1", "-3."])
def test_numbers_in_any_spelling(x):
    found = parse(f"-sdf -stdin -model m -x {x} -J j {x}")
    assert found.pose == Pose((float(x), 0.0, 0.0))
    assert found.joints["j"] == pytest.approx(float(x), abs=1e-15)


# Lines, and what they say in the namespace /left/.
LINES = """
-urdf -stdin -model m: "{robot_namespace: /left/, source: [stdin, '']}"
-urdf -stdin -model m -namespace /right: "{robot_namespace: /right}"
-sdf -database table -model t: "{source: [database, table]}"
-gazebo -file f -model t: "{urdf: false}"
"""


@pytest.mark.parametrize("line, fields", yaml.safe_load(LINES).items())
def test_namespaces_and_sources(line, fields):
    check(parse(line, "/left/"), fields)


REFUSED = """
    -file f -model m: one of the arguments -urdf -sdf/-gazebo is required
    -urdf -sdf -file f -model m: not allowed with argument
    -urdf -model m: one of the arguments -file -param -database -stdin is required
    -urdf -file f -param p -model m: not allowed with argument
    -urdf -file f: "required: -model"
    -urdf -file f -model m -x one: "'one' is not a finite number"
    -urdf -file f -model m -z nan: "'nan' is not a finite number"
    -urdf -file f -model m -z -inf: "'-inf' is not a finite number"
    -urdf -file f -model m -z -1x: "'-1x' is not a finite number"
    -urdf -file f -model m -Y: "-Y: expected one argument"
    -urdf -file f -model m -J j: "-J: expected 2 arguments"
    -urdf -file f -model m -J j far: "'far' is not a finite number"
    -trimesh -file f -model m: required
    -urdf -file f -model m -trimesh_mass 1: "unrecognized arguments: -trimesh_mass 1"
"""


@pytest.mark.parametrize("line, reason", yaml.safe_load(REFUSED).items())
def test_refusals(line, reason):
    with pytest.raises(ArgumentsError) as caught:
        parse(line)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_empty_names():
    with pytest.raises(ArgumentsError, match="-model: it is empty"):
        parse_spawn_arguments(["-urdf", "-stdin", "-model", ""])


def test_meshes_of_packages_as_models():
    text = """<mesh filename="package://a/b.dae"/><mesh scale="1 1 1" filename='package://c/d'/>
<texture filename="package://e/f.png"/>"""
    assert packages_to_models(text) == (
        """<mesh filename="model://a/b.dae"/><mesh scale="1 1 1" filename='model://c/d'/>
<texture filename="package://e/f.png"/>"""
    )
