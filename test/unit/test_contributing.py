"""The worked examples of CONTRIBUTING.md work."""

import contextlib
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
from shared import PACKAGE
from std_msgs.msg import Header

from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.odometry_noise import MODELS, rule_of
from bullet_lab.reports import Reading
from bullet_lab.simulation import plugins
from bullet_lab.simulation.plugins.controllers import controller
from bullet_lab.simulation.world.sdf import read_spawned
from bullet_lab.studies.noise_study.study import StudySettings, study
from bullet_lab.vision import features

sys.path.insert(0, str(Path(__file__).parent / "simulation" / "plugins" / "controllers"))
import control_robots  # noqa: E402

PAGE = (PACKAGE / "CONTRIBUTING.md").read_text()
# The code of each file, by its name in the line above it.
FILES = dict(re.findall(r"`([\w/]+)\.\w+`\n\n```\w+\n(.*?)```", PAGE, flags=re.DOTALL))
MAST = """
<sdf version="1.6"><model name="mast"><pose>0 0 1.5 0 0 0</pose><static>true</static>
<link name="link"/><plugin name="altimeter" filename="libmy_altimeter.so"/></model></sdf>
"""


def named(file, name):
    """Run a file of CONTRIBUTING.md, and return what has a name there."""
    space = {"__name__": "contributed"}
    exec(FILES[f"src/bullet_lab/{file}"], space)
    return space[name]


@pytest.fixture(autouse=True)
def forgotten():
    """What a test makes known is unknown afterwards: plugins, controllers and noise models."""
    with contextlib.ExitStack() as stack:
        for known in (plugins._KINDS, controller.CONTROLLERS, MODELS):
            stack.enter_context(mock.patch.dict(known))
        yield


def test_the_plugin_measures(world):
    named("simulation/plugins/altimeter", "Altimeter")
    robot = world.add(read_spawned(MAST, "mast"))
    heights = []
    robot.listen("height", heights.append)
    world.run_for(1.0)
    assert len(heights) in (10, 11)
    assert heights[-1].range == pytest.approx(1.5)


def test_the_controller_brakes(world):
    named("simulation/plugins/controllers/brake", "JointBrake")
    _, manager = control_robots.spawn(world)
    settings = {"type": "my_controllers/JointBrake", "joint": "turntable_joint", "damping": 0.05}
    control_robots.run(manager, "brake", **settings)
    joint = manager.joints["turntable_joint"]
    world.run_for(0.1)
    assert joint.velocity == pytest.approx(0.0, abs=1e-3)
    joint.body.set_joint("turntable_joint", 0.0, 2.0)
    world.run_for(0.01)
    assert joint.command == pytest.approx(-0.05 * joint.velocity)
    assert 0.0 < joint.velocity < 2.0


def test_the_detector_finds_spots(monkeypatch):
    monkeypatch.setattr(features, "bright_spots", named("vision/features", "bright_spots"), False)
    node = object.__new__(named("ros/nodes/bright_spots", "BrightSpots"))
    node.parameters = named("ros/nodes/bright_spots", "SpotParameters")(least=100)
    sent = {}
    node.publish = sent.__setitem__
    grey = np.zeros((20, 30), np.uint8)
    grey[4:7, 10:15] = 120
    figures = node.process(SimpleNamespace(grey=grey, header=Header()))
    assert figures == {"spots": 1}
    (point,) = sent["points"].points
    assert (point.x, point.y, point.z) == (12.0, 5.0, 15.0)


def test_the_report_leaves_its_files(tmp_path):
    report = named("reports/shake", "ShakeReport")(tmp_path)
    for step in range(10):
        report.take("imu", Reading(step * 10**7, (0.0, 0.0, 9.8, 0.0, 0.0, 0.1)))
    assert report.summary(True, {"seed": 1}) == {"finished": True, "readings": 10, "seed": 1}
    assert set(report.figures({})) == {"shake.png"}
    assert (tmp_path / "imu.csv").exists()


def test_the_job_is_declared_by_its_launch_file(tmp_path):
    pytest.importorskip("roslaunch")
    from bullet_lab.jobs.declaration import read_job

    path = tmp_path / "shake.launch"
    path.write_text(FILES["launch/shake"])
    job = read_job(path, PACKAGE)
    assert job.summary == "Records how a robot shakes while it drives a side."
    assert (list(job.arguments), job.smallest) == (["out", "rtf", "side"], "side:=0.2")
    assert job.arguments["side"].help("")[0] == "side:=2"


def test_the_noise_model_is_studied():
    named("noise/odometry_noise", "SlipRule")
    assert rule_of("slip", {"slip": 0.5}).slip == 0.5
    assert "slip" in MODELS
    way = np.column_stack([np.linspace(0.0, 2.0, 50), np.zeros(50), np.zeros(50)])
    settings = StudySettings(levels=(0.05,), models=("slip",), rates=(10.0,), paths=500)
    (case,) = study(Trajectory(0.1 * np.arange(50), way), settings)
    # 500 paths: the relative deviation is 3 %.
    exact = case.theory.exact.rms_distance()
    assert case.rms_distance[-1] == pytest.approx(exact[-1], rel=0.12)
