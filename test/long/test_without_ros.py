"""Installed by pip into an empty environment, the lab gives without ROS what run.sh gives."""

import json
import os
import shutil
import subprocess

import numpy
import pytest
from programs import PACKAGE, printed

NOTEBOOK = PACKAGE / "docs" / "first_steps.ipynb"
UV = PACKAGE / "build" / "uv" / "bin" / "uv"
# What says where ROS and other Python packages are.
ROS_NAMES = ("PYTHONPATH", "PYTHONHOME", "CMAKE_PREFIX_PATH", "LD_LIBRARY_PATH")
CLEAN = {
    name: value
    for name, value in os.environ.items()
    if name not in ROS_NAMES and not name.startswith("ROS")
}
# Entries of summary.json that tell of the run, not of its results.
OF_A_RUN = {"rtf", "wall_time_s", "real_time_factor", "refused_messages"}
# Smallest runs, as in the launch files.
JOBS = {
    "squares": ("std:=0.1", "seed:=1"),
    "noise_study": ("paths:=50", "rates:=5", "levels:=0 0.1 0.5"),
}


def run(*words, folder, **environment):
    return printed(*words, cwd=folder, env={**CLEAN, **environment})


def by_pip(environment, source, versions):
    run("/usr/bin/python3", "-m", "venv", environment, folder=source)
    run(environment / "bin/pip", "install", "--quiet", "-c", versions, source, folder=source)


def by_uv(environment, source, versions):
    if not UV.is_file():
        pytest.skip("scripts/setup.sh has used pip instead of uv")
    # PYTHON313 may name one; else uv finds or downloads it.
    python = os.environ.get("PYTHON313", "3.13")
    make = (UV, "--no-config", "venv", "--no-project", "--python", python, environment)
    if subprocess.run(make, env=CLEAN, stderr=subprocess.DEVNULL).returncode:
        pytest.skip("there is no Python 3.13, and uv cannot download one")
    install = (UV, "--no-config", "pip", "install", "--python", environment)
    run(*install, "-c", versions, source, folder=source)


@pytest.fixture(scope="module", params=[by_pip, by_uv], ids=["pip", "uv-3.13"])
def programs(request, tmp_path_factory):
    """Install a copy of the package; return the folder of the environment's executables."""
    folder = tmp_path_factory.mktemp("without_ros")
    ignored = shutil.ignore_patterns("build", "results", ".git", "*.egg-info")
    shutil.copytree(PACKAGE, folder / "source", ignore=ignored)
    # The versions of run.sh: others may draw pictures with other bytes.
    lines = (PACKAGE / "requirements.lock").read_text().splitlines()
    pins = [line.rstrip(" \\") for line in lines if "==" in line and line[0].isalpha()]
    (folder / "versions.txt").write_text("\n".join(pins))
    request.param(folder / "environment", folder / "source", folder / "versions.txt")
    shutil.rmtree(folder / "source")
    return folder / "environment" / "bin"


@pytest.fixture(scope="module")
def with_ros(tmp_path_factory):
    """Return a folder with the results of run.sh for each of the jobs."""
    folder = tmp_path_factory.mktemp("with_ros")
    for job, words in JOBS.items():
        run(PACKAGE / "scripts/run.sh", job, *words, folder=folder)
    return folder / "results"


def files(folder):
    """Return the contents of all files below a folder, without logs, by their paths."""
    paths = (path for path in folder.rglob("*") if path.is_file())
    found = {str(path.relative_to(folder)): path.read_bytes() for path in paths}
    return {name: content for name, content in found.items() if not name.startswith("log/")}


def assert_same(folder, reference):
    ours, theirs = files(folder), files(reference)
    found, wanted = (json.loads(each.pop("summary.json")) for each in (ours, theirs))
    assert {**found, **dict.fromkeys(OF_A_RUN)} == {**wanted, **dict.fromkeys(OF_A_RUN)}
    assert ours.keys() == theirs.keys()
    assert not [name for name in ours if ours[name] != theirs[name]]


def test_there_is_no_ros(programs, tmp_path):
    names = ("rospy", "roslaunch", "rospkg", "genpy", "catkin_pkg")
    code = f"import importlib.util as u; raise SystemExit(any(map(u.find_spec, {names})))"
    run(programs / "python", "-c", code, folder=tmp_path)


@pytest.mark.parametrize("job", JOBS)
def test_a_job_leaves_the_files_of_the_job_with_ros(job, programs, with_ros, tmp_path):
    told = run(programs / "bullet_lab", job, *JOBS[job], folder=tmp_path)
    assert f"{job}: done after" in told
    ours, theirs = tmp_path / "results" / job, with_ros / job
    # Another numpy rounds the last bits of sums of many numbers otherwise.
    version = run(programs / "python", "-c", "import numpy; print(numpy.__version__)", folder=".")
    if job == "squares" or version.strip() == numpy.__version__:
        assert_same(ours, theirs)
    else:
        assert files(ours).keys() == files(theirs).keys()


def test_a_job_with_worker_processes_and_robots_with_meshes(programs, tmp_path):
    words = ("side:=1", "runs:=2", "diameter_error:=0.002", "workers:=2")
    run(programs / "bullet_lab", "umbmark", *words, folder=tmp_path)
    summary = json.loads((tmp_path / "results/umbmark/summary.json").read_text())
    assert summary["diameter_error"] == 0.002


def test_the_notebook_runs_and_gives_the_picture_of_the_job(programs, with_ros, tmp_path):
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert len(code) >= 4
    (tmp_path / "cells.py").write_text("\n".join(code))
    told = run(programs / "python", "cells.py", folder=tmp_path, MPLBACKEND="agg")
    said = [
        "".join(output["text"])
        for cell in cells
        for output in cell.get("outputs", ())
        if output["output_type"] == "stream"
    ]
    assert "".join(said) == told
    assert_same(tmp_path / "results/squares", with_ros / "squares")
