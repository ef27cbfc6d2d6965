"""The kinds of faults, and the fault that a seed and an index mean."""

import shlex
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from bullet_lab.jobs.declaration import find_jobs

PACKAGE = Path(__file__).resolve().parents[2]
JOBS = find_jobs(PACKAGE)
# In addition to a job's smallest run: work for both workers, and a bag to be closed.
MORE = {"dock_campaign": ["n:=2"], "sensors": ["record:=true"]}
LAUNCHER, TERMINAL, NODE, WORKER = "run.sh", "terminal", "node", "worker"
"""Receivers of a signal: run.sh alone, all processes of a terminal, a node, a study's worker."""
# Wall s: half of the moments are between FIRST and EARLY, with equal weight for each decade.
FIRST, EARLY, LATE = 1e-3, 1.0, 8.0
STOPPED_SECONDS = 5.0


class Kind(NamedTuple):
    """A kind of fault.

    Attributes:
        weight: its frequency, relative to other kinds.
        targets: receivers of the signal.
        signal: the signal, if any; SIGCONT follows a SIGSTOP.
        live: whether it needs a simulation that runs on ROS.
    """

    weight: float
    targets: tuple = ()
    signal: int = 0
    live: bool = False


KINDS = {
    name: Kind(**{**entry, "signal": getattr(signal, entry.get("signal", ""), 0)})
    for name, entry in yaml.safe_load(f"""
kill: {{weight: 4, targets: [{LAUNCHER}, {NODE}, {NODE}, {NODE}, {WORKER}], signal: SIGKILL}}
int: {{weight: 4, targets: [{LAUNCHER}, {TERMINAL}, {TERMINAL}, {NODE}, {WORKER}], signal: SIGINT}}
term: {{weight: 3, targets: [{LAUNCHER}, {NODE}, {NODE}, {WORKER}], signal: SIGTERM}}
stop: {{weight: 2, targets: [{LAUNCHER}, {NODE}, {NODE}, {WORKER}], signal: SIGSTOP}}
# The job uses a running master, which ends; for master_back, another one replaces it.
master_gone: {{weight: 1}}
master_back: {{weight: 1}}
disk_full: {{weight: 1.5}}
# Simulated time is paused for a while.
clock: {{weight: 1, live: true}}
# A node subscribes to all topics, does not read, and ends after a while.
deaf: {{weight: 1.5, live: true}}
# The node that drives the robot gets a signal while the robot moves.
rest_int: {{weight: 1, signal: SIGINT, live: true}}
rest_term: {{weight: 1, signal: SIGTERM, live: true}}
""").items()
}


@dataclass(frozen=True)
class Fault:
    """A fault, and the job and the moment of it.

    Attributes:
        target: receiver of the signal.
        choice: number in [0, 1) that selects one of several targets.
        moment: wall seconds after the target has started.
    """

    seed: int
    index: int
    job: str
    kind: str
    target: str
    choice: float
    moment: float


def arguments_of(job):
    """Return the arguments of a job's smallest run, with two workers where it has workers."""
    declared = JOBS[job]
    workers = ["workers:=2"] if "workers" in declared.arguments else []
    return [*shlex.split(declared.smallest), *workers, *MORE.get(job, ())]


def is_live(job):
    """Return whether a job has a simulation that runs on ROS."""
    text = JOBS[job].path.read_text()
    return "bridge.launch.xml" in text or "pybullet_bridge.py" in text


def drawn(seed, index):
    """Return the fault of an index: jobs take turns, everything else is random."""
    job = list(JOBS)[index % len(JOBS)]
    random = np.random.default_rng([seed, index])
    kinds = [name for name, kind in KINDS.items() if is_live(job) or not kind.live]
    weights = np.array([KINDS[name].weight for name in kinds])
    name = kinds[random.choice(len(kinds), p=weights / weights.sum())]
    targets = KINDS[name].targets
    target = targets[random.integers(len(targets))] if targets else ""
    if target == WORKER and "workers" not in JOBS[job].arguments:
        target = NODE
    choice, share, early = random.uniform(), random.uniform(), random.uniform() < 0.5
    moment = FIRST * (EARLY / FIRST) ** share if early else LATE * share
    return Fault(seed, index, job, name, target, round(choice, 6), round(moment, 6))
