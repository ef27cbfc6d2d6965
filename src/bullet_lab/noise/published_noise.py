"""The noise of the report exactly as it was published, defects and all, for comparison.

Nothing else should use this: `odometry_noise` is the mended version.
"""

from __future__ import annotations

import math
from numbers import Real

from bullet_lab.core.se2 import quaternion_from_yaw, yaw_from_quaternion
from bullet_lab.noise.odometry_noise import NoiseError, ReportRule, check_pose, make_generator

PUBLISHED_RATE = 0.9
"""Hz, at which the published node samples the odometry."""

_STAMP_TOLERANCE = 1e-6  # s; a double cannot tell stamps of today much closer


class PublishedNoise:
    """The algorithm of listings 3 to 7 of the report.

    Its defects are kept on purpose: the message that it remembers as the last perfect one is the
    one it then overwrites with the noisy pose; rot1 is not wrapped; a robot at rest gets noise in
    proportion to its heading; the noise depends on the message rate; and a step is laid along the
    remembered heading, not along the noisy one.

    Args:
        std: standard deviation per metre and per radian, >= 0.
        seed: of its own random generator, >= 0; None for a different one each time.

    Raises:
        NoiseError: a parameter cannot be used.

    >>> published = PublishedNoise(0.0, seed=1)
    >>> [published.update(x, 0.0, 0.0) for x in (0.0, 0.5)]
    [(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)]
    """

    def __init__(self, std: float, seed: int | None):
        self._std = ReportRule(std).std
        self._generator = make_generator(seed)
        self._pose = None  # as the node sums it up: its yaw is never wrapped
        self._last_yaw = 0.0

    def restart(self) -> None:
        """Forget the path: the next pose starts a new one. The random generator goes on."""
        self._pose = None

    def update(self, x: float, y: float, yaw: float) -> tuple[float, float, float]:
        """Take the next perfect pose (m, m, rad) and return the noisy one, yaw in [-pi, pi].

        Raises:
            NoiseError: the pose is not finite. Nothing has changed and nothing was drawn then.
        """
        check_pose(x, y, yaw)
        yaw = _through_message(yaw)
        if self._pose is None:
            self._pose = (x, y, yaw)
        else:
            self._add_step(x, y, yaw)
        # Aliasing: what is remembered as the last perfect message is the noisy one.
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
    """Picks the messages that a node which polls at a fixed rate would see.

    The node sleeps once before it looks for the first time, so tick k = 1, 2, … is at the first
    stamp + k / rate. It depends on the stamps alone, not on the speed of the machine.

    Args:
        rate: Hz, > 0.

    Raises:
        NoiseError: the rate is not finite or not > 0.

    >>> sampler = Sampler(1.0)
    >>> [sampler.due(stamp) for stamp in (0.0, 0.6, 1.2, 1.8)]
    [False, False, True, False]
    """

    def __init__(self, rate: float):
        if isinstance(rate, bool) or not isinstance(rate, Real):
            raise NoiseError(f"rate must be a number, not {rate!r}")
        if not 0.0 < rate < math.inf:
            raise NoiseError(f"rate must be finite and > 0, not {rate!r}")
        self._rate = rate
        self._start = None
        self._tick = 1

    def restart(self) -> None:
        """Start anew with the next stamp."""
        self._start = None

    def due(self, stamp: float) -> bool:
        """Return whether this message (stamp in s) is the first at or after a tick.

        Ticks that pass between two messages count once.
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
