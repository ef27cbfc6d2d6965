import re

import pytest
import yaml
from shared import PACKAGE

CONFIGURATIONS = sorted((PACKAGE / "rviz").glob("*.rviz"))
# Jobs that have no ROS nodes but one that computes: there is nothing to show.
WITHOUT = {
    "calibrate",
    "detection_range",
    "detectors",
    "grade",
    "map",
    "dock_campaign",
    "noise_study",
    "published_noise",
    "umbmark",
    "verify",
}


def test_each_job_has_a_configuration_of_its_own():
    for path in (PACKAGE / "launch").glob("*.launch"):
        named = re.findall(r"/rviz/(\w+)\.rviz", path.read_text())
        assert named == ([] if path.stem in WITHOUT else [path.stem])
        assert all((PACKAGE / "rviz" / f"{name}.rviz").is_file() for name in named)


@pytest.mark.parametrize("path", CONFIGURATIONS, ids=lambda path: path.stem)
def test_configurations_show_the_world_in_its_frame(path):
    manager = yaml.safe_load(path.read_text())["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "world"
    displays = manager["Displays"]
    names = [display["Name"] for display in displays]
    assert len(set(names)) == len(names)
    assert "/bullet_lab/world" in [display.get("Marker Topic") for display in displays]
    # Displays that come with RViz: others would be an error on a plain installation.
    assert all(display["Class"].startswith("rviz/") for display in displays)
