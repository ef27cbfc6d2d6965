"""The worked examples of CONTRIBUTING.md work."""

import re
from pathlib import Path

import numpy as np
import pytest

from bullet_lab.core.trajectory import Trajectory
from bullet_lab.noise.odometry_noise import MODELS, rule_of
from bullet_lab.reports import Reading
from bullet_lab.simulation import plugins
from bullet_lab.simulation.world.sdf import read_model_text
from bullet_lab.studies.noise_study.study import StudySettings, run_study

ROOT = Path(__file__).resolve().parents[2]
PLUGIN, REPORT, MODEL = re.findall(
    r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), flags=re.DOTALL
)
MAST = """
<sdf version="1.6"><model name="mast"><pose>0 0 1.5 0 0 0</pose><static>true</static>
<link name="link"/><plugin name="altimeter" filename="libmy_altimeter.so"/></model></sdf>
"""


def named(text, name):
    """Return what a block of code calls by a name; run as a module of its own."""
    space = {"__name__": "contributed"}
    exec(text, space)
    return space[name]


@pytest.fixture
def forgotten(monkeypatch):
    """Plugins that a test makes known are unknown afterwards."""
    monkeypatch.setattr(plugins, "_KINDS", dict(plugins._KINDS))


def test_the_plugin_measures(world, forgotten):
    named(PLUGIN, "Altimeter")
    robot = world.add(read_model_text(MAST, "mast"))
    heights = []
    robot.listen("height", heights.append)
    world.run_for(1.0)
    assert len(heights) in (10, 11)
    assert heights[-1].range == pytest.approx(1.5)


def test_the_report_leaves_its_files(tmp_path):
    report = named(REPORT, "ShakeReport")(tmp_path)
    for step in range(10):
        report.take("imu", Reading(step * 10**7, (0.0, 0.0, 9.8, 0.0, 0.0, 0.1)))
    assert report.summary(True, {"seed": 1}) == {"finished": True, "readings": 10, "seed": 1}
    assert set(report.figures({})) == {"shake.png"}
    assert (tmp_path / "imu.csv").exists()


@pytest.fixture
def slip(monkeypatch):
    before = dict(MODELS)
    yield
    MODELS.clear()
    MODELS.update(before)


def test_the_noise_model_is_studied(slip, tmp_path):
    named(MODEL, "SlipRule")
    assert rule_of("slip", {"slip": 0.5}).slip == 0.5
    assert "slip" in MODELS
    way = np.column_stack([np.linspace(0.0, 2.0, 50), np.zeros(50), np.zeros(50)])
    settings = StudySettings(levels=(0.05,), models=("slip",), rates=(10.0,), paths=500)
    summary = run_study(tmp_path, settings, Trajectory(0.1 * np.arange(50), way))
    (case,) = summary["cases"]
    pose = case["final_pose_error"]
    exact, sample = (np.array(pose[f"{kind}_covariance"])[0, 0] for kind in ("exact", "sample"))
    # 500 paths: the variance's relative deviation is 6 %.
    assert sample == pytest.approx(exact, rel=0.25)
