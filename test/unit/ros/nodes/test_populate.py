import pytest
import yaml

from bullet_lab.core.parameters import ParameterError, read_parameters
from bullet_lab.errors import LabError
from bullet_lab.ros.gazebo.client import numbered
from bullet_lab.ros.nodes.populate import PopulateParameters, description_of, names_of, places_of
from bullet_lab.simulation.world.sdf import read_spawned


def wanted(**given):
    return read_parameters(PopulateParameters, lambda name, default: given.get(name[1:], default))


POSES = """
# By default, the three beacons of the report.
- [{}, [[1.0, 1.0, 0.0], [5.0, 1.0, 0.0], [-5.0, 1.0, 0.0]]]
- [{poses: [[1, 2], [3, 4, 0.5]]}, [[1, 2, 0], [3, 4, 0.5]]]
"""


@pytest.mark.parametrize("given, places", yaml.safe_load(POSES))
def test_poses(given, places):
    assert list(map(list, places_of(wanted(**given)))) == places


def test_the_model_is_a_beacon():
    model = read_spawned(description_of(wanted().model), "beacon")
    assert model.static
    assert model.links[0].collisions[0].geometry.path.name == "beacon.dae"


@pytest.mark.parametrize("pattern", ["line", "grid", "circle"])
def test_other_patterns_have_as_many_places_as_asked_for(pattern):
    assert len(set(places_of(wanted(pattern=pattern, count=7)))) == 7


NO_POSES = "[5, [1, 2], [[1]], [[1, 2, 3, 4]], [['1', '2']], [[true, 1]], [[.nan, 0]]]"


@pytest.mark.parametrize("poses", yaml.safe_load(NO_POSES))
def test_poses_that_are_none(poses):
    with pytest.raises(ParameterError, match=r"~poses is .*: it must be a list of \[x, y\]"):
        wanted(poses=poses)


def test_descriptions_are_files_or_references(package, tmp_path):
    path = package / "urdf" / "beacon.urdf"
    for name in (str(path), "package://bullet_lab/urdf/beacon.urdf"):
        assert description_of(name) == path.read_text()
    folder = read_spawned(description_of(str(package / "models" / "beacon")), "folder")
    assert folder.name == "beacon"
    assert "model://a&amp;b" in description_of("model://a&b")
    with pytest.raises(LabError, match="no such file"):
        description_of(str(tmp_path / "nix.sdf"))


def test_only_numbered_names_are_taken_away():
    names = ["beacon", "beacon_0", "beacon_12", "beacon_x", "beacon_1_2", "a_beacon_1", "b.acon_1"]
    assert numbered(names, "beacon") == ["beacon_0", "beacon_12"]
    assert numbered(names, "b.acon") == ["b.acon_1"]


def test_names_are_numbered_but_that_of_one_model():
    assert names_of(wanted(prefix="post", pattern="line", count=2)) == ["post_0", "post_1"]
    assert names_of(wanted(name="robot1", poses=[[1, 2]])) == ["robot1"]
    with pytest.raises(ParameterError, match="~name is 'robot1': 3 models cannot share one name"):
        names_of(wanted(name="robot1"))
