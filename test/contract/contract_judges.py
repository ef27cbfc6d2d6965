"""Checks what was seen of a simulator against the expectations of the contract's rows.

Each kind of expectation is a function in JUDGES: it returns what is wrong, or "" if nothing is.
"""

import math
import re
import statistics
import struct
from dataclasses import dataclass, field
from typing import Any

from rosgraph.names import namespace, ns_join

RATE_TOLERANCE = 0.03
"""Relative tolerance of a rate that is measured by stamps."""

COUNT_TOLERANCE = 0.1
"""Relative tolerance of a rate that is measured by counting messages."""

ROUNDING = 1e-6
"""Tolerance of a number for which the row gives none; relative beyond 1."""

STAMP_ROUNDING = 1e-6
SHOWN = 100
"""Characters of a value that are shown."""

_AXES = {"x": 0, "y": 1, "z": 2}
_FIELD = re.compile(r"(\w+)((?:\[\d+\])*)")
_STAMP = struct.Struct("<II")


class NotSeenError(LookupError):
    """The thing that a row checks was not seen; the text says what was seen instead."""


@dataclass
class Heard:
    """The messages that came on a topic.

    Attributes:
        type: their type, as the publisher gives it; the same for md5 and latching.
        kind: their class; None if it is not installed.
        buffers: the serialized messages, in order of arrival.
    """

    type: str = ""
    md5: str = ""
    latching: bool = False
    kind: type = None
    buffers: list = field(default_factory=list)

    def message(self, index):
        """Return a message; raise NotSeenError."""
        if not self.buffers:
            raise NotSeenError("no message came")
        if self.kind is None:
            raise NotSeenError(f"{self.type} is not installed here")
        return self.kind().deserialize(self.buffers[index])

    def has_stamps(self):
        """Return whether the messages begin with a header, or are times themselves."""
        return self.kind is not None and self.kind.__slots__[:1] in (["header"], ["clock"])

    def cut(self, end):
        """Drop messages with stamps after `end` (s): the simulator may have run on."""
        if self.has_stamps():
            kept = zip(self.buffers, self.stamps())
            self.buffers = [buffer for buffer, stamp in kept if stamp <= end + STAMP_ROUNDING]

    def stamps(self):
        """Return the stamps of the messages in s."""
        # A header begins with its sequence number.
        offset = _STAMP.size // 2 if self.kind.__slots__[0] == "header" else 0
        pairs = (_STAMP.unpack_from(buffer, offset) for buffer in self.buffers)
        return [seconds + 1e-9 * nanoseconds for seconds, nanoseconds in pairs]


@dataclass
class Evidence:
    """Everything that was seen while simulated time ran.

    Attributes:
        published: types of the topics that have a publisher, by name.
        taken: types of the topics that have a subscriber, by name.
        services: type and md5 sum of services, by name.
        heard: messages by the name of the topic.
        frames: pairs of parent and child on /tf.
        parameters: parameters of the ROS master, by name.
        seconds: for how long time ran, in s.
        seconds_before: for how long time ran before that, in s.
    """

    published: dict = field(default_factory=dict)
    taken: dict = field(default_factory=dict)
    services: dict = field(default_factory=dict)
    heard: dict = field(default_factory=dict)
    frames: set = field(default_factory=set)
    parameters: dict = field(default_factory=dict)
    seconds: float = 0.0
    seconds_before: float = 0.0


@dataclass
class Scene:
    """The evidence for one row.

    Attributes:
        evidence: everything that was seen.
        types: md5 sums by type.
        topic: full name of the row's topic or service.
        place: position of the row's probe, x, y and z in m.
        answer: answer of the service that the row calls; None if there is an `error`.
        error: why the service did not answer.
    """

    evidence: Evidence
    types: dict
    topic: str = ""
    place: tuple = (0.0, 0.0, 0.0)
    answer: Any = None
    error: str = ""

    def heard(self, topic=""):
        """Return the messages on a topic, by default the row's; raise NotSeenError."""
        name = topic or self.topic
        if name not in self.evidence.heard or not self.evidence.heard[name].buffers:
            raise NotSeenError(f"nothing came on {name}{self.nearby(name)}")
        return self.evidence.heard[name]

    def nearby(self, topic):
        """Return a note on the published topics with the same namespace; empty if none."""
        around = topic.rpartition("/")[0]
        near = [name for name in sorted(self.evidence.published) if name.startswith(around)]
        return f"; there are {', '.join(near[:6])}" if around and near else ""


def find_field(message, path):
    """Return a field of a message, such as pose.covariance[0]; raise NotSeenError."""
    found = message
    for part in path.split("."):
        match = _FIELD.fullmatch(part)
        if match is None or not hasattr(found, match[1]):
            raise NotSeenError(f"there is no field {path}")
        found = getattr(found, match[1])
        for index in re.findall(r"\d+", match[2]):
            if int(index) >= len(found):
                raise NotSeenError(f"{path}: there are only {len(found)}")
            found = found[int(index)]
    return found


def plain(value):
    """Return a value of a message as YAML has it: lists, dictionaries, numbers and texts."""
    if isinstance(value, (bytes, tuple, list)):
        return [plain(entry) for entry in value]
    if hasattr(value, "to_sec"):
        return value.to_sec()
    if hasattr(value, "__slots__"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    return value


def judge(word, expected, scene):
    """Return how an expectation is not met; empty if it is met."""
    try:
        return JUDGES[word](expected, scene)
    except NotSeenError as error:
        return str(error)


def _publishes(kind, scene):
    """The topic has a publisher, of that type with its md5 sum."""
    found = scene.evidence.published.get(scene.topic)
    if found is None:
        return f"nobody publishes {scene.topic}{scene.nearby(scene.topic)}"
    if found != kind:
        return f"{scene.topic} has {found}"
    heard = scene.heard()
    md5 = scene.types.get(kind, "in no table")
    return "" if heard.md5 == md5 else f"md5 {heard.md5} of {kind}, not {md5}"


def _takes(kind, scene):
    """The topic has a subscriber of that type."""
    found = scene.evidence.taken.get(scene.topic, "nobody")
    return "" if found == kind else f"on {scene.topic} listens {found}"


def _absent(_expected, scene):
    """The topic has no publisher and no subscriber, and there is no such service."""
    evidence = scene.evidence
    for named in (evidence.published, evidence.taken, evidence.services):
        if scene.topic in named:
            return f"there is {scene.topic}: {named[scene.topic]}"
    return ""


def _offers(kind, scene):
    """There is a service of that type with its md5 sum."""
    found = scene.evidence.services.get(scene.topic)
    if found is None:
        return f"there is no service {scene.topic}"
    asked = (kind, scene.types.get(kind, "in no table"))
    return "" if found == asked else f"it is {found[0]} with md5 {found[1]}"


def _latched(expected, scene):
    """The publisher keeps the last message for new subscribers, or does not."""
    return "" if scene.heard().latching == expected else f"latched: {not expected}"


def _silent(expected, scene):
    """No message comes on the topic; if the row names a type, it has a publisher of that type."""
    found = scene.evidence.published.get(scene.topic, "no publisher")
    if isinstance(expected, str) and found != expected:
        return f"{scene.topic} has {found}{scene.nearby(scene.topic)}"
    heard = scene.evidence.heard.get(scene.topic)
    return f"{len(heard.buffers)} messages came" if heard and heard.buffers else ""


def _parameter(expected, scene):
    """The ROS master has parameters with these values."""
    return _compared(expected, scene.evidence.parameters.get, scene)


def _rate(hertz, scene):
    """Messages come at this rate per simulated second, by the median between stamps."""
    heard = scene.heard()
    if heard.has_stamps():
        stamps = heard.stamps()
        gaps = [later - sooner for sooner, later in zip(stamps, stamps[1:])]
        period = statistics.median(gaps) if gaps else 0.0
        tolerance = RATE_TOLERANCE
    else:
        period = scene.evidence.seconds / len(heard.buffers)
        tolerance = COUNT_TOLERANCE
    found = 1.0 / period if period > 0.0 else math.nan
    holds = abs(found - hertz) <= tolerance * hertz
    return "" if holds else f"{found:.4g} Hz, by {len(heard.buffers)} messages"


def _fields(expected, scene):
    """The fields of the last message have these values."""
    return _compared_fields(expected, scene.heard().message(-1), scene)


def _answers(expected, scene):
    """The service answers, and the fields of its answer have these values."""
    return scene.error or _compared_fields(expected, scene.answer, scene)


def _fails(_expected, scene):
    """The service reports that the call failed."""
    return "" if scene.error else f"it answered {plain(scene.answer)}"


def _change(expected, scene):
    """The fields change by these values from the first to the last message."""
    heard = scene.heard()
    first, last = heard.message(0), heard.message(-1)

    def change(path):
        return find_field(last, path) - find_field(first, path)

    return _compared(expected, change, scene)


def _spread(expected, scene):
    """The fields have these standard deviations over all messages."""
    heard = scene.heard()
    messages = [heard.message(index) for index in range(len(heard.buffers))]

    def deviation(path):
        return statistics.pstdev([find_field(message, path) for message in messages])

    return _compared(expected, deviation, scene)


def _stamped(other, scene):
    """Each stamp but the first and the last is also a stamp of the other topic."""
    heard = scene.heard(ns_join(namespace(scene.topic), other))
    theirs = {round(stamp, 6) for stamp in heard.stamps()}
    inner = scene.heard().stamps()[1:-1]
    lone = [stamp for stamp in inner if round(stamp, 6) not in theirs]
    return f"no {other} at {lone[0]:.3f} s" if lone else "" if inner else "too few messages"


def _tf(pair, scene):
    """A transform from this parent to this child comes on /tf."""
    if tuple(pair) in scene.evidence.frames:
        return ""
    parents = [f"in {parent}" for parent, child in scene.evidence.frames if child == pair[1]]
    return f"{pair[1]} is on /tf {', '.join(parents) or 'not at all'}"


def _no_tf(pair, scene):
    """No such transform comes on /tf."""
    return f"{pair} is on /tf" if tuple(pair) in scene.evidence.frames else ""


def _compared_fields(expected, message, scene):
    return _compared(expected, lambda path: find_field(message, path), scene)


def _compared(expected, find, scene):
    """Compare named values with those that `find` returns; return those that differ."""
    wrong = []
    for name, want in expected.items():
        found = plain(find(name))
        if not _is(want, found, scene):
            shown = str(found)
            wrong.append(f"{name} is {shown if len(shown) < SHOWN else shown[:SHOWN] + '…'}")
    return "; ".join(wrong)


def _is(want, found, scene):
    if isinstance(want, dict):
        near = "near" not in want or _near(want, found, scene)
        tests = [name for name in want if name not in _NEAR]
        return near and all(_TESTS[name](want[name], found) for name in tests)
    if isinstance(want, (list, tuple)):
        same_length = isinstance(found, list) and len(want) == len(found)
        return same_length and all(_is(one, other, scene) for one, other in zip(want, found))
    if isinstance(want, bool) or isinstance(found, bool):
        return want is found
    if isinstance(want, float) or isinstance(found, float):
        return _is_near(want, found, max(1e-9, ROUNDING * abs(want)))
    return want == found


def _near(want, found, scene):
    value = want["near"]
    tolerance = want.get("within", ROUNDING * max(1.0, abs(value)))
    origin = scene.place[_AXES[want["from"]]] if "from" in want else 0.0
    # A busy simulator runs on for a while before it pauses.
    origin += want.get("per_second_before", 0.0) * scene.evidence.seconds_before
    return _is_near(value + origin, found, tolerance)


def _is_near(want, found, tolerance):
    if isinstance(found, bool) or not isinstance(found, (int, float)):
        return False
    if math.isnan(want):
        return math.isnan(found)
    return want == found or abs(want - found) <= tolerance


# A row may use these in place of a value.
_NEAR = ("near", "within", "from", "per_second_before")
_TESTS = {
    "length": lambda want, found: isinstance(found, (list, str)) and len(found) == want,
    "holds": lambda want, found: isinstance(found, list) and all(one in found for one in want),
    "lacks": lambda want, found: isinstance(found, list) and not any(one in found for one in want),
    "matches": lambda want, found: isinstance(found, str) and bool(re.search(want, found)),
    "above": lambda want, found: found > want,
    "below": lambda want, found: found < want,
}

_JUDGES = (
    *(_publishes, _takes, _absent, _offers, _latched, _silent, _parameter, _rate),
    *(_fields, _answers, _fails, _change, _spread, _stamped, _tf, _no_tf),
)
JUDGES = {one.__name__[1:]: one for one in _JUDGES}
