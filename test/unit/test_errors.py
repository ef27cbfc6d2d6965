"""Messages for users: one line, of a length that can be read, whatever they quote."""

import pytest

from bullet_lab.errors import LabError


@pytest.mark.parametrize(
    ("message", "line"),
    [
        ("std is -1", "std is -1"),
        ("a\nb\t c", "a b c"),
        (f"id is {10_000 * '9'}: no id", f"id is {150 * '9'}…{149 * '9'}: no id"),
        ("x" * 399, "x" * 399),
    ],
)
def test_a_message_is_one_line(message, line):
    assert str(LabError(message)) == line


def test_a_message_of_many_words_ends():
    assert len(str(LabError(100_000 * "ab "))) < 2100
