"""Measures a campaign of dockings on all cores; scripts/bench.sh dock.

How many times real time it runs at. Beside the wall clock, which others may be using the machine
of, it says how much of the cores' time a simulated second takes.
--dockings N: so many. --seed S: of all that is random.
"""

from __future__ import annotations

import os
import resource
import tempfile
from pathlib import Path

LEAST_FACTOR = 25.0


def of_children() -> float:
    """Return the processor time of the workers that have ended, in s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measure, print and write."""
    # Here, since each worker imports this module: as with the command, it is to import little.
    from common import options, write

    from bullet_lab.simulation.rendering import driver_name
    from bullet_lab.studies.dock_campaign.study import DockCampaignSettings, describe, run_campaign
    from bullet_lab.studies.study import workers

    wanted = options(__doc__, dockings=24, seed=1)
    settings = DockCampaignSettings(seed=wanted.seed, dockings=wanted.dockings)
    before = of_children()
    with tempfile.TemporaryDirectory() as folder:
        summary = run_campaign(Path(folder), settings, workers(), tell=print)
    busy = of_children() - before
    print("\n".join(describe(summary)))
    cores, run = len(os.sched_getaffinity(0)), summary["run"]
    idle = cores * run["sim_time_s"] / busy
    print(
        f"campaign: {run['real_time_factor']:.1f} times real time on {cores} cores "
        f"(at least {LEAST_FACTOR:g} wanted); by the cores' time it could be {idle:.1f}"
    )
    figures = {key: run[key] for key in ("sim_time_s", "wall_time_s", "real_time_factor")}
    figures.update(dockings=wanted.dockings, docked=summary["docked"], renderer=driver_name())
    figures["core_seconds_per_sim_second"] = busy / run["sim_time_s"]
    figures["real_time_factor_of_idle_cores"] = idle
    write(wanted.out, figures)


if __name__ == "__main__":
    main()
