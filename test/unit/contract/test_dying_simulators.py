"""A simulator that dies while the contract is checked: what is judged all the same."""

import pytest
from contract_judges import Evidence
from contract_rows import read_contract
from contract_run import FAILED, NOT_JUDGED, PASSED, ContractRun
from contract_simulator import CallError, SimulatorError
from shared import cases

PROBES = """
plugin: libnothing.so
probes: {one: {robot: box.sdf}}
rows: [{name: row, line: 1, probe: one, topic: secret, absent: true}]
"""
STEPS = """
rows:
- {name: first, line: 1, call: first, answers: {}}
- {name: second, line: 1, call: second, fails: true}
"""


class Mortal:
    """A simulator without ROS, which dies of some requests, each time or `lives` times in all."""

    def __init__(self, deadly, lives):
        self.deadly, self.lives = deadly, lives
        self.dead, self.models, self.spawned = False, [], []

    def must(self, service, **request):
        name = request.get("model_name", "")
        if service == "spawn_sdf_model":
            self.spawned.append(name)
            self.models.append(name)
        self._do(f"{service} {name}", SimulatorError)
        if service == "delete_model":
            self.models.remove(name)
        self.pause, self.model_names = False, list(self.models)
        return self

    def call(self, service, _request):
        self._do(service, CallError)

    def run(self, _seconds, _commands):
        self._do(f"run {self.models}", SimulatorError)
        return Evidence()

    def answers(self):
        return not self.dead

    def is_back_within(self, _seconds):
        self.dead, self.models, self.lives = self.lives <= 0, [], self.lives - 1
        return not self.dead

    def listen(self, *_topics):
        """Do nothing."""

    forget = listen

    def services(self, _names):
        return {}

    def _do(self, what, error):
        self.dead = self.dead or any(word in what for word in self.deadly)
        if self.dead:
            raise error(f"{what}: no answer")


@pytest.fixture
def contract(tmp_path):
    (tmp_path / "probes").mkdir()
    (tmp_path / "probes" / "box.sdf").write_text("<sdf>$plugin</sdf>")
    for name, text in {"a": PROBES, "b": PROBES, "steps": STEPS}.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    return read_contract(tmp_path, "mark_")


STATUSES = {"P": PASSED, "F": FAILED, "-": NOT_JUDGED}


@cases("""
deadly, lives, statuses:
  # What it dies of, its further lives, and what is judged of a/row, b/row, steps/first and
  # steps/second: passed (P), failed (F) or not judged (-).
  - [[], 0, P P P F]
  - [[delete_model contract_mark_a], 9, P P P F]
  - [[spawn_sdf_model contract_mark_a], 9, "- P P F"]
  - [["run ['contract_mark_floor_1"], 9, P P P F]
  - [[spawn_sdf_model contract_mark_b], 0, "- - P F"]
  - [[second], 1, P P P -]
  - [[first], 0, "- - - -"]
""")
def test_what_is_judged_of_a_simulator_that_dies(contract, deadly, lives, statuses):
    simulator = Mortal(deadly, lives)
    verdicts = ContractRun(contract, simulator, contract.rows, {}, 1.0).verdicts()
    assert [entry.status for entry in verdicts] == [STATUSES[s] for s in statuses.split()]
    for entry in verdicts:
        assert ("the simulator died, after" in entry.detail) == (entry.status == NOT_JUDGED)

    assert all(name.startswith("contract_mark_") for name in simulator.spawned)
