"""Jobs as processes of their own, some at a time, each with a master of its own."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, List, Mapping, Sequence

LONGEST = 900.0
"""Wall seconds that a job may take."""

PROCESSORS: Dict[str, Dict[str, str]] = {
    "this": {},
    # An x86-64 of 2006: what finds out at run time what a processor can do is told that it cannot.
    "plain": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable,-FMA4_Usable",
        "NPY_DISABLE_CPU_FEATURES": "SSE41 POPCNT SSE42 AVX F16C FMA3 AVX2 AVX512F AVX512CD"
        " AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR",
        "OPENBLAS_CORETYPE": "Prescott",
        "OPENCV_CPU_DISABLE": "SSE4.1,SSE4.2,AVX,FP16,FMA3,AVX2,AVX512-SKX",
        "OPENCV_IPP": "disabled",
        "LP_NATIVE_VECTOR_WIDTH": "128",
        "GALLIUM_OVERRIDE_CPU_CAPS": "sse3",
    },
}
"""Variables that have libraries compute as another processor would have them."""

_POLL_PERIOD = 0.05
# The launcher needs as long to stop its nodes.
_STOP_TIMEOUT = 5.0
_TIED = ("setpriv", "--pdeathsig", "TERM")


@dataclass(frozen=True)
class Run:
    """A job that is run into a folder, with words such as n:=2."""

    job: str
    words: Sequence[str]
    folder: Path

    @property
    def log(self) -> Path:
        """What it says."""
        return self.folder.with_suffix(".log")

    def start(self, processor: str) -> _Process:
        """Start it; it ends with this process."""
        tied = _TIED if shutil.which(_TIED[0]) else ()
        launcher = (sys.executable, "-m", "bullet_lab.ros.launcher")
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        with self.log.open("wb") as log:
            process = subprocess.Popen(
                [*tied, *launcher, self.job, *self.words, f"out:={self.folder}"],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=_environment(PROCESSORS[processor]),
            )
        return _Process(self, process, time.monotonic() + LONGEST)

    def last_line(self) -> str:
        """What it said last."""
        lines = self.log.read_text(errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), "")


@dataclass(frozen=True)
class _Process:
    run: Run
    process: subprocess.Popen
    deadline: float

    def ended(self) -> bool:
        if time.monotonic() > self.deadline:
            self.process.kill()
            self.process.wait()
        return self.process.poll() is not None


def _environment(more: Mapping[str, str]) -> Dict[str, str]:
    # Whoever runs this may be a node itself.
    ours = {n: v for n, v in os.environ.items() if not n.startswith("ROS_") or n in _OF_PACKAGES}
    return {**ours, **more}


_OF_PACKAGES = ("ROS_PACKAGE_PATH", "ROS_ROOT", "ROS_ETC_DIR", "ROS_VERSION", "ROS_DISTRO")


def run_all(
    runs: Sequence[Run], at_once: int, processor: str, note: Callable[[], None]
) -> List[int]:
    """Run jobs, `note` each that ends, and return their statuses in the order of the jobs."""
    left, running = list(reversed(runs)), []
    status: Dict[Path, int] = {}
    try:
        while left or running:
            while left and len(running) < at_once:
                running.append(left.pop().start(processor))
            time.sleep(_POLL_PERIOD)
            for one in [one for one in running if one.ended()]:
                running.remove(one)
                status[one.run.folder] = one.process.returncode
                note()
    finally:
        _stop([one.process for one in running])
    return [status[run.folder] for run in runs]


def _stop(processes: Sequence[subprocess.Popen]) -> None:
    for process in processes:
        process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + _STOP_TIMEOUT
    for process in processes:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(max(0.0, deadline - time.monotonic()))
        process.kill()
        process.wait()
