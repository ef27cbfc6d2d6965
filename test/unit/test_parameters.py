import math
from dataclasses import dataclass
from typing import Any, Mapping, Tuple

import pytest

from bullet_lab.ros.node import parameters
from bullet_lab.ros.node.parameters import ParameterError, read_parameters


def odd(value):
    if value % 2 == 0:
        raise ValueError
    return value


@dataclass(frozen=True)
class Sample:
    ratio: float = parameters.number(0.5, "a ratio", minimum=0.0, maximum=1.0)
    width: float = parameters.number(2.0, "a width", above=0.0)
    seed: int = parameters.integer(1, "a seed", minimum=0, maximum=10)
    paused: bool = parameters.boolean(False, "whether")
    mode: str = parameters.choice("slow", "how", ("slow", "fast"))
    topic: str = parameters.text("odom", "where")
    nodes: Tuple[str, ...] = parameters.name_list("who")
    pose: Tuple[float, ...] = parameters.number_list((0.0, 1.0, 2.0), "place")
    about: Mapping[str, Any] = parameters.mapping("notes")
    special: int = parameters.checked(3, "a number", "an odd number", odd)


def read(**given):
    def get(name, default):
        assert name.startswith("~")
        return given.get(name[1:], default)

    return read_parameters(Sample, get, given)


def test_defaults():
    assert read() == Sample(
        0.5, 2.0, 1, False, "slow", "odom", (), (0.0, 1.0, 2.0), {}, 3
    )
    assert read().about is not read().about


def test_values_are_taken_over_and_converted():
    values = read(
        ratio=1, width=0.1, seed=10, paused=True, mode="fast", topic=5, nodes=" a  b ",
        pose="1 2.5 -3e0", about={"a": 1}, special=7,
    )  # fmt: skip
    assert values == Sample(
        1.0, 0.1, 10, True, "fast", "5", ("a", "b"), (1.0, 2.5, -3.0), {"a": 1}, 7
    )
    assert isinstance(values.ratio, float)
    assert read(pose=[1, 2, 3]).pose == (1.0, 2.0, 3.0)
    assert read(nodes="").nodes == ()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("ratio", 1.1, "~ratio is 1.1: it must be a number >= 0 and <= 1"),
        ("ratio", -0.1, "a number >= 0 and <= 1"),
        ("ratio", math.nan, "a number"),
        ("ratio", True, "a number"),
        ("ratio", "0.5", "~ratio is '0.5': it must be a number"),
        ("width", 0.0, "~width is 0.0: it must be a number > 0"),
        ("width", math.inf, "a number > 0"),
        ("width", 10**400, "a number > 0"),
        ("seed", 11, "~seed is 11: it must be a whole number from 0 to 10"),
        ("seed", -1, "a whole number"),
        ("seed", 1.0, "a whole number"),
        ("seed", True, "a whole number"),
        ("paused", 1, "~paused is 1: it must be true or false"),
        ("paused", "true", "true or false"),
        ("mode", "medium", "~mode is 'medium': it must be one of slow, fast"),
        ("mode", ["slow"], "one of slow, fast"),
        ("topic", {"a": 1}, "text"),
        ("topic", ["a"], "text"),
        ("nodes", 5, "names with spaces between them"),
        ("pose", "1 2", "~pose is '1 2': it must be 3 finite numbers"),
        ("pose", "1 2 x", "3 finite numbers"),
        ("pose", "1 2 nan", "3 finite numbers"),
        ("pose", 5, "3 finite numbers"),
        ("pose", [1, 2, 10**400], "3 finite numbers"),
        ("pose", [1, 2, None], "3 finite numbers"),
        ("about", "text", "~about is 'text': it must be a dictionary"),
        ("special", 4, "~special is 4: it must be an odd number"),
        ("special", "x", "an odd number"),
    ],
)
def test_values_that_are_not_allowed(name, value, message):
    with pytest.raises(ParameterError) as caught:
        read(**{name: value})
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"~{name} is ")
    assert "\n" not in str(caught.value)


def test_misspelt_names_are_found():
    with pytest.raises(ParameterError, match="^there is no parameter ~widht: known are ~about, "):
        read(widht=1.0)


def test_rospy_is_not_needed():
    import subprocess
    import sys

    code = (
        "import sys, bullet_lab.ros, bullet_lab.ros.bridge.pace, bullet_lab.ros.bridge.pace, "
        "bullet_lab.ros.node.parameters, bullet_lab.simulation.view, bullet_lab.reports.squares\n"
        "sys.exit('rospy' in sys.modules)"
    )
    path = [entry for entry in sys.path if entry]
    done = subprocess.run([sys.executable, "-c", f"import sys; sys.path[:] = {path}; {code}"])
    assert done.returncode == 0
