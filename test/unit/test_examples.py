"""The examples in the docstrings of numeric modules give what they say."""

import doctest
import importlib

import pytest
from shared import PACKAGE

ROOT = PACKAGE / "src"
EXAMPLES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for package in ("core", "noise", "drive", "vision", "markers", "docking", "studies")
    for path in sorted((ROOT / "bullet_lab" / package).rglob("*.py"))
    if ">>>" in path.read_text()
]


@pytest.mark.parametrize("module", EXAMPLES)
def test_examples_are_right(module):
    found = doctest.testmod(importlib.import_module(module))
    assert found.attempted > 0
    assert found.failed == 0
