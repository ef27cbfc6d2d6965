"""Runs the contract: spawns probes, lets time run, calls services, judges and cleans up."""

import contextlib
from collections import deque
from typing import NamedTuple

import rospy
from contract_judges import Evidence, Scene, judge
from contract_rows import PREFIX, Row
from contract_simulator import CallError, SimulatorError
from rosgraph.names import namespace, ns_join

from bullet_lab.core.pose import Pose
from bullet_lab.ros.messages.poses import pose_message

PASSED, DEVIATES, FAILED, NOT_JUDGED = "passed", "deviates", "FAILED", "not judged"
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


class Verdict(NamedTuple):
    """The result of a row; `detail` is what was found, or the reason of a deviation."""

    row: Row
    status: str
    detail: str = ""


def verdict(row, complaint, deviation=None, instead=""):
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

    Args:
        contract: the contract.
        simulator: that is checked.
        rows: that are judged.
        deviations: the known ones, by row.
        patience: wall seconds for which a simulator that died is waited for.
    """

    def __init__(self, contract, simulator, rows, deviations, patience):
        self._contract = contract
        self._simulator = simulator
        self._wanted = {row.name for row in rows}
        self._deviations = deviations
        self._patience = patience
        self._parameters = []
        self._found = {}
        self._floors = 0
        # What the simulator was asked for last.
        self._last = ""

    def verdicts(self):
        """Return the results of the rows; raise SimulatorError if no simulator answers.

        If it dies on the way, the rows so far keep their results. If another one is started, the
        chapters of an interrupted round are tried again one by one.
        """
        was_paused = self._simulator.must("get_physics_properties").pause
        self._simulator.must("pause_physics")
        groups = deque(self._groups())
        try:
            while groups:
                group = groups.popleft()
                try:
                    self._clear()
                    self._follow(group)
                    self._clear()
                except SimulatorError as error:
                    self._after_failure(group, groups, str(error))
        finally:
            # An error here must not hide the first one.
            with contextlib.suppress(SimulatorError):
                self._clear()
                if not was_paused:
                    self._simulator.must("unpause_physics")
        return [self._found[row.name] for row in self._contract.rows if row.name in self._found]

    def _after_failure(self, group, groups, error):
        """Note that the rest of a group is not judged, or put it before the others, in parts."""
        self._simulator.forget()
        if self._simulator.answers():
            self._give_up(group, f"after {self._last}: {error}")
            return
        reason = f"the simulator died, after {self._last}: {error}"
        if not self._simulator.is_back_within(self._patience):
            for each in (group, *groups):
                self._give_up(each, reason)
            groups.clear()
            return
        self._simulator.must("pause_physics")
        chapters = {}
        for row, probe in group:
            if self._is_left(row):
                chapters.setdefault(row.name.partition("/")[0], []).append((row, probe))
        if len(chapters) > 1:
            groups.extendleft(reversed(list(chapters.values())))
        else:
            self._give_up(group, reason)

    def _give_up(self, rows, reason):
        for row, _ in rows:
            if self._is_left(row):
                self._found[row.name] = Verdict(row, NOT_JUDGED, reason)

    def _is_left(self, row):
        return self._is_wanted(row) and row.name not in self._found

    def _is_wanted(self, row):
        return bool(row.word) and row.name in self._wanted

    def _groups(self):
        """Yield rows that are followed together, with their probes: chapters with steps, rounds."""
        rounds = {}
        for chapter in self._contract.chapters:
            wanted = [row for row in chapter.rows if self._is_wanted(row)]
            if not chapter.has_steps():
                for row in wanted:
                    probe = chapter.probes[row.probe]
                    rounds.setdefault(probe.round, []).append((row, probe))
            elif wanted:
                yield [(row, None) for row in chapter.rows]
        for number in sorted(rounds):
            yield rounds[number]

    def _follow(self, rows):
        """Spawn the probes of some rows, then do and judge the rows one after the other."""
        probes = {probe.name: probe for _, probe in rows if probe}
        where = places(probes)
        refused = self._spawn_all(probes.values(), where)
        topics = [probe.full_name(row.topic) if probe else row.topic for row, probe in rows]
        offered = self._observe([row for row, _ in rows], topics)
        evidence = Evidence()
        if probes:
            commands = [command for probe in probes.values() for command in probe.commands()]
            self._last = f"{ROUND_SECONDS:g} s of time with {', '.join(sorted(probes))}"
            evidence = self._simulator.run(ROUND_SECONDS, commands)
        for (row, probe), topic in zip(rows, topics):
            if row.run:
                before = evidence.seconds
                evidence = self._simulator.run(row.run, row.publish)
                evidence.seconds_before = before
            elif row.wait:
                evidence = self._simulator.stand(row.wait)
            evidence.services = offered
            if row.word == "parameter":
                evidence.parameters = {name: rospy.get_param(name, None) for name in row.expected}
            place = where[probe.name] if probe else CORNER
            scene = Scene(evidence, self._contract.types, topic, place)
            if row.call:
                self._call(row, scene)
            if probe and probe.name in refused:
                reason = f"the probe is refused: {refused[probe.name]}"
                self._found[row.name] = verdict(row, reason)
            elif self._is_wanted(row):
                self._found[row.name] = self._judged(row, scene)
        self._simulator.forget()

    def _call(self, row, scene):
        request = {name: self._contract.read(value) for name, value in row.request.items()}
        self._last = f"{row.call} in '{row.name}'"
        try:
            scene.answer = self._simulator.call(row.call, request)
        except CallError as error:
            scene.error = str(error)
            if not self._simulator.answers():
                raise SimulatorError(scene.error) from error

    def _instead(self, row):
        """Return the expectations that a known deviation meets instead."""
        return self._deviations[row.name].instead if row.name in self._deviations else {}

    def _observe(self, rows, topics):
        """Subscribe to the topics of rows; return type and md5 sum of their services."""
        heard, services = [], []
        for row, topic in zip(rows, topics):
            if row.word in _WITHOUT_MESSAGES:
                services.append(topic)
            if topic and {row.word, *self._instead(row)} - _WITHOUT_MESSAGES:
                heard.append(topic)
            if row.word == "stamped":
                heard.append(ns_join(namespace(topic), row.expected))
        self._simulator.listen(heard)
        return self._simulator.services(services)

    def _judged(self, row, scene):
        found = [judge(word, value, scene) for word, value in self._instead(row).items()]
        complaint = judge(row.word, row.expected, scene)
        deviation = self._deviations.get(row.name)
        return verdict(row, complaint, deviation, "; ".join(filter(None, found)))

    def _spawn_all(self, probes, where):
        """Spawn probes, and a floor below them; return errors by the names of refused probes."""
        standing = [where[probe.name] for probe in probes if probe.floor]
        if standing:
            self._floors += 1
            self._spawn(f"floor_{self._floors}", floor_text(standing), "", Pose())
        refused = {}
        for probe in probes:
            space = probe.robot_namespace
            prefix = {f"/{space}/tf_prefix": probe.tf_prefix} if probe.tf_prefix else {}
            for name, value in {**prefix, **probe.parameters}.items():
                self._parameters.append(name)
                rospy.set_param(name, self._contract.read(value))
            text = probe.text(self._contract.folder)
            pose = Pose.from_rpy(where[probe.name], tuple(probe.rpy))
            try:
                self._spawn(probe.name, text, space, pose)
            except SimulatorError as error:
                if not self._simulator.answers():
                    raise
                refused[probe.name] = str(error)
        return refused

    def _spawn(self, name, text, space, pose):
        self._last = f"spawn of {name}"
        self._simulator.must(
            "spawn_sdf_model",
            model_name=f"{PREFIX}{self._contract.mark}{name}",
            model_xml=text,
            robot_namespace=space,
            initial_pose=pose_message(pose),
        )

    def _clear(self):
        """Remove everything that a run of the contract adds, also that of an earlier run."""
        self._simulator.forget()
        for name in self._simulator.must("get_world_properties").model_names:
            if name.startswith(PREFIX):
                self._last = f"delete of {name}"
                self._simulator.must("delete_model", model_name=name)
        while self._parameters:
            rospy.delete_param(self._parameters.pop())


def places(names):
    """Return the place of each probe by its name, in m."""
    x, y, z = CORNER
    return {
        name: (x + APART * (number % ROW_LENGTH), y + APART * (number // ROW_LENGTH), z)
        for number, name in enumerate(names)
    }


def floor_text(standing):
    """Return the SDF of a static model with a slab below each place."""
    width, depth, height = SLAB
    slabs = "".join(
        f'<collision name="slab_{number}"><pose>{x:g} {y:g} {z - height / 2:g} 0 0 0</pose>'
        f"<geometry><box><size>{width:g} {depth:g} {height:g}</size></box></geometry></collision>"
        for number, (x, y, z) in enumerate(standing)
    )
    link = f'<link name="link">{slabs}</link>'
    return f'<sdf version="1.6"><model name="floor"><static>true</static>{link}</model></sdf>'
