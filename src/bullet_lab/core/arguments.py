"""Command lines whose mistakes are one line."""

from __future__ import annotations

import argparse
from typing import NoReturn

from bullet_lab.errors import LabError


class ArgumentsError(LabError):
    """A command line that cannot be followed."""


class ArgumentParser(argparse.ArgumentParser):
    """Raises ArgumentsError, where argparse's own would print its usage and exit."""

    def error(self, message: str) -> NoReturn:
        """Raise what is wrong."""
        raise ArgumentsError(message)
