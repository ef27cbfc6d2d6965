"""The error of the vision library."""

from __future__ import annotations

from bullet_lab.errors import LabError


class VisionError(LabError):
    """An image, a camera or a setting that cannot be used."""
