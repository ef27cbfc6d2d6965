"""Studies run from the command line, and the files that they leave."""

import contextlib
import csv
import io
import json

import pytest


def run_main(main, *words):
    """Run a study; return its exit status, what it printed, and its errors."""
    said, errors = io.StringIO(), io.StringIO()
    caught = contextlib.redirect_stdout(said), contextlib.redirect_stderr(errors)
    with caught[0], caught[1], pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    return ended.value.code, said.getvalue(), errors.getvalue()


def backwards(task, numbers):
    """Do tasks in another order, as workers may."""
    return [(number, task(number)) for number in reversed(numbers)]


def names_in(folder):
    """Return the names of the files and folders in a folder."""
    return {path.name for path in folder.iterdir()}


def csv_rows(path):
    """Return the rows of a table by the names of its columns."""
    with path.open() as file:
        return list(csv.DictReader(file))


def summary_of(folder):
    """Return the content of summary.json."""
    return json.loads((folder / "summary.json").read_text())
