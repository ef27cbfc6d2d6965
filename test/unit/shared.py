"""What the unit tests share that is no fixture."""

import contextlib
import functools
import importlib.util
import logging
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from bullet_lab.errors import LabError

PACKAGE = Path(__file__).resolve().parents[2]
BLOCK_ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
EMPTY_WORLD = "package://bullet_lab/worlds/empty.world"


def module_of(path):
    """Import a file that is no part of the package, by its path from test/."""
    file = PACKAGE / "test" / path
    spec = importlib.util.spec_from_file_location(f"file_{file.stem}", file)
    module = importlib.util.module_from_spec(spec)
    # Where its dataclasses look for it.
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def python(code, **options):
    """Run a program; return its status, what it prints, and its errors."""
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=300, **options
    )
    return run.returncode, run.stdout, run.stderr


@contextlib.contextmanager
def complains(said):
    """Check that an error is raised or a warning given that says something, in one line."""
    messages = []
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())
    logger = logging.getLogger("bullet_lab")
    logger.addHandler(handler)
    try:
        yield
    except LabError as error:
        messages.append(str(error))
    finally:
        logger.removeHandler(handler)
    assert [line for line in messages if re.search(said, line)], messages
    assert not [line for line in messages if "\n" in line]


@contextlib.contextmanager
def refuses(said, kind=LabError):
    """Check that an error is raised that says something, in one line."""
    with pytest.raises(kind, match=said) as caught:
        yield caught
    assert "\n" not in str(caught.value)


class Table(yaml.SafeLoader):
    """YAML in which a row with the tag !long is one for the long tests."""


@functools.partial(Table.add_constructor, "!long")
def _long(loader, node):
    return pytest.param(*loader.construct_sequence(node, deep=True), marks=pytest.mark.long)


def cases(text):
    """Run a test for each row of a table: YAML with the names of its arguments, then the rows."""
    ((names, rows),) = yaml.load(text, Table).items()
    return pytest.mark.parametrize(names, rows.items() if isinstance(rows, dict) else rows)
