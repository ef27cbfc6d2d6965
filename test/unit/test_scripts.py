"""What the scripts have in common."""

import ast
import importlib
import importlib.util
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_the_lab_is_found_through_a_link_to_its_scripts(tmp_path):
    (tmp_path / "scripts").symlink_to(ROOT / "scripts")
    command = f"source {tmp_path}/scripts/environment.sh && echo $LAB_ROOT"
    run = subprocess.run(["bash", "-c", command], stdout=subprocess.PIPE, text=True, check=True)
    assert run.stdout.strip() == str(ROOT)


def programs():
    for path in [*(ROOT / "scripts").iterdir(), *(ROOT / "stand_ins").rglob("*")]:
        if path.is_file() and path.read_bytes().startswith(b"#!/usr/bin/env python3"):
            yield path


@pytest.mark.parametrize("path", list(programs()), ids=lambda path: path.name)
def test_what_a_program_imports_and_runs_is_there(path):
    text = path.read_text()
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("bullet_lab."):
            module = importlib.import_module(node.module)
            assert all(hasattr(module, alias.name) for alias in node.names)
    for name, function in re.findall(r'\brun\("([\w.]+):?(\w*)"\)', text):
        source = Path(importlib.util.find_spec(name).origin).read_text()
        assert f"def {function or 'main'}(" in source
