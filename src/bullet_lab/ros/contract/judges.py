"""What a row may expect, a function for each word: "" where it holds, else what was found."""

from __future__ import annotations

import math
import re
import statistics
from typing import Any, Callable, Dict, Mapping, Sequence

from bullet_lab.ros.contract.evidence import NotSeenError, Scene, beside, find_field, plain

# Of a rate by stamps and by counting, and of a number for which nothing else is said.
RATE_TOLERANCE = 0.03
COUNT_TOLERANCE = 0.1
ROUNDING = 1e-6
AXES = {"x": 0, "y": 1, "z": 2}


def judge(word: str, expected: Any, scene: Scene) -> str:
    """Return what is wrong by an expectation; empty where nothing is."""
    try:
        return JUDGES[word](expected, scene)
    except NotSeenError as error:
        return str(error)


def _publishes(kind: str, scene: Scene) -> str:
    """Somebody publishes the topic, with that type and its md5 sum."""
    found = scene.evidence.published.get(scene.topic)
    if found is None:
        return f"nobody publishes {scene.topic}{scene.nearby()}"
    if found != kind:
        return f"{scene.topic} has {found}"
    heard = scene.heard()
    md5 = scene.types.get(kind, "in no table")
    return "" if heard.md5 == md5 else f"md5 {heard.md5} of {kind}, not {md5}"


def _takes(kind: str, scene: Scene) -> str:
    """Somebody listens to the topic, with that type."""
    found = scene.evidence.taken.get(scene.topic, "nobody")
    return "" if found == kind else f"on {scene.topic} listens {found}"


def _absent(_expected: bool, scene: Scene) -> str:
    """Nobody publishes the topic or listens to it, and there is no such service."""
    evidence = scene.evidence
    for named in (evidence.published, evidence.taken, evidence.services):
        if scene.topic in named:
            return f"there is {scene.topic}: {named[scene.topic]}"
    return ""


def _offers(kind: str, scene: Scene) -> str:
    """There is a service of that type and its md5 sum."""
    found = scene.evidence.services.get(scene.topic)
    if found is None:
        return f"there is no service {scene.topic}"
    asked = (kind, scene.types.get(kind, "in no table"))
    return "" if found == asked else f"it is {found[0]} with md5 {found[1]}"


def _latched(expected: bool, scene: Scene) -> str:
    """The publisher keeps the last message for new subscribers, or does not."""
    return "" if scene.heard().latching == expected else f"latched: {not expected}"


def _silent(_expected: bool, scene: Scene) -> str:
    """No message comes on the topic."""
    heard = scene.evidence.heard.get(scene.topic)
    return f"{len(heard.buffers)} messages came" if heard and heard.buffers else ""


def _parameter(expected: Mapping[str, Any], scene: Scene) -> str:
    """The master has parameters of these values."""
    known = scene.evidence.parameters
    return _listed(_unlike(want, known.get(name), scene, name) for name, want in expected.items())


def _rate(hertz: float, scene: Scene) -> str:
    """Messages come so often per simulated second, by the median between stamps."""
    heard = scene.heard()
    tolerance = RATE_TOLERANCE if heard.has_stamps() else COUNT_TOLERANCE
    if not heard.has_stamps():
        found = len(heard.buffers) / scene.evidence.seconds if scene.evidence.seconds else math.nan
    else:
        stamps = heard.stamps()
        gaps = [later - sooner for sooner, later in zip(stamps, stamps[1:])]
        middle = statistics.median(gaps) if gaps else 0.0
        found = 1.0 / middle if middle > 0.0 else math.nan
    holds = abs(found - hertz) <= tolerance * hertz
    return "" if holds else f"{found:.4g} Hz, by {len(heard.buffers)} messages"


def _fields(expected: Mapping[str, Any], scene: Scene) -> str:
    """The fields of the last message are so."""
    return _compared(expected, scene.heard().message(-1), scene)


def _answers(expected: Mapping[str, Any], scene: Scene) -> str:
    """The service answers, and the fields of its answer are so."""
    return scene.error or _compared(expected, scene.answer, scene)


def _fails(_expected: bool, scene: Scene) -> str:
    """The service does not answer, but says that the call failed."""
    return "" if scene.error else f"it answered {plain(scene.answer)}"


def _change(expected: Mapping[str, Any], scene: Scene) -> str:
    """The fields have changed by so much from the first to the last message."""
    heard = scene.heard()
    first, last = heard.message(0), heard.message(-1)
    found = {path: find_field(last, path) - find_field(first, path) for path in expected}
    return _listed(_unlike(want, found[path], scene, path) for path, want in expected.items())


def _spread(expected: Mapping[str, Any], scene: Scene) -> str:
    """The standard deviation of the fields over all messages is so."""
    heard = scene.heard()
    messages = [heard.message(index) for index in range(len(heard.buffers))]
    found = {
        path: statistics.pstdev([find_field(message, path) for message in messages])
        for path in expected
    }
    return _listed(_unlike(want, found[path], scene, path) for path, want in expected.items())


def _stamped(other: str, scene: Scene) -> str:
    """Each stamp is one of the other topic's, but the first and last few."""
    theirs = {round(stamp, 6) for stamp in scene.heard(beside(scene.topic, other)).stamps()}
    inner = scene.heard().stamps()[1:-1]
    lone = [stamp for stamp in inner if round(stamp, 6) not in theirs]
    return f"no {other} at {lone[0]:.3f} s" if lone else "" if inner else "too few messages"


def _tf(pair: Sequence[str], scene: Scene) -> str:
    """The child frame is sent on /tf, with that parent."""
    if tuple(pair) in scene.evidence.frames:
        return ""
    parents = [f"in {parent}" for parent, child in scene.evidence.frames if child == pair[1]]
    return f"{pair[1]} is on /tf {', '.join(parents) or 'not at all'}"


def _no_tf(pair: Sequence[str], scene: Scene) -> str:
    """That transform is not sent on /tf."""
    return f"{pair} is on /tf" if tuple(pair) in scene.evidence.frames else ""


def _compared(expected: Mapping[str, Any], message: Any, scene: Scene) -> str:
    return _listed(
        _unlike(want, find_field(message, path), scene, path) for path, want in expected.items()
    )


def _listed(complaints: Any) -> str:
    return "; ".join(filter(None, complaints))


def _unlike(want: Any, value: Any, scene: Scene, path: str) -> str:
    """Return how a value is not as wanted; empty where it is."""
    found = plain(value)
    holds = _is(want, found, scene)
    shown = str(found)
    return "" if holds else f"{path} is {shown if len(shown) < 100 else shown[:100] + '…'}"


def _is(want: Any, found: Any, scene: Scene) -> bool:
    if isinstance(want, dict):
        return all(_TESTS[word](argument, found, want, scene) for word, argument in want.items())
    if isinstance(want, (list, tuple)):
        same_length = isinstance(found, list) and len(want) == len(found)
        return same_length and all(_is(one, other, scene) for one, other in zip(want, found))
    if isinstance(want, bool) or isinstance(found, bool):
        return want is found
    if isinstance(want, float) or isinstance(found, float):
        return _is_near(want, found, max(1e-9, ROUNDING * abs(want)))
    return want == found


def _is_near(want: float, found: Any, tolerance: float) -> bool:
    if isinstance(found, bool) or not isinstance(found, (int, float)):
        return False
    if math.isnan(want):
        return math.isnan(found)
    return want == found or abs(want - found) <= tolerance


def _near(want: float, found: Any, entry: Mapping[str, Any], scene: Scene) -> bool:
    origin = scene.place[AXES[entry["from"]]] if "from" in entry else 0.0
    # Time runs on until the simulator has been told to pause, which takes long on a busy machine.
    origin += entry.get("per_second_before", 0.0) * scene.evidence.seconds_before
    return _is_near(want + origin, found, entry.get("within", ROUNDING * max(1.0, abs(want))))


def _length(want: int, found: Any, _entry: Mapping[str, Any], _scene: Scene) -> bool:
    return isinstance(found, (list, str)) and len(found) == want


def _holds(want: Sequence[Any], found: Any, _entry: Mapping[str, Any], _scene: Scene) -> bool:
    return isinstance(found, list) and all(entry in found for entry in want)


def _lacks(want: Sequence[Any], found: Any, _entry: Mapping[str, Any], _scene: Scene) -> bool:
    return isinstance(found, list) and not any(entry in found for entry in want)


def _matches(want: str, found: Any, _entry: Mapping[str, Any], _scene: Scene) -> bool:
    return isinstance(found, str) and re.search(want, found) is not None


def _modifier(*_: Any) -> bool:
    return True


# What may be said of a field, beside its value.
_TESTS: Dict[str, Callable[[Any, Any, Mapping[str, Any], Scene], bool]] = {
    "near": _near,
    "within": _modifier,
    "from": _modifier,
    "per_second_before": _modifier,
    "length": _length,
    "holds": _holds,
    "lacks": _lacks,
    "matches": _matches,
    "above": lambda want, found, _entry, _scene: found > want,
    "below": lambda want, found, _entry, _scene: found < want,
}

JUDGES: Dict[str, Callable[[Any, Scene], str]] = {
    "publishes": _publishes,
    "takes": _takes,
    "absent": _absent,
    "offers": _offers,
    "latched": _latched,
    "silent": _silent,
    "parameter": _parameter,
    "rate": _rate,
    "fields": _fields,
    "answers": _answers,
    "fails": _fails,
    "change": _change,
    "spread": _spread,
    "stamped": _stamped,
    "tf": _tf,
    "no_tf": _no_tf,
}
