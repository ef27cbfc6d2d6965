"""Notes which files of the library a Python process enters while a flag is set; for walk.py."""

import os
import sys
import threading
import time
from pathlib import Path

FOLDER = Path(os.environ["LAB_WALK"])
FLAG = FOLDER / "recording"
PERIOD = 0.1


def trace():
    """Note the files of all functions that are called, in all threads."""
    root = os.environ["LAB_WALK_ROOT"]
    seen, state = set(), {"on": False}

    def note(frame, event, _):
        if state["on"] and event == "call" and root in frame.f_code.co_filename:
            seen.add(frame.f_code.co_filename)

    def watch():
        # Processes may end without a farewell: the list is written as it grows.
        written = 0
        while True:
            state["on"] = FLAG.exists()
            if len(seen) > written:
                files = sorted(seen)
                name = f"{Path(sys.argv[0]).name}.{os.getpid()}.txt"
                (FOLDER / name).write_text("\n".join(files))
                written = len(files)
            time.sleep(PERIOD)

    threading.Thread(target=watch, daemon=True).start()
    threading.setprofile(note)
    sys.setprofile(note)


trace()
