"""Plays scenarios on a simulator and compares them with Gazebo's figures: scripts/beside_gazebo.sh.

The simulator is what answers on the ROS master: this package's bridge, which is started if none
is there, or a Gazebo. Prints a table, writes all of it as CSV, and ends with 1 if a row fails.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from beside_direct import DirectStage
from beside_scenarios import DRIVES, PACKAGE, Played, Stage, play_drive
from beside_table import (
    FAILED,
    Allowed,
    Row,
    allowed_by_name,
    allowed_in_drive,
    allowed_of_sensor,
    as_csv,
    compare,
    read_figures,
    summary,
    table,
    write_figures,
)
from beside_trials import THROUGH_ROS, TRIALS

from bullet_lab.errors import LabError

FIGURES = PACKAGE / "data" / "gazebo"
OUT = Path("results/beside_gazebo")
SENSORS = "sensors"
HOLDS = (
    "slide",
    "push",
    "torque_z",
    "slope",
    "drop",
    "roll",
    "fall",
    "turn",
    "pendulum",
    "set_model_state",
    "block",
    "cpmr_block",
    "izz",
    "sensor_robot",
    "camera_robot",
    "burger",
    "rover",
    "four_wheels",
)
"""Beginnings of scenarios' names. The tests demand that each figure is within its limit."""

Scene = Tuple[str, Played, Callable[[str], Optional[Allowed]]]
"""A scenario's name, what came of it, and what is allowed of each figure."""

# The tutorials' robots include files of their package.
os.environ["ROS_PACKAGE_PATH"] = os.pathsep.join(
    filter(None, (os.environ.get("ROS_PACKAGE_PATH"), str(PACKAGE / "test")))
)


def names() -> List[str]:
    """Return the names of all scenarios."""
    drives = [drive.name_at(heading) for drive in DRIVES for heading in drive.turned]
    return [*TRIALS, *drives, SENSORS]


def known() -> Dict[str, Played]:
    """Return Gazebo's figures by scenario."""
    return {**read_figures(FIGURES / "physics.json"), **read_figures(FIGURES / "sensors.json")}


def play(
    wanted: Sequence[str] = (),
    headings: Sequence[float] = (),
    start: Tuple[float, float] = (0.0, 0.0),
    stage: Stage | None = None,
    out: Path = OUT,
) -> Iterator[Scene]:
    """Play scenarios by the beginnings of their names, all if there are none.

    Yields name, what came of it, and what is allowed. Without headings, a drive has those at which
    Gazebo's figures were recorded. Without a stage, it is played in this process, and only what
    needs no ROS. Pictures go to the folder `out`.
    """
    direct = stage is None
    stage = stage or DirectStage()
    for name, trial in TRIALS.items():
        if _is_wanted(name, wanted) and not (direct and name in THROUGH_ROS):
            played = trial(stage=stage)
            stage.clear()
            yield name, played, allowed_by_name(name).get
    for drive in DRIVES:
        for heading in headings or drive.turned:
            name = drive.name_at(heading)
            if _is_wanted(name, wanted):
                played = play_drive(drive, stage, heading, (*start, 0.0))
                yield name, played, allowed_in_drive(drive).get
    if _is_wanted(SENSORS, wanted) and not direct:
        from beside_sensors import sensors

        yield SENSORS, sensors(stage, out), allowed_of_sensor
        stage.clear()


def _is_wanted(name: str, wanted: Sequence[str]) -> bool:
    return not wanted or any(name.startswith(word) for word in wanted)


def rows_of(played: Sequence[Scene], known: Mapping[str, Played]) -> List[Row]:
    """Return the rows of all scenarios."""
    nothing = Played()
    return [
        row
        for name, here, limits in played
        for row in compare(name, known.get(name, nothing).figures, here.figures, limits)
    ]


def check(*wanted: str, headings: Sequence[float] = (), show: bool = True) -> List[Row]:
    """Play scenarios in this process and return the rows; print those with a limit."""
    rows = rows_of(list(play(wanted, headings)), known())
    if show:
        print(table(rows, bool(headings)))
        print(summary(rows))
    return rows


@contextlib.contextmanager
def ros_stage(by_clock: bool = False) -> Iterator[Stage]:
    """Be a node, and use the simulator on the master; without one, a bridge of its own."""
    import rospy
    from beside_ros import RosStage, end_all, is_there, start_bridge

    from bullet_lab.ros.launcher.supervision import prepare_master

    prepare_master()
    rospy.init_node("beside_gazebo", anonymous=True, disable_signals=True)
    bridge = None if is_there() else start_bridge(*["_clock_rate:=1000"] * by_clock)
    try:
        stage = RosStage(by_clock)
        yield stage
        stage.close()
    finally:
        if bridge is not None:
            end_all(bridge)


def read_options(words: Sequence[str]) -> argparse.Namespace:
    """Read the command line; ends the program where it is wrong."""
    parser = argparse.ArgumentParser(prog="beside_gazebo.sh", description=(__doc__ or ""))
    parser.add_argument("--only", default="", help="beginnings of scenarios' names, with commas")
    parser.add_argument(
        "--headings", default="", help="of the drives, degrees, with commas, for the recorded ones"
    )
    parser.add_argument("--start", default="0,0", help="of the drives: x,y in m")
    parser.add_argument("--direct", action="store_true", help="in this process, without ROS")
    parser.add_argument("--clock", action="store_true", help="run by /clock, as a Gazebo is run")
    parser.add_argument("--all", action="store_true", help="print figures without a limit, too")
    parser.add_argument("--list", action="store_true", help="print the names of the scenarios")
    parser.add_argument("--figures", type=Path, help="recorded ones to compare with")
    parser.add_argument("--record", type=Path, help="write the figures to this file")
    parser.add_argument("--page", action="store_true", help="renew docs/beside_gazebo.md")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for table and pictures")
    options = parser.parse_args(list(words))
    options.only = [word for word in options.only.split(",") if word]
    options.headings = [float(word) for word in options.headings.split(",") if word]
    options.start = tuple(float(word) for word in options.start.split(","))
    if not any(_is_wanted(name, options.only) for name in names()):
        parser.error("no scenario has such a name; --list shows all")
    if options.page and (options.only or options.direct):
        parser.error("--page needs all scenarios, through ROS")
    return options


def main(words: Sequence[str]) -> int:
    """Run the program; return its status."""
    options = read_options(words)
    if options.list:
        print("\n".join(names()))
        return 0
    gazebo = read_figures(options.figures) if options.figures else known()
    options.out.mkdir(parents=True, exist_ok=True)
    played: List[Scene] = []
    problem = ""
    with contextlib.nullcontext(None) if options.direct else ros_stage(options.clock) as stage:
        scenes = play(options.only, options.headings, options.start, stage, options.out)
        try:
            for scene in scenes:
                played.append(scene)
                print(scene[0], file=sys.stderr, flush=True)
        except LabError as error:
            # A simulator that has died does not take with it what was heard before.
            problem = f"beside_gazebo: stopped after {len(played)} scenarios: {error}"
    if options.record:
        write_figures(options.record, "recorded by beside_gazebo.sh", {n: p for n, p, _ in played})
    rows = rows_of(played, gazebo)
    print(table(rows, options.all or bool(options.headings)))
    print(summary(rows))
    if options.page and not problem:
        from beside_page import write_page

        write_page(rows, {n: p for n, p, _ in played}, gazebo, options.out)
    (options.out / "table.csv").write_text(as_csv(rows), encoding="utf-8")
    if problem:
        print(problem, file=sys.stderr)
    return int(bool(problem) or any(row.verdict == FAILED for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
