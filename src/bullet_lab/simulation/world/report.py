"""Telling the user what a document asks for and does not get."""

from __future__ import annotations

import contextlib
import logging
from typing import Callable, Iterator, Set

from bullet_lab.errors import LabError

LOG = logging.getLogger(__name__)


class ReportOnce:
    """Warnings that are given once each."""

    def __init__(self) -> None:
        self._given: Set[str] = set()

    def __call__(self, message: str) -> None:
        """Warn, unless this was said before."""
        if message not in self._given:
            self._given.add(message)
            LOG.warning("%s", message)


@contextlib.contextmanager
def leaving_out(report: Callable[[str], None]) -> Iterator[None]:
    """Report what is wrong with a part, and go on without it."""
    try:
        yield
    except LabError as error:
        report(f"{error}; it is left out")
