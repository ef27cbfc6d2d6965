import os

from shared import cases

from bullet_lab.ros.nodes import bridge
from bullet_lab.ros.nodes.bridge import add_exported_paths

EXPORTS = {
    "one": '<gazebo_ros gazebo_model_path="${prefix}/models:/opt/m" plugin_path="/x"/>',
    "two": '<gazebo_ros gazebo_media_path="${prefix}"/><gazebo_ros gazebo_model_path="/two"/>',
    "none": '<nodelet plugin="p.xml"/>',
    "broken": "gazebo_ros<",
}


class Packages:
    """Packages in a folder, of which one has no package.xml."""

    def __init__(self, folder):
        self.folder = folder
        for name, export in EXPORTS.items():
            (folder / name).mkdir()
            text = f"<package><name>{name}</name><export>{export}</export></package>"
            (folder / name / "package.xml").write_text(text)

    def list(self):
        return ["without", *sorted(EXPORTS, reverse=True)]

    def get_path(self, name):
        return str(self.folder / name)


@cases("""
mine, before:
  - ["", []]
  - [/mine:/two, [/mine, /two]]
""")
def test_what_packages_export_comes_after_what_the_user_says(tmp_path, monkeypatch, mine, before):
    packages = Packages(tmp_path)
    monkeypatch.setattr(bridge.rospkg, "RosPack", lambda: packages)
    monkeypatch.setenv("GAZEBO_MODEL_PATH", mine)
    monkeypatch.setenv("GAZEBO_RESOURCE_PATH", "")
    add_exported_paths()
    models, media = (
        os.environ[name].split(os.pathsep) for name in ("GAZEBO_MODEL_PATH", "GAZEBO_RESOURCE_PATH")
    )
    assert models == list(dict.fromkeys([*before, f"{tmp_path}/one/models", "/opt/m", "/two"]))
    assert media == [f"{tmp_path}/two"]
