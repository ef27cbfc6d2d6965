"""The noise of the report exactly as it was published, with its defects, for comparison.

`odometry_noise` is the corrected version.
"""

from __future__ import annotations

import math

from bullet_lab.core.se2 import quaternion_from_yaw, yaw_from_quaternion
from bullet_lab.noise.odometry_noise import check_pose, make_generator

PUBLISHED_RATE = 0.9
"""Hz; rate at which the published node samples the odometry."""

# s; the resolution of present-day stamps as doubles is not much finer.
_STAMP_TOLERANCE = 1e-6


class PublishedNoise:
    """The algorithm of listings 3 to 7 of the report.

    Its defects are kept on purpose: it stores the last perfect message and then overwrites it with
    the noisy pose; rot1 is not wrapped; a robot at rest gets noise in proportion to its heading;
    the noise depends on the message rate; and a step is laid along the stored heading, not along
    the noisy one.

    Args:
        std: standard deviation per metre and per radian, >= 0.
        seed: of its random generator, >= 0; None for a different one each time.

    Raises:
        NoiseError: the seed is invalid.

    >>> published = PublishedNoise(0.0, seed=1)
    >>> [published.update(x, 0.0, 0.0) for x in (0.0, 0.5)]
    [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)]
    """

    def __init__(self, std: float, seed: int | None):
        self._std = std
        self._generator = make_generator(seed)
        # As the node accumulates it: its yaw is never wrapped.
        self._pose = None
        self._last_yaw = 0.0

    def restart(self) -> None:
        """Start a new path with the next pose. The random generator is not reset."""
        self._pose = None

    def update(self, x: float, y: float, yaw: float) -> tuple[float, float, float]:
        """Return the noisy pose, yaw in [-pi, pi], for the next perfect pose (m, m, rad).

        Raises:
            NoiseError: the pose is not finite. The state and the generator are unchanged then.
        """
        check_pose(x, y, yaw)
        yaw = _through_message(yaw)
        if self._pose is None:
            self._pose = (x, y, yaw)
        else:
            self._add_step(x, y, yaw)
        # Aliasing: the stored last perfect message is the noisy one.
        self._last_yaw = _through_message(self._pose[2])
        return self._pose[0], self._pose[1], self._last_yaw

    def _add_step(self, x: float, y: float, yaw: float) -> None:
        last_x, last_y, summed_yaw = self._pose
        trans = math.hypot(x - last_x, y - last_y)
        rot1 = math.atan2(y - last_y, x - last_x) - self._last_yaw
        rot2 = yaw - self._last_yaw - rot1
        trans, rot1, rot2 = self._corrupt(trans, rot1, rot2)
        self._pose = (
            last_x + trans * math.cos(self._last_yaw + rot1),
            last_y + trans * math.sin(self._last_yaw + rot1),
            summed_yaw + rot1 + rot2,
        )

    def _corrupt(self, *parts: float) -> list[float]:
        draws = self._generator.standard_normal(len(parts)).tolist()
        return [part + abs(self._std * part) * draw for part, draw in zip(parts, draws)]


def _through_message(yaw: float) -> float:
    """Return a yaw (rad) as it is read back from the quaternion of a message."""
    return yaw_from_quaternion(*quaternion_from_yaw(yaw))


class Sampler:
    """Selects the messages that a node would receive that polls at a fixed rate.

    The node sleeps before its first poll, so tick k = 1, 2, … is at the first stamp + k / rate. The
    selection depends on the stamps alone, not on the speed of the machine.

    Args:
        rate: Hz, > 0.

    >>> sampler = Sampler(1.0)
    >>> [sampler.due(stamp) for stamp in (0.0, 0.6, 1.2, 1.8)]
    [False, False, True, False]
    """

    def __init__(self, rate: float):
        self._rate = rate
        self._start = None
        self._tick = 1

    def restart(self) -> None:
        """Count ticks from the next stamp."""
        self._start = None

    def due(self, stamp: float) -> bool:
        """Return whether this message (stamp in s) is the first at or after a tick.

        Several ticks between two messages count once.
        """
        if self._start is None:
            self._start = stamp
            self._tick = 1
            return False
        ticks = math.floor((stamp - self._start + _STAMP_TOLERANCE) * self._rate)
        if ticks < self._tick:
            return False
        self._tick = ticks + 1
        return True
