#!/usr/bin/env python3
"""The contract holds for the bridge; test/unit/contract shows where each kind of its rows fails."""

import sys
import unittest

from lab_testing import PACKAGE, PATIENCE, Master, Node, Process, run_tests, wait_for

sys.path.insert(0, str(PACKAGE / "test" / "contract"))
from contract_run import FAILED, NOT_JUDGED  # noqa: E402

PROGRAM = PACKAGE / "test" / "contract" / "gazebo_contract.py"


class BridgeContractTest(unittest.TestCase):
    def test_the_bridge_keeps_the_contract(self):
        master = Master()
        self.addCleanup(master.end)
        master.set_parameter("/use_sim_time", True)
        bridge = Node("pybullet_bridge.py", master=master.uri)
        self.addCleanup(bridge.end)
        wait_for(lambda: master.offers("/bullet_lab/advance"), lambda: bridge.err)
        # All of it; and a chapter can be repeated.
        for words, most in (((), 300), (("--only", "bumper/"), 10), (("--only", "bumper/"), 10)):
            run = Process(sys.executable, str(PROGRAM), *words, ROS_MASTER_URI=master.uri)
            status, lines = run.wait(2 * PATIENCE), run.out.splitlines()
            self.assertEqual([line for line in lines if line.startswith((FAILED, NOT_JUDGED))], [])
            self.assertEqual(status, 0, run.said[-2000:])
            self.assertGreater(len(lines), most)


if __name__ == "__main__":
    run_tests()
