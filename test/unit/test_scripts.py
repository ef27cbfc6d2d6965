"""What the scripts have in common."""

import ast
import importlib
import importlib.util
import json
import os
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import yaml
from shared import PACKAGE, python


def test_the_lab_is_found_through_a_link_to_its_scripts(tmp_path):
    (tmp_path / "scripts").symlink_to(PACKAGE / "scripts")
    command = f"source {tmp_path}/scripts/environment.sh && echo $LAB_ROOT"
    run = subprocess.run(["bash", "-c", command], stdout=subprocess.PIPE, text=True, check=True)
    assert run.stdout.strip() == str(PACKAGE)


def of_setup(lines):
    command = f"source {PACKAGE}/scripts/setup.sh; {lines}"
    return subprocess.run(["bash", "-c", command], capture_output=True, text=True)


def test_who_may_not_write_to_a_clone_is_told_who_sets_it_up():
    # Not even root makes a folder there.
    run = of_setup("LAB_ROOT=/proc LAB_DIR=/proc/build; take_lock --with course")
    assert run.returncode == 1
    assert run.stderr.splitlines() == [
        "setup: something is missing, and you may not write to /proc/build; its owner, root, "
        "has to run: /proc/scripts/setup.sh --with course"
    ]


def test_no_build_leaves_out_the_build_alone():
    steps = of_setup("steps_of --with course").stdout.split()
    least = ["debian-first", "debian-base", "python-base", "build"]
    assert steps == [*least, "debian-more", "debian-course"]
    assert of_setup("steps_of --least").stdout.split() == least
    steps[steps.index("build")] = "debian-catkin"
    assert of_setup("steps_of --no-build --with course").stdout.split() == steps


# A failure of the update is ignored, that of the installation is not.
INSTALL = """
apt_get() {{
  [[ $1 == install ]] || mkdir {0}/busy && sleep 0.1; [[ $1 == update ]] || rmdir {0}/busy
}}
apt_install"""
GET_UV = """
UV_FOLDER={0}/uv UV={0}/uv/bin/uv
debians_pip() {{ mkdir $5/bin; sleep 0.1; install -m 755 /dev/null $5/bin/uv; }}
get_uv"""


@pytest.mark.parametrize(
    ("lines", "left"), [(INSTALL, []), (GET_UV, ["uv", "uv/bin", "uv/bin/uv"])]
)
def test_who_installs_at_the_same_time_waits_for_the_other(tmp_path, lines, left):
    with ThreadPoolExecutor() as pool:
        runs = list(pool.map(of_setup, [lines.format(tmp_path)] * 4))
    assert [run.returncode for run in runs] == [0] * 4, runs
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == left


def test_the_python_of_courses_is_made_by_the_set_up(tmp_path):
    # Whoever sources course.sh may not write to the clone.
    lines = f"LAB_DIR={tmp_path} LAB_COURSE={tmp_path}/course; mkdir {tmp_path}/stamp; "
    lines += "has_packages() { :; }; missing_of() { :; }; "
    lines += "mark_done debian-course; is_done debian-course || step_debian title log course; "
    lines += "is_done debian-course"
    assert of_setup(lines).returncode == 0
    for name in ("python", "python3"):
        assert os.readlink(tmp_path / "course" / name) == "/usr/bin/python3"


def test_the_first_job_needs_only_the_packages_that_come_first():
    pytest.importorskip("rospy")
    # Of the packages that setup.sh --least leaves out.
    later = ("tf2_ros", "rosbag", "rosmsg", "rosnode", "rosservice", "rostopic")
    launched = ("nodes.bridge", "nodes.noisy_odom", "nodes.drive_squares", "record.plots")
    lines = f"import sys, importlib; sys.modules.update(dict.fromkeys({later}))\n"
    lines += f"for name in {launched}: importlib.import_module(f'bullet_lab.ros.{{name}}')"
    assert python(lines) == (0, "", "")


def test_what_a_program_imports_and_runs_is_there():
    paths = [*(PACKAGE / "scripts").iterdir(), *(PACKAGE / "stand_ins").rglob("*")]
    texts = [path.read_bytes() for path in paths if path.is_file()]
    programs = [text.decode() for text in texts if text.startswith(b"#!/usr/bin/env python3")]
    assert len(programs) > 30
    for text in programs:
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module.startswith("bullet_lab."):
                module = importlib.import_module(node.module)
                assert all(hasattr(module, alias.name) for alias in node.names), text
        for name, function in re.findall(r'\b(?:run\(|MAIN = )"([\w.]+):?(\w*)"', text):
            source = Path(importlib.util.find_spec(name).origin).read_text()
            assert re.search(rf"^(def )?{function or 'main'}\b", source, re.MULTILINE), text


def test_containers_and_bare_systems_have_the_same_packages():
    listed = {
        "Dockerfile": r"--no-install-recommends ([\w -]+)",
        ".github/workflows/ci.yml": r"--no-install-recommends ([\w -]+)",
        "scripts/platform.sh": r"--include=([\w,-]+)",
    }
    found = [re.search(words, (PACKAGE / file).read_text())[1] for file, words in listed.items()]
    assert {frozenset(re.split("[ ,]", names.strip())) for names in found} == {
        frozenset({"git", "sudo", "ca-certificates"})
    }
    assert json.loads((PACKAGE / ".devcontainer/devcontainer.json").read_text())["build"]
    assert yaml.safe_load((PACKAGE / ".github/workflows/ci.yml").read_text())["jobs"]
