"""Plays scenarios on a simulator and compares them with Gazebo's figures: scripts/beside_gazebo.sh.

The simulator is what answers on the ROS master: this package's bridge, which is started if none
is there, or a Gazebo. Prints a table, writes all of it as CSV, and ends with 1 if a row fails.
"""

import argparse
import contextlib
import os
import sys
from pathlib import Path

from beside_direct import DirectStage
from beside_scenarios import DRIVES, PACKAGE, Played, play_drive
from beside_table import (
    FAILED,
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
DEVIATE = ("husky", "two_casters@45")
"""Beginnings of scenarios that do not agree; the tests demand it of all others."""

# The tutorials' robots include files of their package.
os.environ["ROS_PACKAGE_PATH"] = os.pathsep.join(
    filter(None, (os.environ.get("ROS_PACKAGE_PATH"), str(PACKAGE / "test")))
)


def names():
    """Return the names of all scenarios."""
    drives = [drive.name_at(heading) for drive in DRIVES for heading in drive.turned]
    return [*TRIALS, *drives, SENSORS]


def known():
    """Return Gazebo's figures by scenario."""
    return {**read_figures(FIGURES / "physics.json"), **read_figures(FIGURES / "sensors.json")}


def play(is_wanted, headings=(), stage=None, out=OUT):
    """Play the scenarios whose names are wanted.

    Yields name, what came of it, and a function that returns what is allowed of a figure. Without
    headings, a drive has those at which Gazebo's figures were recorded. Without a stage, it is
    played in this process, and only what needs no ROS. Pictures go to the folder `out`.
    """
    direct = stage is None
    stage = stage or DirectStage()
    for name, trial in TRIALS.items():
        if is_wanted(name) and not (direct and name in THROUGH_ROS):
            played = trial(stage=stage)
            stage.clear()
            yield name, played, allowed_by_name(name).get
    for drive in DRIVES:
        for heading in headings or drive.turned:
            name = drive.name_at(heading)
            if is_wanted(name):
                yield name, play_drive(drive, stage, heading), allowed_in_drive(drive).get
    if is_wanted(SENSORS) and not direct:
        from beside_sensors import sensors

        yield SENSORS, sensors(stage, out), allowed_of_sensor
        stage.clear()


def rows_of(scenes, known):
    """Return the rows of all scenarios that were played, beside Gazebo's figures."""
    return [
        row
        for name, here, limits in scenes
        for row in compare(name, known.get(name, Played()).figures, here.figures, limits)
    ]


@contextlib.contextmanager
def ros_stage(by_clock):
    """Be a node, and use the simulator on the master; without one, a bridge of its own."""
    import rospy
    from beside_ros import RosStage, end_all, start_bridge

    from bullet_lab.ros.launcher.supervision import prepare_master

    prepare_master()
    rospy.init_node("beside_gazebo", anonymous=True, disable_signals=True)
    bridges = start_bridge(*["_clock_rate:=1000"] * by_clock)
    try:
        stage = RosStage(by_clock)
        yield stage
        stage.close()
    finally:
        end_all(*bridges)


def read_options(words):
    """Read the command line; ends the program where it is wrong."""
    parser = argparse.ArgumentParser(prog="beside_gazebo.sh", description=__doc__)
    parser.add_argument("--only", default="", help="beginnings of scenarios' names, with commas")
    parser.add_argument(
        "--headings", default="", help="of the drives, degrees, with commas, for the recorded ones"
    )
    parser.add_argument("--direct", action="store_true", help="in this process, without ROS")
    parser.add_argument("--clock", action="store_true", help="run by /clock, as a Gazebo is run")
    parser.add_argument("--list", action="store_true", help="print the names of the scenarios")
    parser.add_argument("--figures", type=Path, help="recorded ones to compare with")
    parser.add_argument("--record", type=Path, help="write the figures to this file")
    parser.add_argument("--page", action="store_true", help="renew docs/beside_gazebo.md")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for table and pictures")
    options = parser.parse_args(words)
    if options.page and (options.only or options.direct):
        parser.error("--page needs all scenarios, through ROS")
    # Each name begins with "".
    options.only = tuple(filter(None, options.only.split(","))) or ""
    options.headings = [float(word) for word in options.headings.split(",") if word]
    if not any(name.startswith(options.only) for name in names()):
        parser.error("no scenario has such a name; --list shows all")
    return options


def main(words):
    """Run the program; return its status."""
    options = read_options(words)
    if options.list:
        print("\n".join(names()))
        return 0
    gazebo = read_figures(options.figures) if options.figures else known()
    options.out.mkdir(parents=True, exist_ok=True)
    scenes, problem = [], ""
    with contextlib.nullcontext(None) if options.direct else ros_stage(options.clock) as stage:
        try:
            for scene in play(
                lambda name: name.startswith(options.only), options.headings, stage, options.out
            ):
                scenes.append(scene)
                print(scene[0], file=sys.stderr, flush=True)
        except LabError as error:
            # A simulator that has died does not take with it what was heard before.
            problem = f"beside_gazebo: stopped after {len(scenes)} scenarios: {error}"
    played = {name: here for name, here, _ in scenes}
    if options.record:
        write_figures(options.record, "recorded by beside_gazebo.sh", played)
    rows = rows_of(scenes, gazebo)
    print(table(rows, bool(options.headings)))
    print(summary(rows))
    if options.page and not problem:
        from beside_page import write_page

        write_page(rows, played, gazebo, options.out)
    (options.out / "table.csv").write_text(as_csv(rows), encoding="utf-8")
    if problem:
        print(problem, file=sys.stderr)
    return int(bool(problem) or any(row.verdict == FAILED for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
