import os

import pytest

pytest.importorskip("rospkg")

from bullet_lab.ros.gazebo import exports as module
from bullet_lab.ros.gazebo.exports import add_exported_paths, exported_paths


@pytest.fixture
def packages(tmp_path):
    exports = {
        "one": '<gazebo_ros gazebo_model_path="${prefix}/models:/opt/m" plugin_path="/x"/>',
        "two": '<gazebo_ros gazebo_media_path="${prefix}"/><gazebo_ros gazebo_model_path="/two"/>',
        "none": '<nodelet plugin="p.xml"/>',
    }
    for name, export in exports.items():
        (tmp_path / name).mkdir()
        text = f"<package><name>{name}</name><export>{export}</export></package>"
        (tmp_path / name / "package.xml").write_text(text)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "package.xml").write_text("<package> gazebo_ros")
    return tmp_path


def folders(packages):
    return [packages / name for name in ("broken", "none", "one", "two", "without")]


def test_what_packages_export(packages):
    assert exported_paths(folders(packages)) == {
        "GAZEBO_MODEL_PATH": [f"{packages}/one/models", "/opt/m", "/two"],
        "GAZEBO_RESOURCE_PATH": [f"{packages}/two"],
    }


def test_it_comes_after_what_the_user_says(packages, monkeypatch):
    class Packages:
        def list(self):
            return ["two", "one"]

        def get_path(self, name):
            return str(packages / name)

    monkeypatch.setattr(module.rospkg, "RosPack", Packages)
    monkeypatch.setenv("GAZEBO_MODEL_PATH", "/mine:/two")
    monkeypatch.delenv("GAZEBO_RESOURCE_PATH", raising=False)
    add_exported_paths()
    listed = os.environ["GAZEBO_MODEL_PATH"].split(os.pathsep)
    assert listed == ["/mine", "/two", f"{packages}/one/models", "/opt/m"]
    assert os.environ["GAZEBO_RESOURCE_PATH"] == f"{packages}/two"
