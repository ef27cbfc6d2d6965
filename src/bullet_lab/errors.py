"""The base of every error that bullet_lab raises on purpose."""

import re

# What is longer, without a space, is somebody's input that was quoted: its ends will do.
LONG_WORD = 400
QUOTED = 150


class LabError(Exception):
    """Something outside the program is wrong; the message is one line made for the user.

    Executables catch it, print the line and end with a non-zero status. Each module that
    has errors of its own derives one class from it.
    """

    def __str__(self) -> str:
        # What a message quotes from outside may hold line ends, and be of any length.
        words = re.sub(rf"\S{{{LONG_WORD},}}", _ends, super().__str__()).split()
        line = " ".join(words)
        return line if len(line) <= 10 * LONG_WORD else f"{line[: 5 * LONG_WORD]} …"


def _ends(word: "re.Match[str]") -> str:
    """Return the first and the last characters of a word."""
    text = word.group()
    return f"{text[:QUOTED]}…{text[-QUOTED:]}"
