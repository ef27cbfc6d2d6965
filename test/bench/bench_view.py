"""Measures what the view in a browser costs; scripts/bench.sh view.

Robots with odometry drive in circles at real time, and the view sends 30 pictures a second to
somebody who speaks viser's protocol and draws nothing. The processor time is the view's own: with
nobody there, with somebody, and with one more robot's camera image of 10 Hz.
--robots N. --seconds S: wall time of a round. --rounds N: of which the median is taken.
"""

from __future__ import annotations

import re
import sys
import time
from typing import Any, Dict, List

from common import Bridge, options, start_ros, urdf, write
from lab_nodes import PACKAGE, Node, end_all

sys.path.insert(0, str(PACKAGE / "test" / "rostest"))
from view_looker import Looker, wait_for_url  # noqa: E402

# Most of a core that may be used, in percent.
ALLOWED = {"nobody": 1.0, "somebody": 15.0, "with an image": 25.0}
SETTLE_SECONDS = 5.0


def measure(bridge: Bridge, view: Node, number: int, seconds: float, rounds: int) -> List[Any]:
    """Return what the view costs in each of the three cases, medians and extremes of rounds."""
    # Each says where it is as often as pictures are sent.
    block = re.sub(r"<odometryRate>[^<]*<", "<odometryRate>30<", urdf("block_robot"))
    for index in range(number):
        bridge.add_robot(index, block)
    url = wait_for_url(view.output)
    rows = []
    for case in ALLOWED:
        if case == "with an image":
            bridge.add_robot(number, urdf("camera_robot"))
        looker = Looker(url) if rows else None
        time.sleep(SETTLE_SECONDS)
        received = looker.received if looker else 0
        percents = sorted(view.percent(seconds) for _ in range(rounds))
        row: Dict[str, Any] = {"case": case, "percent": percents[rounds // 2], "rounds": percents}
        if looker:
            row["kB_per_s"] = (looker.received - received) / (seconds * rounds) / 1000.0
            names = [name for name in looker.nodes if "/robots/" in name]
            row["bodies"] = sum(len(looker.positions(name)) for name in names)
            looker.close()
        print(f"{case}: {row['percent']:.1f} % of a core", flush=True)
        rows.append(row)
    return rows


def main() -> None:
    """Measure, print and write."""
    wanted = options(__doc__, robots=20, seconds=10.0, rounds=3)
    start_ros()
    bridge = Bridge("_publish_world_tf:=true")
    log = wanted.out.with_suffix(".log")
    log.unlink(missing_ok=True)
    view = Node("view", "_port:=18300", log=log)
    try:
        rows = measure(bridge, view, wanted.robots, wanted.seconds, wanted.rounds)
    finally:
        end_all(view, bridge)
    print(f"\n{wanted.robots} robots, 30 pictures per second\n")
    print(f"{'':16}{'% of a core':>12}{'allowed':>9}{'kB/s':>8}{'bodies':>8}")
    for row in rows:
        print(
            f"{row['case']:16}{row['percent']:12.1f}{ALLOWED[row['case']]:9.0f}"
            f"{row.get('kB_per_s', 0.0):8.0f}{row.get('bodies', 0):8d}"
        )
    write(wanted.out, {"robots": wanted.robots, "rows": rows})


if __name__ == "__main__":
    main()
