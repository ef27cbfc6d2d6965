"""A random walk of way and heading, each with a level of its own."""

from __future__ import annotations

from dataclasses import dataclass

from bullet_lab.noise.odometry_noise import NoiseRule, WalkRule, register, strength


@register
@dataclass(frozen=True)
class RandomWalkRule(WalkRule):
    """Rate-invariant noise whose way and heading are not equally noisy, as those of real robots.

    Attributes:
        way_std: m/√m, of the translation, >= 0.
        heading_std: rad/√m, of the heading on a way, >= 0.
        turn_std: rad/√rad, of the heading in a turn, >= 0.

    >>> RandomWalkRule(0.5, 0.0, 1.0).variances(0.0, 2.0, -1.0)
    (0.5, 0.5, 0.5)
    """

    name, title, stream = "random_walk", "Random walk", 3

    way_std: float = strength(0.03, "random_walk: distance, per root of a metre")
    heading_std: float = strength(0.03, "random_walk: heading, per root of a metre")
    turn_std: float = strength(0.08, "random_walk: heading, per root of a radian")

    @classmethod
    def at_level(cls, std: float) -> NoiseRule:
        """Return the rule whose heading has this level, and whose way a third of it."""
        return cls(std / 3.0, std, std)

    def walked(self, distance, angle):  # noqa: D102 - inherited
        on_ways, in_turns = self.heading_std * self.heading_std, self.turn_std * self.turn_std
        return on_ways * distance + in_turns * angle, self.way_std * self.way_std * distance
