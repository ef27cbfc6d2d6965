"""The parameter `renderer`, from when there was a choice; there is none any more."""

from __future__ import annotations

import logging

LOG = logging.getLogger(__name__)

AUTO = "auto"
CHOICES = (AUTO, "egl", "tiny")


def check_choice(renderer: str) -> None:
    """Say so where somebody asks for a renderer that is gone."""
    if renderer == "tiny":
        LOG.warning("renderer 'tiny' is gone: Panda3D draws all pictures, through EGL")
