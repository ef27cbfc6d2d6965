"""The base of every error that bullet_lab raises on purpose."""


class LabError(Exception):
    """Something outside the program is wrong; the message is one line made for the user.

    Executables catch it, print the line and end with a non-zero status. Each module that
    has errors of its own derives one class from it.
    """

    def __str__(self) -> str:
        # What a message quotes from outside may hold line ends.
        return " ".join(super().__str__().split())
