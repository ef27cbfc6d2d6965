"""How a campaign gets on: a bar on a terminal, a few lines elsewhere."""

from __future__ import annotations

from typing import Callable

from tqdm import tqdm

_LINES = 10


class DockProgress:
    """Counts dockings and tells of them.

    Args:
        total: how many there will be.
        docked: how many of them have succeeded before.
        failed: how many of them have failed before.
        tell: gets a line of text now and then, where there is no terminal.
    """

    def __init__(self, total: int, docked: int, failed: int, tell: Callable[[str], None]):
        self._docked, self._failed = docked, failed
        self._tell = tell
        self._every = -(-total // _LINES)
        self._bar = tqdm(
            total=total, initial=docked + failed, unit="docking", desc="docking", disable=None
        )

    def __enter__(self) -> DockProgress:
        self._show()
        return self

    def __exit__(self, *_) -> None:
        self._bar.close()

    def note(self, docked: bool) -> None:
        """Count a docking that has succeeded, or has not."""
        if docked:
            self._docked += 1
        else:
            self._failed += 1
        self._bar.update()
        self._show()
        done = self._docked + self._failed
        if self._bar.disable and done % self._every == 0:
            self._tell(f"{done} of {self._bar.total} done, {self._counts()}")

    def _show(self) -> None:
        if not self._bar.disable:
            self._bar.set_postfix_str(self._counts())

    def _counts(self) -> str:
        return f"docked {self._docked}, failed {self._failed}"
