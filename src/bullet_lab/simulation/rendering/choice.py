"""Which renderer to draw with: EGL where it works, TinyRenderer where it does not."""

from __future__ import annotations

import functools
import logging
import os
import re
import subprocess
import sys
from typing import Tuple

from bullet_lab.errors import LabError

LOG = logging.getLogger(__name__)

EGL = "egl"
TINY = "tiny"
AUTO = "auto"
CHOICES = (AUTO, EGL, TINY)
# Stands in for "auto", for instance in a container whose graphics driver is known.
VARIABLE = "BULLET_LAB_RENDERER"
# Wall seconds after which a driver is not going to answer.
PATIENCE = 60.0


class RendererError(LabError):
    """A renderer that is unknown or does not work."""


def choose_renderer(wanted: str = AUTO) -> str:
    """Return "egl" or "tiny".

    Args:
        wanted: "egl", "tiny", or "auto" for what the environment variable says, else EGL where
            it works. The variable is taken at its word: a process may set it for those that it
            starts and spare them the trial.

    Raises:
        RendererError: another word, or EGL is asked for and does not work.
    """
    said = os.environ.get(VARIABLE, "") or AUTO
    for word in (wanted, said):
        if word not in CHOICES:
            raise RendererError(f"renderer '{word}': it must be one of {', '.join(CHOICES)}")
    if wanted == AUTO and said != AUTO:
        return _note(said, f"said by {VARIABLE}")
    if wanted == TINY:
        return _note(TINY, "asked for")
    works, reason = probe_egl()
    if not works and wanted == EGL:
        raise RendererError(f"EGL does not work here: {reason}")
    return _note(EGL, reason) if works else _note(TINY, f"EGL does not work here: {reason}")


@functools.lru_cache(maxsize=None)
def probe_egl() -> Tuple[bool, str]:
    """Return whether EGL draws here, and with what or why not; found out once per process.

    A driver that is missing or broken can end the process that asks for it, so a child asks.
    """
    command = [sys.executable, "-m", "bullet_lab.simulation.rendering.egl_probe"]
    path = os.pathsep.join(filter(None, sys.path))
    try:
        child = subprocess.run(
            command,
            env=dict(os.environ, PYTHONPATH=path),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer within {PATIENCE:g} s"
    except OSError as error:
        return False, f"the probe cannot be started: {error.strerror}"
    said, driver = (text.decode(errors="replace").strip() for text in (child.stdout, child.stderr))
    if child.returncode == 0:
        name = re.search(r"GL_RENDERER=(.*)", driver)
        return True, name.group(1).strip() if name else "unknown driver"
    if child.returncode < 0:
        return False, f"the driver ended the probe with signal {-child.returncode}"
    last = (said or driver).splitlines()[-1:]
    return False, last[0] if last else f"the probe ended with status {child.returncode}"


@functools.lru_cache(maxsize=None)
def _note(renderer: str, reason: str) -> str:
    """Say once what is drawn with."""
    LOG.info("images are drawn with %s (%s)", {EGL: "EGL", TINY: "TinyRenderer"}[renderer], reason)
    return renderer
