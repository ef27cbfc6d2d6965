"""The docking worlds, the models in them, and the program that made these."""

import re
import shlex

import numpy as np
import pytest
from PIL import Image
from shared import cases

from bullet_lab.markers import main
from bullet_lab.simulation.world.resources import package_share
from bullet_lab.simulation.world.sdf import read_world_file

ROOT = package_share()
COMMANDS = {
    "docking_station": "--on dock",
    "docking_station_dots": "--on dock --dots",
    "docking_station_nested": "--on dock --size 0.075 --around 0.8",
    "marker_panel": "--on panel",
    "marker_panel_large": "--on panel --size 0.35",
}


def world(name):
    return read_world_file(ROOT / "worlds" / f"{name}.world")


def model(name, of):
    return next(m for m in of.models if m.name == name)


@cases("name: [docking_dark, docking_bright, docking_backlit]")
def test_the_lights_are_all_that_differs(name):
    plain, other = world("docking"), world(name)
    assert [m.name for m in other.models] == [m.name for m in plain.models]
    for one, two in zip(plain.models, other.models):
        assert (one.pose, repr(one.links)) == (two.pose, repr(two.links))
    assert (plain.lights, plain.ambient) != (other.lights, other.ambient)


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_the_models_are_what_the_documented_command_makes(name, tmp_path, capsys):
    assert run(f"{tmp_path / name} {COMMANDS[name]}") == 0
    made = {p.relative_to(tmp_path): p for p in tmp_path.rglob("*") if p.is_file()}
    kept = {p.relative_to(ROOT / "models") for p in (ROOT / "models" / name).rglob("*.*")}
    assert set(made) == {path for path in kept if (ROOT / "models" / path).is_file()}
    for path, file in made.items():
        committed = ROOT / "models" / path
        if path.suffix == ".png":
            # How well a picture is packed depends on the version of the library.
            assert np.array_equal(np.asarray(Image.open(file)), np.asarray(Image.open(committed)))
        else:
            assert file.read_text() == committed.read_text(), path


def test_a_made_model_can_be_put_into_a_world(tmp_path, monkeypatch, capsys):
    assert run(f"{tmp_path}/my_panel --on panel --dictionary DICT_4X4_50 --height 0.3 --id 4") == 0
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path))
    text = (ROOT / "worlds" / "marker_panel.world").read_text()
    (tmp_path / "my.world").write_text(text.replace("model://marker_panel", "model://my_panel"))
    panel = model("marker_panel", read_world_file(tmp_path / "my.world"))
    (link,) = panel.links
    plate = panel.pose * link.pose * link.collisions[0].pose
    assert plate.position[2] == pytest.approx(0.3)


@cases("""
words, said:
  - [x --id 99999, not 99999]
  - [x --id one, invalid int value]
  - [x --dots, add --on dock]
  - [x --on dock --around 0.8 --dots, not both]
  - [x --on panel --height 0.1, in the floor]
  - ["'a name'", no name of a model]
  - [/proc/nowhere/x, cannot make the folder]
""")
def test_bad_arguments_are_refused_with_one_line(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(words) == 2
    error = capsys.readouterr().err
    assert said in error and re.fullmatch(r"make_marker: [^\n]*\n", error)


def run(words):
    with pytest.raises(SystemExit) as ended:
        main(shlex.split(words))
    return ended.value.code
