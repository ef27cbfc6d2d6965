"""Bodies in PyBullet. This is the one module that imports PyBullet itself."""

from bullet_lab.entry import hidden_native_output
from bullet_lab.errors import LabError

__all__ = ["EngineMissingError", "PhysicsError", "pybullet"]


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
