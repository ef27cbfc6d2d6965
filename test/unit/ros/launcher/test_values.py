import pytest

from bullet_lab.ros.launcher.values import UsageError, read_values


@pytest.mark.parametrize(
    ("doc", "good", "bad"),
    [
        ("Noise [number >= 0]", ["0", "0.1", "1e-3", ".5", "2."], ["-0.1", "nan", "inf", "x", ""]),
        ("Part [number > 0 <= 1]", ["0.5", "1"], ["0", "1.01"]),
        ("Seed [integer >= 0]", ["0", "42"], ["-1", "1.0", "1e3", "٣"]),
        ("Any [number]", ["-1e300"], ["1e999", "1_000", "0x10", " 1"]),
        ("Show [true|false]", ["true", "false"], ["True", "1", "yes", ""]),
        ("Rule [report|rate_invariant]", ["rate_invariant"], ["report|rate_invariant", "rep"]),
        ("Where [folder]", ["a/b c", "/tmp"], [""]),
        ("What [text]", ["", "anything"], []),
        ("no bracket", ["", "anything"], []),
        ("Bracket [number] in the middle.", ["anything"], []),
    ],
)
def test_allowed_values(doc, good, bad):
    values = read_values(doc)
    for value in good:
        values.check("name", value)
    for value in bad:
        with pytest.raises(UsageError):
            values.check("name", value)


def test_refusal_names_argument_value_and_what_is_allowed():
    with pytest.raises(UsageError, match=r"^std:=-1 is refused, it has to be \[number >= 0\]$"):
        read_values("Noise [number >= 0]").check("std", "-1")


@pytest.mark.parametrize("doc", ["x [nubmer >= 0]", "x [number => 0]", "x [only]", "x [a||b]"])
def test_bracket_outside_the_grammar_is_an_error(doc):
    with pytest.raises(UsageError):
        read_values(doc)
