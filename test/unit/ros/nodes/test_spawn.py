"""Models in patterns, and the command line of spawn_model."""

import re

import pytest
from message_fields import check
from shared import cases, refuses

from bullet_lab.core.parameters import ArgumentsError, ParameterError, read_parameters
from bullet_lab.core.pose import Pose
from bullet_lab.ros.gazebo.client import numbered
from bullet_lab.ros.nodes.spawn import (
    PopulateParameters,
    description_of,
    packages_to_models,
    parse_spawn_arguments,
    places_of,
)
from bullet_lab.simulation.world.sdf import read_spawned


def wanted(**given):
    return read_parameters(PopulateParameters, lambda name, default: given.get(name[1:], default))


@cases("""
given, places:
  # By default, the three beacons of the report.
  - [{}, [[1.0, 1.0, 0.0], [5.0, 1.0, 0.0], [-5.0, 1.0, 0.0]]]
  - [{poses: [[1, 2], [3, 4, 0.5]]}, [[1, 2, 0], [3, 4, 0.5]]]
""")
def test_poses(given, places):
    assert list(map(list, places_of(wanted(**given)).values())) == places


def test_the_model_is_a_beacon():
    model = read_spawned(description_of(wanted().model), "beacon")
    assert model.static
    assert model.links[0].collisions[0].geometry.path.name == "beacon.dae"


@cases("pattern: [line, grid, circle]")
def test_other_patterns_have_as_many_places_as_asked_for(pattern):
    assert len(set(places_of(wanted(pattern=pattern, count=7)).values())) == 7


@cases("poses: [5, [1, 2], [[1]], [[1, 2, 3, 4]], [['1', '2']], [[true, 1]], [[.nan, 0]]]")
def test_poses_that_are_none(poses):
    with refuses(r"~poses is .*: it must be a list of \[x, y\]", ParameterError):
        wanted(poses=poses)


def test_descriptions_are_files_or_references(package, tmp_path):
    path = package / "urdf" / "beacon.urdf"
    for name in (str(path), "package://bullet_lab/urdf/beacon.urdf"):
        assert description_of(name) == path.read_text()
    folder = read_spawned(description_of(str(package / "models" / "beacon")), "folder")
    assert folder.name == "beacon"
    assert "model://a&amp;b" in description_of("model://a&b")
    with refuses("no such file"):
        description_of(str(tmp_path / "nix.sdf"))


def test_only_numbered_names_are_taken_away():
    names = ["beacon", "beacon_0", "beacon_12", "beacon_x", "beacon_1_2", "a_beacon_1", "b.acon_1"]
    assert numbered(names, "beacon") == ["beacon_0", "beacon_12"]
    assert numbered(names, "b.acon") == ["b.acon_1"]


def test_names_are_numbered_but_that_of_one_model():
    assert list(places_of(wanted(prefix="post", pattern="line", count=2))) == ["post_0", "post_1"]
    assert list(places_of(wanted(name="robot1", poses=[[1, 2]]))) == ["robot1"]
    with refuses("~name is 'robot1': 3 models cannot share one name", ParameterError):
        places_of(wanted(name="robot1"))


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


@cases("""
x:
  - "-1"
  - -.5
  - -1e-3
  - "+2"
  - -2E+1
  - "-3."
""")
def test_numbers_in_any_spelling(x):
    found = parse(f"-sdf -stdin -model m -x {x} -J j {x}")
    assert found.pose == Pose((float(x), 0.0, 0.0))
    assert found.joints["j"] == pytest.approx(float(x), abs=1e-15)


@cases("""
line, fields:
  # Lines, and what they say in the namespace /left/.
  -urdf -stdin -model m: "{robot_namespace: /left/, source: [stdin, '']}"
  -urdf -stdin -model m -namespace /right: "{robot_namespace: /right}"
  -sdf -database table -model t: "{source: [database, table]}"
  -gazebo -file f -model t: "{urdf: false}"
""")
def test_namespaces_and_sources(line, fields):
    check(parse(line, "/left/"), fields)


@cases("""
line, reason:
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
""")
def test_refusals(line, reason):
    with refuses(re.escape(reason), ArgumentsError):
        parse(line)


def test_empty_names():
    with refuses("-model: it is empty", ArgumentsError):
        parse_spawn_arguments(["-urdf", "-stdin", "-model", ""])


def test_meshes_of_packages_as_models():
    text = """<mesh filename="package://a/b.dae"/><mesh scale="1 1 1" filename='package://c/d'/>
<texture filename="package://e/f.png"/>"""
    assert packages_to_models(text) == (
        """<mesh filename="model://a/b.dae"/><mesh scale="1 1 1" filename='model://c/d'/>
<texture filename="package://e/f.png"/>"""
    )
