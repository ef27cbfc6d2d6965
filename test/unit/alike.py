"""Whether what was written and read again is the same."""

import math
from collections.abc import Mapping
from dataclasses import is_dataclass
from xml.etree.ElementTree import Element

import numpy as np
import pytest

from bullet_lab.core.pose import Pose

TOLERANCE = 1e-6
# What was not given may be so after reading; a joint without end is written as one without limits.
OPEN = ("", None, "continuous")


def assert_alike(one, other, *besides, within=TOLERANCE):
    """Compare data classes and what they hold, but for some fields and rounding."""

    def parts_alike(part, again):
        assert_alike(part, again, *besides, within=within)

    if isinstance(one, Pose):
        sign = math.copysign(1.0, np.dot(one.quaternion, other.quaternion))
        assert other.position == pytest.approx(one.position, abs=within)
        assert np.multiply(sign, other.quaternion) == pytest.approx(one.quaternion, abs=within)
    elif is_dataclass(one):
        for name in vars(one).keys() - set(besides):
            parts_alike(getattr(one, name), getattr(other, name))
    elif isinstance(one, Mapping):
        assert other.keys() == one.keys()
        for key, value in one.items():
            parts_alike(value, other[key])
    elif isinstance(one, (tuple, list)):
        assert len(other) == len(one)
        for value, again in zip(one, other):
            parts_alike(value, again)
    elif isinstance(one, (int, float, np.ndarray)):
        assert other == pytest.approx(one, abs=within)
    elif isinstance(one, Element):
        assert other.get("type") == one.get("type")
    elif one not in OPEN:
        assert other == one
