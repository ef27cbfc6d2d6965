"""Counts the files of the library that a message passes through, traced in running jobs.

twist: from cmd_vel to the row in paths.csv, through the bridge, noisy_odom and plot_noise.
image: from the camera to the decision of docking, through the bridge, aruco and dock.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

PACKAGE = Path(__file__).resolve().parents[2]
LIBRARY = "src/bullet_lab/"
# Wall seconds until the nodes have started, and for which calls are traced.
START_SECONDS, TRACE_SECONDS = 120.0, 5.0


class Walk(NamedTuple):
    """A job, the executables that the message passes through, and seconds before the trace."""

    job: tuple
    executables: tuple
    after: float


BRIDGE = "pybullet_bridge.py"
WALKS = {
    "twist": Walk(("squares", "rtf:=1"), (BRIDGE, "noisy_odom.py", "plot_noise.py"), 8.0),
    "image": Walk(("dock", "rtf:=1", "x:=2"), (BRIDGE, "aruco.py", "dock.py"), 15.0),
}


def files_of(walk, folder):
    """Run a job, trace it for a while, and return the files that each executable entered."""
    tracer = str(Path(__file__).parent / "tracer")
    environment = {**os.environ, "LAB_WALK": str(folder), "LAB_WALK_ROOT": LIBRARY}
    environment["PYTHONPATH"] = os.pathsep.join([tracer, os.environ.get("PYTHONPATH", "")])
    job, *words = walk.job
    process = subprocess.Popen(
        [sys.executable, "-m", "bullet_lab.ros.launcher", job, *words, f"out:={folder / 'out'}"],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
    )
    time.sleep(walk.after)
    flag = folder / "recording"
    flag.touch()
    time.sleep(TRACE_SECONDS)
    flag.unlink()
    process.terminate()
    process.wait(START_SECONDS)
    found = {name: set() for name in walk.executables}
    for name, files in found.items():
        for path in folder.glob(f"{name}.*.txt"):
            files.update(line.split(LIBRARY)[-1] for line in path.read_text().split("\n"))
    return found


def main():
    """Print the files of each walk and their number."""
    parser = argparse.ArgumentParser(prog="house.sh walk", description=__doc__.splitlines()[0])
    # argparse checks an empty list against choices, too.
    parser.add_argument("walks", nargs="*", metavar="|".join(WALKS))
    wanted = parser.parse_args().walks or list(WALKS)
    unknown = sorted(set(wanted) - set(WALKS))
    if unknown:
        parser.error(f"{unknown[0]!r} is not one of {', '.join(WALKS)}")
    for name in wanted:
        with tempfile.TemporaryDirectory() as folder:
            found = files_of(WALKS[name], Path(folder))
        for executable, files in found.items():
            print(f"{name}: {executable}: {len(files)}: {' '.join(sorted(files))}")
        print(f"{name}: {len(set().union(*found.values()))} files")


if __name__ == "__main__":
    main()
