"""Measures laser scans, and the engine with a fleet of robots; scripts/bench.sh laser.

No ROS master: the simulation alone, and the making of messages.
--rounds N: of which the median is taken. --seconds S: simulated, of the fleet.
"""

import statistics
import time
from io import BytesIO

from common import options, report

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.conversions import Converter
from bullet_lab.simulation.plugins.samples import PlanarCommand
from bullet_lab.simulation.simulation import Simulation

WORLD = "package://bullet_lab/worlds/beacons.world"
ROBOT = "package://bullet_lab/urdf/block_robot.urdf"
FLEET = 20
PER_ROW = 5
SPACING = 1.5
# Where rows of robots have none of the beacons in their way.
FIRST_PLACE = (1.0, 6.0)


def add_fleet(simulation, number):
    """Add robots that drive in circles."""
    robots = []
    for index in range(number):
        name = f"robot_{index}"
        row, column = divmod(index, PER_ROW)
        x, y = FIRST_PLACE
        pose = Pose((x + SPACING * column, y + SPACING * row, 0.0))
        robot = simulation.spawn(ROBOT, name, pose, namespace=name)
        robot.command(f"/{name}/cmd_vel", PlanarCommand(vx=0.2, wz=0.3))
        robots.append(robot)
    return robots


def message_writer(kind):
    """Return a listener that makes messages of samples, as the bridge does."""
    convert = Converter(kind).convert
    buffer = BytesIO()

    def write(sample):
        buffer.seek(0)
        convert(sample).serialize(buffer)

    return write


def scan_milliseconds(robots, scans):
    """Return how long scans of one robot took, among others."""
    times = []
    with Simulation.of(WORLD) as simulation:
        fleet = add_fleet(simulation, robots)
        simulation.run_for(0.1)
        laser = next(d for d in fleet[0].plugins for o in d.outputs if "scan" in o.topic)
        laser.outputs[0].connect(message_writer(laser.outputs[0].kind))
        for number in range(scans):
            start = time.perf_counter()
            laser.produce(number)
            times.append(1e3 * (time.perf_counter() - start))
    return times


def engine_factor(robots, seconds):
    """Return the real-time factor of the engine's steps with a fleet that nobody drives."""
    with Simulation.of(WORLD) as simulation:
        add_fleet(simulation, robots)
        simulation.run_for(0.2)
        for instance in simulation.models.values():
            instance.plugins = ()
        start = time.perf_counter()
        simulation.run_for(seconds)
        return seconds / (time.perf_counter() - start)


def main():
    """Measure, print and write the medians of the rounds."""
    wanted = options(__doc__, rounds=3, seconds=5.0)
    alone, among = (scan_milliseconds(robots, 100 * wanted.rounds) for robots in (1, FLEET))
    factors = [engine_factor(FLEET, wanted.seconds) for _ in range(wanted.rounds)]
    rows = [
        ("360-ray scan with its message, ms", statistics.median(alone), ".2f", "<= 1"),
        (f"the same among {FLEET} robots", statistics.median(among), ".2f", "<= 1"),
        (f"{FLEET} robots, the engine's steps alone", statistics.median(factors), ".1f", ""),
    ]
    report(wanted.out, rows)


if __name__ == "__main__":
    main()
