"""Measures what the view in a browser costs; scripts/bench.sh view.

Robots with odometry drive in circles at real time, and the view sends 30 pictures a second to
somebody who speaks viser's protocol and draws nothing. The processor time is the view's own: with
nobody there, with somebody, and with one more robot's camera image of 10 Hz.
--robots N. --seconds S: wall time of a round. --rounds N: of which the median is taken.
"""

import re
import statistics
import time

from common import Bridge, options, report, start_ros, urdf
from lab_nodes import Node, end_all

# `common` has added their folders to the path.
from view_looker import Looker, wait_for_url  # isort: skip

# Most of a core that may be used, in percent.
ALLOWED = {"nobody": 1.0, "somebody": 15.0, "with an image": 25.0}
SETTLE_SECONDS = 5.0


def measure(bridge, view, number, seconds, rounds):
    """Return what the view costs in each of the three cases, medians of rounds."""
    # Each says where it is as often as pictures are sent.
    block = re.sub(r"<odometryRate>[^<]*<", "<odometryRate>30<", urdf("block_robot"))
    for index in range(number):
        bridge.add_robot(index, block)
    url = wait_for_url(view.output)
    rows = []
    for case, allowed in ALLOWED.items():
        if case == "with an image":
            bridge.add_robot(number, urdf("camera_robot"))
        looker = Looker(url) if rows else None
        time.sleep(SETTLE_SECONDS)
        received = looker.received if looker else 0
        percent = statistics.median(view.percent(seconds) for _ in range(rounds))
        rows.append((f"{case}, % of a core", percent, ".1f", f"<= {allowed:g}"))
        if looker:
            rate = (looker.received - received) / (seconds * rounds) / 1000.0
            rows.append((f"{case}, kB/s", rate, ".0f", ""))
            looker.close()
        print(f"{case}: {percent:.1f} % of a core", flush=True)
    return rows


def main():
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
    report(wanted.out, rows, f"{wanted.robots} robots, 30 pictures per second")


if __name__ == "__main__":
    main()
