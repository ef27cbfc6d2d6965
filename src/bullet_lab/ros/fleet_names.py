"""What the robots of a fleet are called."""

from __future__ import annotations

from typing import List

MOST_ROBOTS = 100


def robot_names(count: int) -> List[str]:
    """Return the names of so many robots, which are their namespaces as well; from robot1 on."""
    return [f"robot{number}" for number in range(1, count + 1)]
