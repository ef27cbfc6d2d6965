"""Measures a campaign of dockings on all cores; run it with scripts/bench.sh dock.

Prints how many times real time it runs at, and writes JSON. Beside the wall clock, which others
may be using the machine of, it says how much of the cores' time a simulated second takes.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import sys
import tempfile
from pathlib import Path
from typing import Any, Dict

from bullet_lab.simulation.rendering.graphics import driver_name
from bullet_lab.studies.dock_campaign.study import (
    DockCampaignSettings,
    describe,
    run_campaign,
)
from bullet_lab.studies.workers import workers

LEAST_FACTOR = 18.0


def measure(dockings: int, seed: int) -> Dict[str, Any]:
    """Run a campaign and return its figures."""
    settings = DockCampaignSettings(seed=seed, dockings=dockings)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        summary = run_campaign(Path(folder), settings, workers(), tell=print)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    for line in describe(summary):
        print(line)
    cores = len(os.sched_getaffinity(0))
    run = summary["run"]
    return {
        "dockings": dockings,
        "docked": summary["docked"],
        "renderer": driver_name(),
        "cores": cores,
        "machine": platform.machine(),
        "sim_time_s": run["sim_time_s"],
        "wall_time_s": run["wall_time_s"],
        "real_time_factor": run["real_time_factor"],
        "core_seconds_per_sim_second": busy / run["sim_time_s"],
        "real_time_factor_of_idle_cores": cores * run["sim_time_s"] / busy,
    }


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="bench_dock", description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="JSON file")
    parser.add_argument("--dockings", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    values = parser.parse_args()
    found = measure(values.dockings, values.seed)
    print(
        f"campaign: {found['real_time_factor']:.1f} times real time on {found['cores']} cores "
        f"(at least {LEAST_FACTOR:g} wanted); by the cores' time it could be "
        f"{found['real_time_factor_of_idle_cores']:.1f}"
    )
    values.out.parent.mkdir(parents=True, exist_ok=True)
    values.out.write_text(json.dumps(found, indent=2) + "\n")
    sys.exit(0)


if __name__ == "__main__":
    main()
