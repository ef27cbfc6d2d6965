"""Follows the contract: probes into the world, time, calls, verdicts, and all away again."""

from __future__ import annotations

import contextlib
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import rospy

from bullet_lab.core.pose import Pose
from bullet_lab.ros.contract import probes
from bullet_lab.ros.contract.evidence import Evidence, Scene, beside
from bullet_lab.ros.contract.judges import judge
from bullet_lab.ros.contract.results import Verdict, verdict
from bullet_lab.ros.contract.rows import Chapter, Contract, Deviation, Probe, Row
from bullet_lab.ros.contract.simulator import CallError, Simulator, SimulatorError

# Simulated seconds for which probes are listened to.
ROUND_SECONDS = 2.6
# Rows about what need not be a topic.
NOT_HEARD = frozenset(("offers", "absent", "takes"))
PLACE = probes.CORNER


class ContractRun:
    """Checks some rows of a contract, and leaves the simulator as it was.

    `deviations` are those that are known of, by row.
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
        """Return what comes of the rows; raises SimulatorError where that cannot be found out."""
        was_paused = self._simulator.must("get_physics_properties", {}).pause
        self._simulator.must("pause_physics", {})
        found: List[Verdict] = []
        try:
            self._clear()
            for chapter in self._contract.chapters:
                if chapter.has_steps() and self._asked(chapter.rows):
                    found += self._follow(chapter)
                    self._clear()
            found += self._rounds()
        finally:
            # The first error is the one to tell.
            with contextlib.suppress(SimulatorError):
                self._clear()
                if not was_paused:
                    self._simulator.must("unpause_physics", {})
        order = {row.name: number for number, row in enumerate(self._contract.rows)}
        return sorted(found, key=lambda entry: order[entry.row.name])

    def _asked(self, rows: Iterable[Row]) -> List[Row]:
        return [row for row in rows if row.word and row.name in self._wanted]

    def _judged(self, row: Row, scene: Scene) -> Verdict:
        deviation = self._deviations.get(row.name)
        instead = ""
        if deviation is not None and deviation.instead:
            entries = deviation.instead.items()
            instead = "; ".join(filter(None, (judge(word, say, scene) for word, say in entries)))
        return verdict(row, judge(row.word, row.expected, scene), deviation, instead)

    def _heard(self, named: Iterable[Tuple[Row, str]]) -> Iterable[str]:
        """Return the topics that rows have to be judged by, from rows and their topics."""
        for row, topic in named:
            deviation = self._deviations.get(row.name)
            if {row.word, *(deviation.instead if deviation else ())} - NOT_HEARD:
                yield topic
            if row.word == "stamped":
                yield beside(topic, row.expected)

    # Rows that are followed in their order

    def _follow(self, chapter: Chapter) -> List[Verdict]:
        """Do and judge what the rows of a chapter say, one after the other."""
        asked = {row.name for row in self._asked(chapter.rows)}
        services = [row.topic for row in chapter.rows if row.word in NOT_HEARD]
        self._simulator.listen(self._heard((row, row.topic) for row in chapter.rows if row.topic))
        offered = self._simulator.services(services)
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
            scene = Scene(evidence, self._contract.types, row.topic, PLACE)
            if row.call:
                self._call(row, scene)
            if row.name in asked and row.word:
                found.append(self._judged(row, scene))
        self._simulator.forget()
        return found

    def _call(self, row: Row, scene: Scene) -> None:
        request = {name: self._read(value) for name, value in row.request.items()}
        try:
            scene.answer = self._simulator.call(row.call, request)
        except CallError as error:
            scene.error = str(error)

    def _read(self, value: Any) -> Any:
        """Return a value; the text of a file where it names one."""
        if not (isinstance(value, dict) and set(value) == {"file"}):
            return value
        return (self._contract.folder / "probes" / value["file"]).read_text(encoding="utf-8")

    # Probes that are looked at together

    def _rounds(self) -> List[Verdict]:
        found: List[Verdict] = []
        rows: Dict[int, List[Tuple[Probe, Row]]] = {}
        for chapter in self._contract.chapters:
            for row in () if chapter.has_steps() else self._asked(chapter.rows):
                probe = chapter.probes[row.probe]
                rows.setdefault(probe.round, []).append((probe, row))
        for number in sorted(rows):
            found += self._round(rows[number])
            self._clear()
        return found

    def _round(self, rows: Sequence[Tuple[Probe, Row]]) -> List[Verdict]:
        """Put the probes of some rows into the world, let time run, and judge."""
        present = list({probe.name: probe for probe, _ in rows}.values())
        where = probes.places(present)
        standing = [where[probe.name] for probe in present if probe.floor]
        if standing:
            self._spawn(probes.FLOOR, probes.floor_text(standing), "")
        refused = {probe.name: self._place(probe, where[probe.name]) for probe in present}
        named = [(row, probes.topic_name(row.topic, probe)) for probe, row in rows if row.topic]
        services = [topic for row, topic in named if row.word in NOT_HEARD]
        self._simulator.listen(self._heard(named))
        evidence = self._simulator.run(ROUND_SECONDS, _commands(present))
        evidence.services = self._simulator.services(services)
        found = []
        for probe, row in rows:
            scene = self._scene(row, probe, where[probe.name], evidence)
            wrong = refused[probe.name]
            found.append(verdict(row, wrong) if wrong else self._judged(row, scene))
        self._simulator.forget()
        return found

    def _scene(self, row: Row, probe: Probe, place: Any, evidence: Evidence) -> Scene:
        topic = probes.topic_name(row.topic, probe) if row.topic else ""
        return Scene(evidence, self._contract.types, topic, place)

    def _place(self, probe: Probe, place: probes.Place) -> str:
        """Put a probe into the world; return what is wrong where that fails."""
        space = probes.namespace(probe)
        prefix = {f"/{space}/tf_prefix": probe.tf_prefix} if probe.tf_prefix else {}
        for name, value in {**prefix, **probe.parameters}.items():
            self._parameters.append(name)
            rospy.set_param(name, self._read(value))
        text = probes.probe_text(probe, self._contract.folder)
        pose = Pose.from_rpy(place, tuple(probe.rpy))
        try:
            self._spawn(probes.model_name(probe), text, space, pose)
        except SimulatorError as error:
            return f"the probe is refused: {error}"
        return ""

    def _spawn(self, name: str, text: str, space: str, pose: Optional[Pose] = None) -> None:
        x, y, z = (pose or Pose()).position
        i, j, k, w = (pose or Pose()).quaternion
        at = {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": i, "y": j, "z": k, "w": w}}
        request = {"model_name": name, "model_xml": text, "initial_pose": at}
        self._simulator.must("spawn_sdf_model", {**request, "robot_namespace": space})

    def _clear(self) -> None:
        """Take away all that such a run puts into a world, an earlier one's too."""
        self._simulator.forget()
        for name in self._simulator.must("get_world_properties", {}).model_names:
            if name.startswith(probes.PREFIX):
                self._simulator.must("delete_model", {"model_name": name})
        while self._parameters:
            rospy.delete_param(self._parameters.pop())


def _commands(present: Sequence[Probe]) -> List[Dict[str, Any]]:
    return [
        {**entry, "topic": probes.topic_name(entry["topic"], probe)}
        for probe in present
        for entry in probe.publish
    ]
