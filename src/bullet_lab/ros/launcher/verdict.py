"""What has become of a run."""

from __future__ import annotations

import signal
from dataclasses import dataclass


@dataclass(frozen=True)
class Death:
    """The end of a node; a negative status is the number of the signal that killed it."""

    process: str
    status: int


@dataclass(frozen=True)
class Verdict:
    """The exit status of a run, and in one line why, when it is not 0."""

    status: int
    reason: str = ""


def judge(
    deaths: list[Death],
    names: dict[str, str],
    required: set[str],
    has_summary: bool,
    stopped_by: int | None,
) -> Verdict | None:
    """What has become of a run so far, None while it goes on.

    Args:
        deaths: the nodes that have ended, in order.
        names: the node's name for each process that was started.
        required: names of the nodes whose end is the end of the job.
        has_summary: whether the summary has been written.
        stopped_by: the signal that asked to stop, if any.
    """
    for death in deaths:
        name = names.get(death.process, death.process)
        if death.status:
            return _failure(name, death.status)
        if name in required:
            if has_summary:
                return Verdict(0)
            return Verdict(1, f"{name} ended before there was a summary")
    if stopped_by is not None:
        return Verdict(128 + stopped_by, f"stopped by {signal.Signals(stopped_by).name}")
    if len(deaths) >= len(names):
        return Verdict(1, "all nodes have ended and there is no summary")
    return None


def _failure(name: str, status: int) -> Verdict:
    if status < 0:
        return Verdict(128 - status, f"{name} was killed by signal {-status}")
    return Verdict(status, f"{name} ended with status {status}")
