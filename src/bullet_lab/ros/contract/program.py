"""The program that checks whether a simulator keeps what Gazebo's ROS interface promises.

Usage: rosrun bullet_lab gazebo_contract.py [--only TEXT] [--junit FILE] [--list]

It is told to stand on a master with a simulator: this package's bridge, or a Gazebo.

:ROS Service clients: those of /gazebo
:ROS Subscribers, publishers: whatever the probes that it spawns speak and listen to
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import List, Sequence

import rospy

from bullet_lab.core import parameters
from bullet_lab.core.parameters import ArgumentParser, ArgumentsError, add_options, read_options
from bullet_lab.errors import LabError
from bullet_lab.ros.contract.results import FAILED, deviations_table, listing, table, write_junit
from bullet_lab.ros.contract.rows import Contract, Row, read_contract
from bullet_lab.ros.contract.run import ContractRun
from bullet_lab.ros.contract.simulator import Simulator
from bullet_lab.ros.node.node import STATUS_BAD_PARAMETER, NodeError, run_node
from bullet_lab.simulation.world.resources import ResourceFinder

NAME = "gazebo_contract"
FILES = "package://bullet_lab/config/contract/services.yaml"
# A service that only this package's bridge offers.
BRIDGE = "/bullet_lab/step"
AUTO, NONE = "auto", "none"


@dataclass(frozen=True)
class ContractParameters:
    """What the program takes, as options."""

    only: str = parameters.text("", "check the rows whose name has this in it; all if empty")
    list: bool = parameters.boolean(False, "say which rows there are, and check nothing")
    deviations: str = parameters.choice(
        AUTO, "the bridge's deviations are known of: auto where it is the bridge", (AUTO, NONE)
    )
    markdown: bool = parameters.boolean(False, "say the deviations as a table in Markdown")
    junit: str = parameters.text("", "file for the results as JUnit's XML; none if empty")
    contract: str = parameters.text("", "folder with another contract; the package's if empty")


def main() -> None:
    """Run the program: status 0 where all rows hold, 1 where one does not, 2 on bad options."""
    try:
        options = read_command(rospy.myargv(sys.argv)[1:])
        folder = options.contract or ResourceFinder.anywhere().find(FILES).parent
        contract = read_contract(Path(folder))
        rows = [row for row in contract.rows if options.only in row.name]
        if not rows:
            raise ArgumentsError(f"no row has '{options.only}' in its name; --list shows all")
    except LabError as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        sys.exit(STATUS_BAD_PARAMETER)
    if options.markdown:
        print(deviations_table(contract))
    elif options.list:
        print(listing(rows, contract.known))
    else:
        run_node(NAME, lambda: check(contract, rows, options))


def read_command(words: Sequence[str]) -> ContractParameters:
    """Return what a command line says; raises LabError."""
    parser = ArgumentParser(prog=f"{NAME}.py", description=(__doc__ or "").split("\n")[0])
    add_options(parser, ContractParameters)
    return read_options(ContractParameters, vars(parser.parse_args(list(words))))


def check(contract: Contract, rows: List[Row], options: ContractParameters) -> None:
    """Check rows, print the table and write the file; raises NodeError where one fails."""
    start = time.monotonic()
    simulator = Simulator()
    with_known = options.deviations == AUTO and BRIDGE in simulator.offered()
    known = contract.known if with_known else {}
    verdicts = ContractRun(contract, simulator, rows, known).verdicts()
    print(table(verdicts))
    if options.junit:
        write_junit(Path(options.junit), verdicts, time.monotonic() - start)
    failed = sum(entry.status == FAILED for entry in verdicts)
    if failed:
        raise NodeError(f"{failed} of {len(verdicts)} rows do not hold")
