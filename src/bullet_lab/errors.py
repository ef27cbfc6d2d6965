"""The base class of all errors that bullet_lab raises."""

import re

# A longer word in a message is quoted input: only its first and last characters are kept.
LONG_WORD = 400
QUOTED = 150


class LabError(Exception):
    """An error with a cause outside the program; the message is one line for the user.

    Executables catch it, print the line and exit with a non-zero status. A module derives only
    errors from this class that somebody catches.
    """

    def __str__(self) -> str:
        # Quoted input may have line ends and any length.
        words = re.sub(rf"\S{{{LONG_WORD},}}", _ends, super().__str__()).split()
        line = " ".join(words)
        return line if len(line) <= 10 * LONG_WORD else f"{line[: 5 * LONG_WORD]} …"


def _ends(word: "re.Match[str]") -> str:
    """Return the first and the last characters of a word."""
    text = word.group()
    return f"{text[:QUOTED]}…{text[-QUOTED:]}"
