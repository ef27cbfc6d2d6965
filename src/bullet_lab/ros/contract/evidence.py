"""What was seen of a simulator: plain data that the rows of the contract are judged by."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, Optional, Sequence, Set, Tuple

_PART = re.compile(r"(\w+)((?:\[\d+\])*)")
_STAMP = struct.Struct("<II")
STAMP_ROUNDING = 1e-6


class NotSeenError(LookupError):
    """What a row asks about was not seen; the text says what was, instead."""


@dataclass
class Heard:
    """What came on a topic.

    Attributes:
        type: of the messages, as the publisher told it; likewise md5 and latching.
        kind: the messages' class; None where it is not installed.
        buffers: the messages as they came.
    """

    type: str = ""
    md5: str = ""
    latching: bool = False
    kind: Optional[type] = None
    buffers: List[bytes] = field(default_factory=list)

    def message(self, index: int) -> Any:
        """Return a message; raises NotSeenError."""
        if not self.buffers:
            raise NotSeenError("no message came")
        if self.kind is None:
            raise NotSeenError(f"{self.type} is not installed here")
        return self.kind().deserialize(self.buffers[index])

    def has_stamps(self) -> bool:
        """Return whether the messages begin with a header, or are the time themselves."""
        return self.kind is not None and self.kind.__slots__[:1] in (["header"], ["clock"])

    def cut(self, end: float) -> None:
        """Forget messages that are stamped later than `end` (s), by a simulator that ran on."""
        if self.has_stamps():
            kept = zip(self.buffers, self.stamps())
            self.buffers = [buffer for buffer, stamp in kept if stamp <= end + STAMP_ROUNDING]

    def stamps(self) -> List[float]:
        """Return the stamps of the messages, in s."""
        # A header begins with its number.
        offset = _STAMP.size // 2 if self.kind.__slots__[0] == "header" else 0
        parts = (_STAMP.unpack_from(buffer, offset) for buffer in self.buffers)
        return [seconds + 1e-9 * nanoseconds for seconds, nanoseconds in parts]


@dataclass
class Evidence:
    """All that was seen while time ran for some `seconds`.

    Attributes:
        published: the types of topics that somebody publishes, by name; `taken` likewise of
            those that somebody listens to.
        services: type and md5 sum of services, by name.
        heard: what came on topics.
        frames: pairs of parent and child on /tf.
        parameters: of the master, by name.
        seconds_before: for how long time ran the time before, in s.
    """

    published: Mapping[str, str] = field(default_factory=dict)
    taken: Mapping[str, str] = field(default_factory=dict)
    services: Mapping[str, Tuple[str, str]] = field(default_factory=dict)
    heard: Mapping[str, Heard] = field(default_factory=dict)
    frames: Set[Tuple[str, str]] = field(default_factory=set)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    seconds_before: float = 0.0


@dataclass
class Scene:
    """What one row is about.

    Attributes:
        evidence: all that was seen.
        types: md5 sums by type.
        topic: the full name of the row's topic or service.
        place: where its probe was put, x, y and z in m.
        answer: of the service that it calls; None with an `error`.
    """

    evidence: Evidence
    types: Mapping[str, str]
    topic: str = ""
    place: Sequence[float] = (0.0, 0.0, 0.0)
    answer: Any = None
    error: str = ""

    def heard(self, topic: str = "") -> Heard:
        """Return what came on a topic, by default the row's; raises NotSeenError."""
        name = topic or self.topic
        if name not in self.evidence.heard or not self.evidence.heard[name].buffers:
            raise NotSeenError(f"nothing came on {name}{self.nearby(name)}")
        return self.evidence.heard[name]

    def nearby(self, topic: str = "") -> str:
        """Return which topics there are instead, in words."""
        around = (topic or self.topic).rpartition("/")[0]
        near = [topic for topic in sorted(self.evidence.published) if topic.startswith(around)]
        return f"; there are {', '.join(near[:6])}" if around and near else ""


def beside(topic: str, name: str) -> str:
    """Return the full name of a topic that stands beside another."""
    return name if name.startswith("/") else f"{topic.rpartition('/')[0]}/{name}"


def find_field(message: Any, path: str) -> Any:
    """Return a field of a message: `pose.covariance[0]`; raises NotSeenError."""
    found = message
    for part in path.split("."):
        match = _PART.fullmatch(part)
        if match is None or not hasattr(found, match.group(1)):
            raise NotSeenError(f"there is no field {path}")
        found = getattr(found, match.group(1))
        for index in re.findall(r"\d+", match.group(2)):
            if int(index) >= len(found):
                raise NotSeenError(f"{path}: there are only {len(found)}")
            found = found[int(index)]
    return found


def plain(value: Any) -> Any:
    """Return a value of a message as YAML would have it, for comparing and showing."""
    if isinstance(value, (bytes, tuple, list)):
        return [plain(part) for part in value]
    if hasattr(value, "to_sec"):
        return value.to_sec()
    if hasattr(value, "__slots__"):
        named: Dict[str, Any] = {name: plain(getattr(value, name)) for name in value.__slots__}
        return named
    return value
