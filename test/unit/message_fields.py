"""Messages from YAML texts, as they come out at the other end, and their fields."""

from io import BytesIO

import genpy
import numpy as np
import pytest
import yaml
from alike import lines_of

from bullet_lab.ros.messages.conversions import Converter


def message(kind, text):
    """Return a message of a type with fields of a YAML text, as rostopic pub takes it."""
    made = kind()
    genpy.message.fill_message_args(made, [yaml.safe_load(text)])
    return made


def messages(kind, text):
    """Return messages of a type, whose fields a YAML text lists."""
    return [message(kind, yaml.safe_dump(fields)) for fields in yaml.safe_load(text)]


def data_of(message):
    """Return the bytes of a message."""
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def message_of(sample):
    """Convert a sample, and send and receive the message."""
    converter = Converter(type(sample))
    return converter.message_kind().deserialize(data_of(converter.convert(sample)))


def check(made, fields):
    """Compare fields of a message with those of a YAML text, to single precision."""
    for name, expected in yaml.safe_load(fields).items():
        found = made
        for part in name.split("."):
            found = getattr(found, part)
        assert plain(found) == near(expected), name


def lines_of_message(made, name):
    """Yield a line for each field of a message, of those in it and of those that it lists."""
    for field in made.__slots__:
        value, place = getattr(made, field), f"{name}.{field}"
        parts = value if isinstance(value, list) else [value]
        if not parts or not isinstance(parts[0], genpy.Message):
            yield from lines_of(plain(value), place)
        else:
            for number, part in enumerate(parts):
                yield from lines_of_message(part, place if part is value else f"{place}.{number}")


def near(value):
    """Return what compares equal to a number or a list of numbers of single precision."""
    if isinstance(value, list):
        return [near(one) for one in value]
    return pytest.approx(value, rel=1e-7) if isinstance(value, float) else value


def plain(value):
    """Return a time as seconds, and arrays, vectors, other messages and their lists as lists."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, genpy.Time):
        return value.to_sec()
    if isinstance(value, genpy.Message):
        return [plain(getattr(value, name)) for name in value.__slots__]
    return [plain(one) for one in value] if isinstance(value, (list, tuple)) else value
