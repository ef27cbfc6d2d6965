#!/usr/bin/env python3
"""The contract holds for the bridge, and each kind of its rows fails where it is broken."""

import os
import subprocess
import sys
import tempfile
import unittest
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import rospy
import rostest
from lab_testing import PACKAGE, PATIENCE, Master, Node, wait_for

sys.path.insert(0, str(PACKAGE / "test" / "contract"))
from contract_rows import read_contract  # noqa: E402
from contract_run import FAILED, NOT_JUDGED, PASSED, ContractRun  # noqa: E402
from contract_simulator import Simulator  # noqa: E402

HERE = PACKAGE / "test" / "rostest"
PROGRAM = PACKAGE / "test" / "contract" / "gazebo_contract.py"


class BrokenContractTest(unittest.TestCase):
    def setUp(self):
        standin = subprocess.Popen([sys.executable, str(HERE / "contract_standin.py")])
        self.addCleanup(standin.wait)
        # It keeps nothing; asked by SIGTERM, on a busy machine, it did not end within 10 s.
        self.addCleanup(standin.kill)
        rospy.wait_for_service("/gazebo/delete_model", PATIENCE)
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


class BridgeContractTest(unittest.TestCase):
    def test_the_bridge_keeps_the_contract(self):
        master = Master()
        self.addCleanup(master.end)
        master.set_parameter("/use_sim_time", True)
        bridge = Node("pybullet_bridge.py", master=master.uri)
        self.addCleanup(bridge.end)
        wait_for(lambda: master.offers("/bullet_lab/advance"), lambda: bridge.err)
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        junit = Path(folder.name) / "contract.xml"
        # A chapter can be repeated.
        for words in (("--junit", str(junit)), ("--only", "bumper/"), ("--only", "bumper/")):
            run = subprocess.run(
                [sys.executable, str(PROGRAM), *words],
                env=dict(os.environ, ROS_MASTER_URI=master.uri),
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=2 * PATIENCE,
            )
            lines = run.stdout.splitlines()
            self.assertEqual([line for line in lines if line.startswith((FAILED, NOT_JUDGED))], [])
            self.assertEqual(run.returncode, 0, run.stdout[-2000:])
        suite = ElementTree.parse(junit).getroot()
        self.assertEqual(suite.get("failures"), "0")
        self.assertGreater(int(suite.get("tests")), 300)


def setUpModule():
    rospy.init_node("contract_test")


if __name__ == "__main__":
    rostest.rosrun("bullet_lab", "contract_test", "__main__")
