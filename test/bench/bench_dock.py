"""Measures a campaign of dockings on all cores; scripts/bench.sh dock.

How many times real time it runs at.
--dockings N: so many. --seed S: of all that is random.
"""

import tempfile
from pathlib import Path

LEAST_FACTOR = 25.0


def main():
    """Measure, print and write."""
    # Here, since each worker imports this module: as with the command, it is to import little.
    from common import options, report

    from bullet_lab.simulation.rendering import driver_name
    from bullet_lab.studies.dock_campaign.study import DockCampaignSettings, describe, run_campaign
    from bullet_lab.studies.study import workers

    wanted = options(__doc__, dockings=24, seed=1)
    settings = DockCampaignSettings(seed=wanted.seed, dockings=wanted.dockings)
    with tempfile.TemporaryDirectory() as folder:
        summary = run_campaign(Path(folder), settings, workers(), tell=print)
    print("\n".join(describe(summary)))
    run = summary["run"]
    rows = [("times real time", run["real_time_factor"], ".1f", f">= {LEAST_FACTOR:g}")]
    figures = {"dockings": wanted.dockings, "docked": summary["docked"]}
    report(wanted.out, rows, "campaign", renderer=driver_name(), **figures)


if __name__ == "__main__":
    main()
