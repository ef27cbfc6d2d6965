from argparse import ArgumentParser
from dataclasses import dataclass, replace
from typing import Any, Mapping, Tuple

import pytest
from shared import cases

from bullet_lab.core import parameters
from bullet_lab.core.parameters import (
    ParameterError,
    add_options,
    check_parameters,
    declarations,
    read_options,
    read_parameters,
)


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
    special: int = parameters.odd(3, "a number", 1, 7)


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


CONVERTED = Sample(1.0, 0.1, 10, True, "fast", "5", ("a", "b"), (1.0, 2.5, -3.0), {"a": 1}, 7)


@cases("""
given:
  - {ratio: 1, width: 0.1, seed: 10, paused: true, pose: [1, 2.5, -3]}
  # Text as launch files and command lines have it.
  - {ratio: "1.", width: 1e-1, seed: "+10", paused: "true", pose: 1 2.5 -3e0}
""")
def test_values_are_taken_over_and_converted(given):
    values = read(mode="fast", topic=5, nodes=" a  b ", about={"a": 1}, special=7, **given)
    assert values == CONVERTED
    assert isinstance(values.ratio, float)


@cases("""
name, value, message:
  - [ratio, 1.1, "~ratio is 1.1: it must be a number >= 0 and <= 1"]
  - [ratio, true, a number]
  - [ratio, nan, "~ratio is 'nan': it must be a number"]
  - [ratio, "1e999", a number]
  - [ratio, [], "~ratio is []: it must be a number"]
  - [width, 0.0, "~width is 0.0: it must be a number > 0"]
  - [seed, 11, "~seed is 11: it must be a whole number from 0 to 10"]
  - [seed, -1, a whole number]
  - [seed, 1.0, a whole number]
  - [seed, true, a whole number]
  - [paused, 1, "~paused is 1: it must be true or false"]
  - [paused, "yes", "~paused is 'yes': it must be true or false"]
  - [mode, medium, "~mode is 'medium': it must be one of slow, fast"]
  - [topic, {a: 1}, text]
  - [nodes, 5, names with spaces between them]
  - [pose, 1 2, "~pose is '1 2': it must be 3 finite numbers"]
  - [about, text, "~about is 'text': it must be a dictionary"]
  - [special, 4, "~special is 4: it must be an odd number from 1 to 7"]
  - [special, 9, an odd number]
""")
def test_values_that_are_not_allowed(name, value, message):
    with pytest.raises(ParameterError) as caught:
        read(**{name: value})
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"~{name} is ")
    assert "\n" not in str(caught.value)


def test_an_integer_beyond_all_floats_is_no_finite_number():
    with pytest.raises(ParameterError, match="3 finite numbers"):
        read(pose=[1, 2, 10**400])


def test_empty_text_is_the_default_unless_it_is_a_value():
    empty = read(**{name: "" for name in declarations(Sample) if name != "about"})
    assert empty == replace(Sample(), topic="")


@dataclass(frozen=True)
class Recorder:
    about: Mapping[str, Any] = parameters.mapping("notes", Sample)


def test_mapping_may_have_entries_of_other_parameters():
    def about(**entries):
        return read_parameters(Recorder, {"~about": entries}.get).about

    assert about(job="a", ratio="", seed="5", mode="", other="") == {
        "job": "a", "ratio": 0.5, "seed": 5, "mode": "slow", "other": "",
    }  # fmt: skip
    assert about(ratio=2, mode="mine") == {"ratio": 2, "mode": "mine"}


def test_declarations_say_what_is_asked():
    declared = declarations(Sample)
    assert list(declared)[:2] == ["ratio", "width"]
    ratio = declared["ratio"]
    assert (ratio.default, ratio.doc) == (0.5, "a ratio")
    assert ratio.allowed == "a number >= 0 and <= 1"
    assert declared["about"].default == {}
    whole = parameters.integer(0, "any").metadata["allowed"]
    assert whole == "a whole number from -2147483648 to 2147483647"


def test_values_made_in_python_are_checked():
    check_parameters(Sample())
    check_parameters(Sample(ratio=1.0))
    for ratio, more in ((2.0, ""), ("1", ", not a text")):
        shown = f"^ratio is {ratio!r}: it must be a number >= 0 and <= 1{more}$"
        with pytest.raises(ParameterError, match=shown):
            check_parameters(Sample(ratio=ratio))


@dataclass(frozen=True)
class Settings:
    std: float = parameters.number(0.1, "noise", minimum=0.0)
    every_light: bool = parameters.boolean(False, "all")
    levels: Tuple[float, ...] = parameters.numbers((0.0, 0.5), "of std, 100 %", 0.0, maximum=10.0)
    lights: Tuple[str, ...] = parameters.choices(("dark",), "to try", ("dark", "bright"))
    path: str = parameters.text("", "a file")


def options(*words):
    parser = ArgumentParser()
    add_options(parser, Settings)
    return read_options(Settings, vars(parser.parse_args(words)))


def test_options_of_a_command_line():
    assert options() == Settings()
    given = ("--every-light", "--levels", "0", "1e1", "--lights=bright dark", "--std=2")
    assert options(*given) == Settings(2.0, True, (0.0, 10.0), ("bright", "dark"))
    assert options("--std=", "--levels=", "--lights=", "--every-light=", "--path=") == Settings()
    for text, value in (("true", True), ("1", True), ("false", False), ("0", False)):
        assert options(f"--every-light={text}").every_light == value


@cases("""
words, message:
  - [[--std, x], "--std is 'x': it must be a number >= 0"]
  - [[--levels, "1", "1"], "--levels is '1 1': it must be different numbers >= 0 and <= 10"]
  - [[--levels, "11"], different numbers >= 0 and <= 10]
  - [[--lights, green], "--lights is 'green': it must be different words of dark, bright"]
  - [[--every-light=yes], "--every-light is 'yes': it must be true or false"]
""")
def test_options_that_are_not_allowed(words, message):
    with pytest.raises(ParameterError) as caught:
        options(*words)
    assert message in str(caught.value)


def test_help_of_options_has_sentence_limits_and_default(capsys):
    with pytest.raises(SystemExit):
        options("--help")
    text = " ".join(capsys.readouterr().out.split())
    assert "noise: a number >= 0; by default 0.1" in text
    assert "of std, 100 %: different numbers >= 0 and <= 10; by default 0 0.5" in text


def test_misspelt_names_are_found():
    with pytest.raises(ParameterError, match="^there is no parameter ~widht: known are ~about, "):
        read(widht=1.0)
