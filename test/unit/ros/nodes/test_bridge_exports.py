import os

import pytest

from bullet_lab.ros.nodes import bridge
from bullet_lab.ros.nodes.bridge import add_exported_paths


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


@pytest.fixture
def listed(packages, monkeypatch):
    """A function that returns the folders of both variables after those of the user."""

    class Packages:
        def list(self):
            return ["two", "one", "without", "none", "broken"]

        def get_path(self, name):
            return str(packages / name)

    def add(models, media):
        monkeypatch.setenv("GAZEBO_MODEL_PATH", models)
        monkeypatch.setenv("GAZEBO_RESOURCE_PATH", media)
        add_exported_paths()
        variables = ("GAZEBO_MODEL_PATH", "GAZEBO_RESOURCE_PATH")
        return [os.environ[name].split(os.pathsep) for name in variables]

    monkeypatch.setattr(bridge.rospkg, "RosPack", Packages)
    return add


@pytest.mark.parametrize("mine, before", [("", []), ("/mine:/two", ["/mine", "/two"])])
def test_what_packages_export_comes_after_what_the_user_says(packages, listed, mine, before):
    models, media = listed(mine, "")
    assert models == list(dict.fromkeys([*before, f"{packages}/one/models", "/opt/m", "/two"]))
    assert media == [f"{packages}/two"]
