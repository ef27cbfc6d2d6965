"""Names of before the house was built anew still import, with a warning."""

import importlib
import subprocess
import sys

import pytest

from bullet_lab.moved import MOVED

# What needs ROS, or is no module to be imported.
APART = ("ros.", "simulation.xacro_child")


@pytest.mark.parametrize("old", [name for name in MOVED if not name.startswith(APART)])
def test_an_old_name_gives_the_new_module(old):
    sys.modules.pop(f"bullet_lab.{old}", None)
    with pytest.warns(DeprecationWarning, match=MOVED[old].replace(".", r"\.")):
        module = importlib.import_module(f"bullet_lab.{old}")
    assert module is importlib.import_module(f"bullet_lab.{MOVED[old]}")
    assert module.__name__ == module.__spec__.name == f"bullet_lab.{MOVED[old]}"


@pytest.mark.parametrize("old", MOVED)
def test_what_is_named_exists(old):
    assert importlib.util.find_spec(f"bullet_lab.{MOVED[old]}") is not None


def test_a_module_that_is_a_package_now_still_gives_its_names():
    with pytest.warns(DeprecationWarning, match="simulation.physics.physics"):
        from bullet_lab.simulation.physics import Body
    from bullet_lab.simulation.physics.physics import Body as Now

    assert Body is Now


def test_what_never_was_is_not_found():
    with pytest.raises(ModuleNotFoundError, match="bullet_lab.numerics.nothing"):
        importlib.import_module("bullet_lab.numerics.nothing")
    with pytest.raises(ImportError, match="Nothing"):
        from bullet_lab.simulation.physics import Nothing  # noqa: F401


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["dock_campaign", "detection_range", "noise_study", "published_noise"]
)
def test_an_old_name_runs_as_a_program(name):
    done = subprocess.run(
        [sys.executable, "-m", f"bullet_lab.experiments.{name}", "--help"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0
    assert "usage" in done.stdout


def test_the_package_of_a_study_runs_it_and_leaves_its_classes_where_workers_find_them():
    name = "bullet_lab.studies.dock_campaign.__main__"
    # In a process of its own: here, it may have been imported by another test.
    program = f"""
import importlib.util
import bullet_lab
print(*importlib.util.find_spec("{name}").loader.get_code("{name}").co_names)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "main" in done.stdout.split()
    assert "CampaignSettings" not in done.stdout
