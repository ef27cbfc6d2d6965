"""The examples in docstrings give what they say."""

import doctest
import importlib

import pytest
from shared import PACKAGE

ROOT = PACKAGE / "src"
EXAMPLES = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts).replace(".__init__", "")
    for path in sorted((ROOT / "bullet_lab").rglob("*.py"))
    if ">>>" in path.read_text()
]


@pytest.mark.parametrize("module", EXAMPLES)
def test_examples_are_right(module):
    if ".ros." in module:
        pytest.importorskip("rospy")
    found = doctest.testmod(importlib.import_module(module))
    assert found.attempted > 0
    assert found.failed == 0
