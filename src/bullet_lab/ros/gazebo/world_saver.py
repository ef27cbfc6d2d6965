"""The service /bullet_lab/save_world: the running world as an SDF file."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import rospy

from bullet_lab.core.files import replace_file
from bullet_lab.errors import LabError
from bullet_lab.ros.bridge.running_world import RunningWorld
from bullet_lab.ros.messages.conversions import time_of
from bullet_lab.simulation.world_writer import world_text
from bullet_lab.srv import SaveWorld, SaveWorldResponse


class SaveError(LabError):
    """A world cannot be saved there."""


class WorldSaver:
    """Offers the service.

    Only the look at where everything is holds the simulation up; the text is made and written
    in the thread of whoever asks.
    """

    def __init__(self, world: RunningWorld):
        self._world = world
        self._lock = threading.Lock()
        self._service = rospy.Service("/bullet_lab/save_world", SaveWorld, self._save)

    def _save(self, request: Any) -> SaveWorldResponse:
        start = time.perf_counter()
        try:
            # One at a time, or the later file could be put in place before the earlier one.
            with self._lock:
                response = self._write(request.path)
        except LabError as error:
            return SaveWorldResponse(success=False, status_message=str(error))
        response.seconds = time.perf_counter() - start
        return response

    def _write(self, name: str) -> SaveWorldResponse:
        path = _target(name)
        snapshot = self._world.do(self._world.simulation.snapshot)
        text, notes = world_text(snapshot, path.parent)
        replace_file(path, lambda part: part.write_text(text, encoding="utf-8"))
        return SaveWorldResponse(
            success=True,
            status_message="; ".join(notes),
            path=str(path),
            models=len(snapshot.models),
            saved_at=time_of(snapshot.step),
        )


def _target(name: str) -> Path:
    if not name or "\0" in name:
        raise SaveError("no file is named")
    path = Path(name).expanduser().absolute()
    if path.is_dir():
        raise SaveError(f"{path} is a folder")
    if not path.parent.is_dir():
        raise SaveError(f"there is no folder {path.parent}")
    return path
