"""Runs the contract: spawns probes, lets time run, calls services, judges and cleans up."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.ros.contract.judges import Evidence, Scene, beside, judge
from bullet_lab.ros.contract.rows import PREFIX, Chapter, Contract, Deviation, Probe, Row
from bullet_lab.ros.contract.simulator import CallError, Simulator, SimulatorError

Place = Tuple[float, float, float]
PASSED, DEVIATES, FAILED = "passed", "deviates", "FAILED"
ROUND_SECONDS = 2.6
"""Simulated seconds for which the probes of a round are observed."""

CORNER = (90.0, -20.0, 100.0)
"""Place of the first probe in m, far from everything else in the world."""

APART = 5.0
"""Distance between probes in m."""

ROW_LENGTH = 10
SLAB = (4.6, 4.6, 0.2)
"""Size of the slab below a probe in m."""

# Rows with only these words need no messages from their topic.
_WITHOUT_MESSAGES = {"offers", "absent", "takes"}


@dataclass(frozen=True)
class Verdict:
    """The result of a row; `detail` is what was found, or the reason of a deviation."""

    row: Row
    status: str
    detail: str = ""


def verdict(
    row: Row, complaint: str, deviation: Optional[Deviation] = None, instead: str = ""
) -> Verdict:
    """Return the result of a row. A row with a known deviation fails unless it deviates so.

    Args:
        row: the row.
        complaint: how the row is not met; empty if it is met.
        deviation: the known deviation, if any.
        instead: how the expectations of the deviation are not met; empty if they are met.
    """
    if deviation is None:
        return Verdict(row, FAILED if complaint else PASSED, complaint)
    if not complaint:
        return Verdict(row, FAILED, "no longer deviates: remove it from deviations.yaml")
    if instead:
        return Verdict(row, FAILED, f"deviates in another way than deviations.yaml has: {instead}")
    return Verdict(row, DEVIATES, f"{complaint}: {deviation.reason}")


class ContractRun:
    """Checks some rows of a contract, and leaves the simulator as it was.

    `deviations` are the known ones, by row.
    """

    def __init__(
        self,
        contract: Contract,
        simulator: Simulator,
        rows: Sequence[Row],
        deviations: Mapping[str, Deviation],
    ):
        self._contract = contract
        self._simulator = simulator
        self._wanted = {row.name for row in rows}
        self._deviations = deviations
        self._parameters: List[str] = []

    def verdicts(self) -> List[Verdict]:
        """Return the results of the rows; raise SimulatorError if they cannot be checked."""
        was_paused = self._simulator.must("get_physics_properties").pause
        self._simulator.must("pause_physics")
        found: List[Verdict] = []
        rounds: Dict[int, List[Tuple[Probe, Row]]] = {}
        try:
            self._clear()
            for chapter in self._contract.chapters:
                rows = [row for row in chapter.rows if row.word and row.name in self._wanted]
                if not chapter.has_steps():
                    for row in rows:
                        probe = chapter.probes[row.probe]
                        rounds.setdefault(probe.round, []).append((probe, row))
                elif rows:
                    found += self._follow(chapter)
                    self._clear()
            for _, round_rows in sorted(rounds.items(), key=lambda entry: entry[0]):
                found += self._round(round_rows)
                self._clear()
        finally:
            # An error here must not hide the first one.
            with contextlib.suppress(SimulatorError):
                self._clear()
                if not was_paused:
                    self._simulator.must("unpause_physics")
        order = {row.name: number for number, row in enumerate(self._contract.rows)}
        return sorted(found, key=lambda entry: order[entry.row.name])

    def _follow(self, chapter: Chapter) -> List[Verdict]:
        """Do and judge the rows of a chapter, one after the other."""
        offered = self._observe([(row, row.topic) for row in chapter.rows])
        evidence = Evidence()
        found: List[Verdict] = []
        for row in chapter.rows:
            if row.run:
                before = evidence.seconds
                evidence = self._simulator.run(row.run, row.publish)
                evidence.seconds_before = before
            elif row.wait:
                evidence = self._simulator.stand(row.wait)
            evidence.services = offered
            if row.word == "parameter":
                evidence.parameters = {name: rospy.get_param(name, None) for name in row.expected}
            scene = Scene(evidence, self._contract.types, row.topic, CORNER)
            if row.call:
                self._call(row, scene)
            if row.word and row.name in self._wanted:
                found.append(self._judged(row, scene))
        self._simulator.forget()
        return found

    def _call(self, row: Row, scene: Scene) -> None:
        request = {name: self._contract.read(value) for name, value in row.request.items()}
        try:
            scene.answer = self._simulator.call(row.call, request)
        except CallError as error:
            scene.error = str(error)

    def _round(self, rows: Sequence[Tuple[Probe, Row]]) -> List[Verdict]:
        """Spawn the probes of some rows, let time run, and judge."""
        present = list({probe.name: probe for probe, _ in rows}.values())
        where = places(present)
        standing = [where[probe.name] for probe in present if probe.floor]
        if standing:
            self._spawn("floor", floor_text(standing), "", Pose())
        refused = {probe.name: self._place(probe, where[probe.name]) for probe in present}
        offered = self._observe([(row, probe.full_name(row.topic)) for probe, row in rows])
        commands = [command for probe in present for command in probe.commands()]
        evidence = self._simulator.run(ROUND_SECONDS, commands)
        evidence.services = offered
        found = []
        for probe, row in rows:
            topic, place = probe.full_name(row.topic), where[probe.name]
            scene = Scene(evidence, self._contract.types, topic, place)
            wrong = refused[probe.name]
            found.append(verdict(row, wrong) if wrong else self._judged(row, scene))
        self._simulator.forget()
        return found

    def _observe(self, named: Iterable[Tuple[Row, str]]) -> Dict[str, Tuple[str, str]]:
        """Subscribe to the topics of rows; return type and md5 sum of their services."""
        topics, services = [], []
        for row, topic in named:
            if row.word in _WITHOUT_MESSAGES:
                services.append(topic)
            deviation = self._deviations.get(row.name)
            words = {row.word, *(deviation.instead if deviation else ())}
            if topic and words - _WITHOUT_MESSAGES:
                topics.append(topic)
            if row.word == "stamped":
                topics.append(beside(topic, row.expected))
        self._simulator.listen(topics)
        return self._simulator.services(services)

    def _judged(self, row: Row, scene: Scene) -> Verdict:
        deviation = self._deviations.get(row.name)
        entries = deviation.instead.items() if deviation else ()
        instead = "; ".join(filter(None, (judge(word, value, scene) for word, value in entries)))
        return verdict(row, judge(row.word, row.expected, scene), deviation, instead)

    def _place(self, probe: Probe, place: Place) -> str:
        """Spawn a probe; return why that failed, or an empty text."""
        space = probe.robot_namespace
        prefix = {f"/{space}/tf_prefix": probe.tf_prefix} if probe.tf_prefix else {}
        for name, value in {**prefix, **probe.parameters}.items():
            self._parameters.append(name)
            rospy.set_param(name, self._contract.read(value))
        text = probe.text(self._contract.folder)
        try:
            self._spawn(probe.name, text, space, Pose.from_rpy(place, tuple(probe.rpy)))
        except SimulatorError as error:
            return f"the probe is refused: {error}"
        return ""

    def _spawn(self, name: str, text: str, space: str, pose: Pose) -> None:
        position = dict(zip("xyz", pose.position))
        orientation = dict(zip("xyzw", pose.quaternion))
        self._simulator.must(
            "spawn_sdf_model",
            model_name=f"{PREFIX}{name}",
            model_xml=text,
            robot_namespace=space,
            initial_pose={"position": position, "orientation": orientation},
        )

    def _clear(self) -> None:
        """Remove everything that a run of the contract adds, also that of an earlier run."""
        self._simulator.forget()
        for name in self._simulator.must("get_world_properties").model_names:
            if name.startswith(PREFIX):
                self._simulator.must("delete_model", model_name=name)
        while self._parameters:
            rospy.delete_param(self._parameters.pop())


def places(probes: Iterable[Probe]) -> Dict[str, Place]:
    """Return the place of each probe by its name, in m."""
    x, y, z = CORNER
    return {
        probe.name: (x + APART * (number % ROW_LENGTH), y + APART * (number // ROW_LENGTH), z)
        for number, probe in enumerate(probes)
    }


def floor_text(standing: Sequence[Place]) -> str:
    """Return the SDF of a static model with a slab below each place."""
    width, depth, height = SLAB
    slabs = "".join(
        f'<collision name="slab_{number}"><pose>{x:g} {y:g} {z - height / 2:g} 0 0 0</pose>'
        f"<geometry><box><size>{width:g} {depth:g} {height:g}</size></box></geometry></collision>"
        for number, (x, y, z) in enumerate(standing)
    )
    link = f'<link name="link">{slabs}</link>'
    return f'<sdf version="1.6"><model name="floor"><static>true</static>{link}</model></sdf>'
