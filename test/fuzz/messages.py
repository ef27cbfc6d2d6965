"""Random messages of any type: what makes sense, mixed with what does not."""

import re

import genpy
import numpy as np
from roslib.message import get_message_class

FLOATS = (0.0, -0.0, 1.0, -1.0, 1e-320, 1e-9, 1e9, 1e38, 1e308, -1e308, np.nan, np.inf, -np.inf)
SECONDS = (0, 1, 5, 2**31 - 1, 2**31, 2**32 - 1)
NAMES = (
    "", "/", "odom", "map", "base_footprint", "world", "camera_robot", "ground_plane", "dock",
    "camera_robot::base_footprint", "left_wheel_joint", "sun",
    "cart", "drive", "mast", "nobody", "a b", "\0", "é" * 40,
    "A" * 5000, "../../etc/passwd", "-1", "//x//", "~x",
)  # fmt: skip
ARRAY = re.compile(r"(.*)\[(\d*)\]")
LONGEST_ARRAY = 6
# How often a value is an odd one.
ODD = 0.3


class Messages:
    """Makes messages by the definition of their types.

    Args:
        random: numbers to draw from.
        texts: mutants of descriptions, for fields that hold one.
        now: returns a time that makes sense, in s.
    """

    def __init__(self, random, texts):
        self._random = random
        self._texts = texts
        self.now = 1.0

    def fill(self, message):
        """Give every field of a message some value; return it."""
        for name, kind in zip(message.__slots__, message._slot_types):
            setattr(message, name, self._value(kind, name))
        if message._type == "geometry_msgs/Quaternion" and self._random.random() > ODD:
            values = self._random.normal(size=4)
            message.x, message.y, message.z, message.w = values / np.linalg.norm(values)
        return message

    def some_settings(self, config):
        """Return some of a dynamic_reconfigure Config's settings, with other values."""
        made = type(config)()
        for kind in ("bools", "ints", "strs", "doubles"):
            chosen = [one for one in getattr(config, kind) if self._random.integers(2)]
            values = [self._setting(one) for one in chosen]
            settings = [type(one)(one.name, value) for one, value in zip(chosen, values)]
            getattr(made, kind).extend(settings)
        return made

    def _setting(self, setting):
        """Return another value for a setting: of numbers, often one that its limits let through."""
        if isinstance(setting.value, float) and self._odd():
            return self._one_of((np.nan, 0.0, setting.value))
        return self.fill(type(setting)()).value

    def _value(self, kind, name):
        array = ARRAY.fullmatch(kind)
        if array:
            return self._array(array[1], array[2], name)
        if kind in ("time", "duration"):
            return self._time(kind)
        if kind == "string":
            return self._text(name)
        if kind == "bool":
            return bool(self._random.integers(2))
        if kind.startswith("float"):
            return self._float(kind)
        if kind.startswith(("int", "uint", "char", "byte")):
            return self._integer(kind)
        return self.fill(get_message_class("std_msgs/Header" if kind == "Header" else kind)())

    def _array(self, kind, length, name):
        count = int(length) if length else int(self._random.integers(LONGEST_ARRAY))
        if kind in ("uint8", "char"):
            return self._random.bytes(count)
        return [self._value(kind, name) for _ in range(count)]

    def _odd(self):
        return self._random.random() < ODD

    def _one_of(self, values):
        return values[self._random.integers(len(values))]

    def _float(self, kind):
        value = self._one_of(FLOATS) if self._odd() else float(self._random.normal())
        limit = 3e38 if kind == "float32" else np.inf
        return value if not np.isfinite(value) else float(np.clip(value, -limit, limit))

    def _integer(self, kind):
        kind = {"char": "uint8", "byte": "int8"}.get(kind, kind)
        limits = np.iinfo(kind)
        values = (limits.min, limits.max, limits.max // 2)
        return int(self._one_of(values)) if self._odd() else int(self._random.integers(5))

    def _text(self, name):
        if name in ("model_xml", "xml", "robot_description") and self._texts and not self._odd():
            return self._one_of(self._texts)
        return self._one_of(NAMES)

    def _time(self, kind):
        make = genpy.Time if kind == "time" else genpy.Duration
        if self._odd():
            seconds = self._one_of(SECONDS)
            return make(seconds if kind == "time" else seconds % 2**31, 999_999_999)
        return make.from_sec(self.now + float(self._random.random()))
