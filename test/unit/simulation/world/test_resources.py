from pathlib import Path

import pytest
import yaml
from alike import assert_as_before

from bullet_lab.simulation.world import resources
from bullet_lab.simulation.world.resources import (
    ResourceError,
    ResourceFinder,
    package_share,
    package_uri,
    ros_package_folder,
)


@pytest.fixture
def files(tmp_path):
    """A package with a document and a mesh, a folder of models, and a secret beside them."""
    for name in ("pkg/urdf/a.urdf", "pkg/meshes/m x.stl", "pkg/package.xml", "secret/s.stl"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    for name in ("first/car", "second/car", "second/tree/a b.dae"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "pkg/meshes/link.stl").symlink_to(tmp_path / "secret/s.stl")
    (tmp_path / "first/way_out").symlink_to(tmp_path / "secret")
    return tmp_path


@pytest.fixture
def finder(files, monkeypatch):
    packages = {"pkg": files / "pkg"}
    monkeypatch.setattr(resources, "ros_package_folder", packages.get)
    monkeypatch.setenv("GAZEBO_MODEL_PATH", f"{files}/first:{files}/second")
    return ResourceFinder(files / "pkg" / "urdf")


# The file, and the package as it lies on another machine, are HERE and ELSEWHERE.
URIS = """
- package://pkg/meshes/m%20x.stl
- package://pkg/urdf/../meshes/m%20x.stl
- a.urdf
- file://HERE/pkg/meshes/m%20x.stl
- HERE/pkg/meshes/m x.stl
- model://car
- model://pkg/meshes/m%20x.stl
- model://tree
- model:///tree
- ELSEWHERE/urdf/a.urdf
- file://ELSEWHERE/urdf/a.urdf
- ''
- package://nix/a
- package://pkg/../secret/s.stl
- package://pkg/%2e%2e/secret/s.stl
- package://pkg/meshes/link.stl
- package://../secret/s.stl
- ../../secret/s.stl
- HERE/pkg/../secret/s.stl
- HERE/pkg/meshes/link.stl
- HERE/secret/s.stl
- /etc/passwd
- file:///etc/passwd
- FILE:///etc/passwd
- file://elsewhere/etc/passwd
- http://127.0.0.1:1/m.stl
- data:,x
- http://[
- ELSEWHERE/meshes/nix.stl
- ELSEWHERE/../../secret/s.stl
- file://ELSEWHERE/meshes/nix.stl
- file://ELSEWHERE/../../secret/s.stl
- model://nix
- model://tree/a%20b.dae
- model://../secret/s.stl
- model://car/../../secret/s.stl
# Whether a file outside exists is not told.
- model://../secret/nix.stl
- model://way_out/s.stl
- model://pkg/../secret/s.stl
- model://pkg/meshes/link.stl
- model://pkg
- model://pkg/nix.stl
- "a\\nb"
"""


def test_what_may_be_found_and_what_not_are_as_before(finder, files):
    told = []
    for uri in yaml.safe_load(URIS):
        there = uri.replace("ELSEWHERE", "/home/student/catkin_ws/src/pkg")
        there = there.replace("HERE", str(files))
        try:
            found = finder.find(there).resolve()
            said = f"{uri}: {found} is {package_uri(found) or 'of no package'}"
        except ResourceError as error:
            said = str(error)
        told.append(said.replace(str(files), "HERE"))
        assert "\n" not in told[-1]
    assert_as_before(told, Path(__file__).with_name("resources.txt"))


@pytest.mark.parametrize(
    ("name", "said"), [("%00", "null (byte|character)|no such file"), (300 * "a", "too long")]
)
def test_a_name_that_no_file_can_have(finder, name, said):
    with pytest.raises(ResourceError, match=said):
        finder.find(f"package://pkg/{name}")


def test_a_text_lies_in_no_folder(files):
    with pytest.raises(ResourceError, match="'m.stl': a relative path in a text"):
        ResourceFinder().find("m.stl")


def test_the_user_may_name_any_file(files, monkeypatch):
    monkeypatch.chdir(files)
    anywhere = ResourceFinder.anywhere()
    assert anywhere.find("secret/s.stl") == files / "secret/s.stl"
    assert anywhere.find("pkg/../secret/s.stl").samefile(files / "secret/s.stl")
    assert anywhere.find(f"file://{files}/secret/s.stl") == files / "secret/s.stl"
    with pytest.raises(ResourceError, match="no such file"):
        anywhere.find("nix")
    with pytest.raises(ResourceError, match="outside the folders"):
        ResourceFinder(files / "pkg/urdf").find("/etc/passwd")


def test_the_lab_finds_itself(package):
    assert ros_package_folder("bullet_lab") == package
    assert ros_package_folder("no_such_package") is None


def test_an_installed_lab_finds_its_share(tmp_path, monkeypatch):
    library, prefix = "lib/python3/dist-packages/bullet_lab", tmp_path / "local"
    place = prefix / library / "simulation/world/resources.py"
    monkeypatch.setattr(resources, "__file__", str(place))
    for above in (tmp_path, prefix):
        with pytest.raises(ResourceError, match=f"neither in {prefix}/lib/python3 nor installed"):
            package_share()
        (above / "share/bullet_lab").mkdir(parents=True)
        (above / "share/bullet_lab/package.xml").touch()
    assert package_share() == prefix / "share/bullet_lab"


def test_the_order_of_model_folders_is_gazebos(files, monkeypatch):
    monkeypatch.setenv("HOME", str(files))
    monkeypatch.setenv("GAZEBO_MODEL_PATH", f":{files}/first:{files}/second")
    own = files / ".gazebo" / "models"
    finder, lab = ResourceFinder(), package_share() / "models"
    for name in ("car", "tree", "beacon"):
        (own / name).mkdir(parents=True)
    for folder, name in ((own, "car"), (own, "beacon"), (lab, "sun")):
        assert finder.find(f"model://{name}") == folder / name
    for name in ("car", "beacon"):
        (own / name).rmdir()
    for folder, name in ((files / "first", "car"), (lab, "beacon")):
        assert finder.find(f"model://{name}") == folder / name
    (files / "first" / "sun").mkdir()
    assert finder.find("model://sun") == files / "first" / "sun"


def test_relative_paths_are_looked_up_in_gazebo_resource_path(finder, files, monkeypatch):
    (files / "media").mkdir()
    (files / "media/m.stl").touch()
    (files / "a.urdf").touch()
    monkeypatch.setenv("GAZEBO_RESOURCE_PATH", str(files))
    for folder in ("models", "media/models", "Media/models"):
        tree = files / folder / f"{folder[0]}{len(folder)}.dae"
        tree.parent.mkdir(parents=True)
        tree.touch()
        assert finder.find(f"file://{tree.name}") == tree
    assert finder.find("file://media/m.stl") == files / "media/m.stl"
    assert finder.find("media/m.stl") == files / "media/m.stl"
    assert finder.find("a.urdf") == files / "pkg/urdf/a.urdf"
    assert ResourceFinder().find("media/m.stl") == files / "media/m.stl"
    with pytest.raises(ResourceError, match="leaves its folder"):
        finder.find("file://media/../../x")
