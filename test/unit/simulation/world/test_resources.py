import pytest
import yaml

from bullet_lab.simulation.world import resources
from bullet_lab.simulation.world.resources import (
    ResourceError,
    ResourceFinder,
    package_share,
    ros_package_folder,
)


@pytest.fixture
def files(tmp_path):
    """A package with a document and a mesh, a folder of models, and a secret beside them."""
    for name in ("pkg/urdf/a.urdf", "pkg/meshes/m x.stl", "pkg/package.xml", "secret/s.stl"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    for name in ("first/car", "second/car", "second/tree"):
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


def test_what_may_be_found(finder, files):
    mesh = files / "pkg/meshes/m x.stl"
    assert finder.find("package://pkg/meshes/m%20x.stl") == mesh
    assert finder.find("package://pkg/urdf/../meshes/m%20x.stl").samefile(mesh)
    assert finder.find("a.urdf") == files / "pkg/urdf/a.urdf"
    assert finder.find(f"file://{mesh}".replace(" ", "%20")) == mesh
    assert finder.find(str(mesh)) == mesh
    assert finder.find("model://car") == files / "first/car"
    assert finder.find("model://pkg/meshes/m%20x.stl") == mesh
    assert finder.find("model://tree") == files / "second/tree"
    assert finder.find("model:///tree") == files / "second/tree"


LONG = f"package://pkg/{300 * 'a'}", "File name too long"
LOST = """
- ['', no file is named]
- [package://nix/a, no ROS package 'nix']
- [package://pkg/../secret/s.stl, leaves its folder]
- [package://pkg/%2e%2e/secret/s.stl, leaves its folder]
- [package://pkg/meshes/link.stl, leaves its folder]
- [package://../secret/s.stl, no ROS package]
- [package://pkg/%00, null (byte|character)|no such file]
- [../../secret/s.stl, leaves its folder]
- [/etc/passwd, outside the folders]
- [file:///etc/passwd, outside the folders]
- [FILE:///etc/passwd, outside the folders]
- [file://elsewhere/etc/passwd, no such file]
- [http://127.0.0.1:1/m.stl, only package://]
- ['data:,x', only package://]
- ['http://[', Invalid IPv6]
- [model://nix, in none of the model folders]
- [model://../secret/s.stl, leaves its folder]
- [model://car/../../secret/s.stl, leaves its folder]
# Whether a file outside exists is not told.
- [model://../secret/nix.stl, leaves its folder]
- [model://way_out/s.stl, leaves its folder]
- [model://pkg/../secret/s.stl, leaves its folder]
- [model://pkg/meshes/link.stl, leaves its folder]
- [model://pkg, in none of the model folders]
- [model://pkg/nix.stl, in none of the model folders]
"""


@pytest.mark.parametrize("uri, message", [*yaml.safe_load(LOST), LONG])
def test_what_may_not_be_found_is_one_line(finder, uri, message):
    with pytest.raises(ResourceError, match=message) as caught:
        finder.find(uri)
    assert "\n" not in str(caught.value)
    assert uri[:60] in str(caught.value)


def test_absolute_paths_do_not_leave_by_dots_or_links(finder, files):
    for path in ("pkg/../secret/s.stl", "pkg/meshes/link.stl", "secret/s.stl"):
        with pytest.raises(ResourceError, match="outside the folders|leaves its folder"):
            finder.find(f"{files}/{path}")


@pytest.mark.parametrize("scheme", ["", "file://"])
def test_a_path_of_another_machine_is_searched_in_the_package_that_it_names(finder, files, scheme):
    elsewhere = f"{scheme}/home/student/catkin_ws/src/pkg"
    assert finder.find(f"{elsewhere}/urdf/a.urdf") == files / "pkg/urdf/a.urdf"
    with pytest.raises(ResourceError, match="no such file .*pkg/meshes/nix.stl"):
        finder.find(f"{elsewhere}/meshes/nix.stl")
    with pytest.raises(ResourceError, match="leaves its folder"):
        finder.find(f"{elsewhere}/../../secret/s.stl")


def test_a_text_lies_in_no_folder(files):
    with pytest.raises(ResourceError, match="'m.stl': a relative path in a text"):
        ResourceFinder().find("m.stl")


def test_a_message_is_one_line_whatever_it_quotes(finder):
    with pytest.raises(ResourceError) as caught:
        finder.find("a\nb")
    assert "\n" not in str(caught.value)


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
