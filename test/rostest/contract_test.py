#!/usr/bin/env python3
"""Each kind of the contract's rows fails where it is broken."""

import subprocess
import sys
import unittest

import rospy
import rostest
from lab_testing import PACKAGE, wait_for

from bullet_lab.ros.contract.results import FAILED, PASSED
from bullet_lab.ros.contract.rows import read_contract
from bullet_lab.ros.contract.run import ContractRun
from bullet_lab.ros.contract.simulator import Simulator

HERE = PACKAGE / "test" / "rostest"


class StandIn:
    """The stand-in as a process."""

    def __init__(self):
        self.process = subprocess.Popen([sys.executable, str(HERE / "contract_standin.py")])

    def end(self):
        self.process.terminate()
        self.process.wait(10)


def is_offered(service):
    try:
        rospy.wait_for_service(service, 0.05)
        return True
    except rospy.ROSException:
        return False


class BrokenContractTest(unittest.TestCase):
    def setUp(self):
        standin = StandIn()
        self.addCleanup(standin.end)
        wait_for(lambda: is_offered("/gazebo/delete_model"), "the stand-in")
        self.contract = read_contract(HERE / "contract")

    def failed(self, broken):
        """The rows that fail with something broken."""
        rospy.set_param("/broken", broken)
        rows = [row for row in self.contract.rows if broken in ("", row.name.partition("/")[2])]
        verdicts = ContractRun(self.contract, Simulator(), rows, {}).verdicts()
        self.assertEqual(len(verdicts), len(rows))
        self.assertLessEqual({entry.status for entry in verdicts}, {PASSED, FAILED})
        return [entry.row.name for entry in verdicts if entry.status == FAILED]

    def test_each_row_fails_where_it_is_broken_and_holds_where_nothing_is(self):
        self.assertEqual(self.failed(""), [])
        for row in self.contract.rows:
            if row.name != "asked/clock":
                with self.subTest(row.name):
                    self.assertEqual(self.failed(row.name.partition("/")[2]), [row.name])


def setUpModule():
    rospy.init_node("contract_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "contract_test", "__main__")
