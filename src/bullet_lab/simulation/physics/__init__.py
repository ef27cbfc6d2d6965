"""Bodies in PyBullet. This is the one module that imports PyBullet itself."""

from bullet_lab.entry import hidden_native_output
from bullet_lab.errors import LabError

__all__ = ["EngineMissingError", "PhysicsError", "is_contact", "pybullet"]


class EngineMissingError(LabError):
    """PyBullet is not installed for this Python."""


class PhysicsError(LabError):
    """PyBullet refused something."""


try:
    with hidden_native_output():
        import pybullet
except ImportError as error:
    import sys

    raise EngineMissingError(
        f"PyBullet is not installed for {sys.executable}: run scripts/setup.sh, "
        "or build with the virtual environment that README.md describes"
    ) from error


def is_contact(point: tuple) -> bool:
    """Return whether one of PyBullet's contact points is a contact.

    PyBullet also lists points that are merely near. Shapes that come apart overlap without force.
    """
    distance, force = point[8], point[9]
    return force > 0.0 or distance < 0.0
