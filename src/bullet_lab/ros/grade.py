"""Grades submissions to an exercise.

Each is a process group with limits, in a copy of its folder. It runs in a process of its own with
the simulation, its ROS master and a node that watches; one that fails is a mark, not an end.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import rospy
from gazebo_msgs.msg import ModelStates
from roslib.message import get_message_class

from bullet_lab import srv
from bullet_lab.core.files import file_errors, make_folder, write_json
from bullet_lab.core.parameters import text
from bullet_lab.entry import adopt_orphans, end_at_once_when_interrupted
from bullet_lab.errors import LabError
from bullet_lab.jobs.declaration import read_job
from bullet_lab.msg import TouchedModels
from bullet_lab.ros.launcher.command import StopSignals
from bullet_lab.ros.launcher.output import environment_without_ros, temporary_folder, tied
from bullet_lab.ros.launcher.supervision import Launch, prepare_master
from bullet_lab.ros.node.node import holds_within
from bullet_lab.simulation.world.resources import ResourceFinder, package_share
from bullet_lab.studies.grade import (
    AGAIN,
    GRADE,
    Criterion,
    Exercise,
    Record,
    find_exercise,
    grade,
    read_exercise,
    write_grade,
)
from bullet_lab.studies.study import (
    SUMMARY,
    TaskLostError,
    Tell,
    WorkerSettings,
    progress,
    run_from,
    workers,
    write_table,
)

NAME = "grade"
TABLE = "grades.csv"
# The program of the process in which a submission runs once.
TRIAL = f"import {__name__} as grade; grade.run_trial()"
# Wall seconds for start and end of the simulation, besides those of the exercise.
MARGIN = 120.0
STOP_TIMEOUT = 15.0
# Wall seconds for the simulation to start.
START = 60.0
# Wall seconds between two checks.
CHECK_PERIOD = 0.02
# Simulated seconds for which the robot is watched after the submission has ended.
AFTERWARDS = 1.0
# Hz in simulated time; more messages are no control any more.
MOST_RATE = 200.0
# m between two poses, which no robot drives.
JUMP = 0.3
# A run at less than this share of the real-time factor is reported, if it took as many simulated s.
LEAST_PACE, LEAST_TIME = 0.8, 5.0
COMMANDS = Criterion(topic="cmd_vel", type="geometry_msgs/Twist", measure="rate")
GROUND = "ground_plane"
# Wall seconds between SIGTERM and SIGKILL.
GRACE = 2.0
# Bytes of each file that a submission writes.
LARGEST_FILE = 20_000_000
LIMITS = {
    -signal.SIGXCPU: "used too much processor time",
    -signal.SIGKILL: "used too much processor time",
    -signal.SIGXFSZ: "wrote a file of more than 20 MB",
}
"""What the limits of a process end it for, by its status."""

# Characters of the last printed line, and of a file that is left.
LONGEST_LINE = 200
LONGEST_FILE = 10_000


class SubmissionError(LabError):
    """A submission cannot be started."""


def command_of(folder: Path) -> list[str]:
    """Return the command that starts a submission; raise SubmissionError."""
    for name in ("main.py", "main.sh"):
        if (folder / name).is_file():
            if not os.access(folder / name, os.X_OK):
                raise SubmissionError(f"{name} is not executable; run chmod +x {name}")
            return [f"./{name}"]
    launch = sorted(folder.glob("*.launch"))
    if len(launch) != 1:
        count = f"{len(launch)} launch files"
        raise SubmissionError(f"it has no main.py, no main.sh and {count}; one is needed")
    return ["roslaunch", launch[0].name]


def _start(command: list[str], output: Path, **options: Any) -> subprocess.Popen:
    """Start a process that ends with this one and prints to a file."""
    with output.open("wb") as file:
        streams = {"stdin": subprocess.DEVNULL, "stdout": file, "stderr": subprocess.STDOUT}
        return subprocess.Popen(tied(*command), **streams, **options)


class Submission:
    """A submission that runs in a copy of its folder, `work`, until it is closed."""

    def __init__(self, folder: Path, work: Path, output: Path, seconds: int):
        self.output, self._work = output, work
        self._others = children_before()
        limits = [f"--cpu={seconds}:{seconds + 1}", f"--fsize={LARGEST_FILE}", "--core=0"]
        try:
            shutil.copytree(folder, work, symlinks=True)
            command = ["prlimit", *limits, *command_of(folder)]
            self._process = _start(command, output, cwd=work, start_new_session=True)
        except OSError as error:
            raise SubmissionError(f"it cannot be started: {str(error)[:LONGEST_LINE]}") from error

    def close(self) -> None:
        """End the process group: SIGTERM, then SIGKILL; then all that has left the group."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(GRACE)
        end_children(self._others)

    def status(self) -> int | None:
        """Return the exit status; None while it runs."""
        return self._process.poll()

    def why_ended(self) -> list[str]:
        """Return lines that say what was wrong with its end; none while it runs."""
        status, lines = self.status(), []
        if status in LIMITS:
            lines = [f"it was ended, since it {LIMITS[status]}"]
        elif status:
            how = f"ended with status {status}" if status > 0 else f"was ended by signal {-status}"
            tail = self.output.read_bytes()[-10 * LONGEST_LINE :].decode(errors="replace")
            printed = [line.strip() for line in tail.split("\n") if line.strip()]
            lines = [f"it {how}: {(printed or ['it printed nothing'])[-1][:LONGEST_LINE]}"]
        if status is not None and _children() - self._others:
            lines.append("it left processes behind, which were ended")
        return lines

    def file(self, name: str) -> str:
        """Return the beginning of a file in the working folder; empty if there is none."""
        path = (self._work / name).resolve()
        # A pipe would never end.
        if not path.is_file() or self._work.resolve() not in path.parents:
            return ""
        with path.open("rb") as file:
            return file.read(LONGEST_FILE).decode(errors="replace")


def children_before() -> set[int]:
    """Adopt orphans from now on, and return the children that this process has now."""
    adopt_orphans()
    return _children()


def end_children(others: set[int]) -> None:
    """Kill all children of this process but some others, and those that become orphans by that."""
    until = time.monotonic() + GRACE
    while _children() - others and time.monotonic() < until:
        for process in _children() - others:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
                os.waitpid(process, 0)


def _children() -> set[int]:
    texts = [path.read_text() for path in Path("/proc/self/task").glob("*/children")]
    return {int(word) for text in texts for word in text.split()}


class Watcher:
    """Records the robot, and the topics that the criteria name."""

    def __init__(self, exercise: Exercise):
        self.record = Record()
        self.now = 0.0
        describe = rospy.ServiceProxy("/bullet_lab/describe_models", srv.DescribeModels)
        describe.wait_for_service(START)
        models = [one for one in describe("", False).models if one.name != GROUND]
        self._robot = next((one.name for one in models if not one.of_world_file), "")
        self.record.boxes = {
            one.name: [one.least.x, one.least.y, one.greatest.x, one.greatest.y]
            for one in models
            if one.name != self._robot
        }
        rospy.Subscriber("/gazebo/model_states", ModelStates, self._locate)
        rospy.Subscriber("/bullet_lab/touched", TouchedModels, self._touch)
        for one in (*(one for one in exercise.criteria if one.topic), COMMANDS):
            kind = get_message_class(one.type)
            rows: list[list[float]] = []
            # Two criteria with the same key get the same messages.
            self.record.messages[one.key] = rows
            rospy.Subscriber(one.topic, kind, self._receive, (rows, one.path))
        if not holds_within(lambda: self.record.path, START):
            raise LabError("the world has no robot")

    def _locate(self, message: ModelStates) -> None:
        self.now = rospy.get_time()
        if self._robot in message.name:
            place = message.pose[message.name.index(self._robot)].position
            self.record.path.append([self.now, place.x, place.y])

    def _touch(self, message: TouchedModels) -> None:
        self.record.touched = sorted({*self.record.touched, *message.models} - {GROUND})

    def _receive(self, message: object, how: tuple[list, str]) -> None:
        rows, path = how
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        value = float(attrgetter(path)(message)) if path else 0.0
        # JSON and means have no other numbers.
        if math.isfinite(value):
            rows.append([stamp.to_sec() if stamp else rospy.get_time(), value])

    def flood(self, seconds: float) -> str:
        """Return the first topic with too many messages in some seconds; empty if none has."""
        most = MOST_RATE * max(seconds, 1.0)
        keys = (key for key, rows in self.record.messages.items() if len(rows) > most)
        return next(keys, "").split(" ")[0]


def watch(exercise: Exercise, submission: Submission, watcher: Watcher, goes_on) -> None:
    """Watch a submission until it ends or has to be ended, and complete the record."""
    has_to_end = any(one.measure == "exit_status" for one in exercise.criteria)
    record, begin, wall = watcher.record, watcher.now, time.monotonic()
    why, ended, seconds, waited = [], None, 0.0, 1.0
    while not why and (ended is None or watcher.now < ended + AFTERWARDS):
        time.sleep(CHECK_PERIOD)
        seconds, waited = watcher.now - begin, time.monotonic() - wall
        if ended is None and submission.status() is not None:
            ended, record.status = watcher.now, submission.status()
        if submission.output.stat().st_size > exercise.output_limit * 1000:
            why = [f"it printed more than {exercise.output_limit} kB"]
        elif watcher.flood(seconds):
            why = [f"it sent more than {MOST_RATE:g} messages a second to {watcher.flood(seconds)}"]
        elif ended is None and seconds > exercise.simulated_limit:
            why = [f"it still ran after {exercise.simulated_limit:g} simulated s"] * has_to_end
            break
        elif waited > exercise.wall_limit:
            why = [f"it was not done after {exercise.wall_limit:g} s of wall time"]
        elif not goes_on():
            raise LabError("the simulation has ended")
    if seconds > LEAST_TIME and seconds < LEAST_PACE * exercise.rtf * waited:
        why.append(f"the simulation ran at {seconds / waited:.1f} of rtf {exercise.rtf:g}: {AGAIN}")
    if np.abs(np.diff(record.track(), axis=0)).max(initial=0.0) > JUMP:
        why.append("the robot was moved by a service, not driven")
    record.notes = why + submission.why_ended()
    record.files = {one.file: submission.file(one.file) for one in exercise.criteria if one.file}


def run_trial() -> None:
    """Run a submission once in this process, with the words that `_trial` gives it.

    What was seen is written to a file, also if a run is impossible.
    """
    end_at_once_when_interrupted()
    # ROS would read them as its own.
    (file, seed, *places), sys.argv[1:] = sys.argv[1:], []
    folder, work, output, record = map(Path, places)
    try:
        seen = _seen(read_exercise(Path(file)), seed, folder, work, output)
    except (LabError, rospy.ROSException) as error:
        seen = Record(notes=[str(error)])
    write_json(record, asdict(seen))


def _seen(exercise: Exercise, seed: str, folder: Path, work: Path, output: Path) -> Record:
    """Run a submission and return what was seen; raise LabError if that is impossible."""
    signals = StopSignals()
    x, y, yaw = exercise.start
    values = {
        "world": exercise.world,
        "robot": str(ResourceFinder.anywhere().find(exercise.robot)),
        "robot_pose": f"{x} {y} 0 0 0 {math.radians(yaw)}",
        "rtf": str(exercise.rtf),
        "seed": seed,
    }
    package = package_share()
    job = read_job(package / "launch" / "include" / "bridge.launch.xml", package)
    with Launch(job, values, prepare_master()) as launch:

        def goes_on() -> bool:
            return launch.verdict(lambda: False, signals.received) is None

        rospy.init_node("grade", disable_signals=True)
        watcher = Watcher(exercise)
        submission = Submission(folder, work, output, exercise.processor_limit)
        with contextlib.closing(submission):
            watch(exercise, submission, watcher, goes_on)
        rospy.signal_shutdown("done")
    return watcher.record


@dataclass(frozen=True)
class GradeSettings(WorkerSettings):
    """Parameters of the job."""

    exercise: str = text("", "name in config/exercises, or path of a .yaml")
    submission: str = text("", "folder with one submission")
    class_folder: str = text("", "folder with a folder for each submission, instead")
    base: str = text(".", "folder that paths are relative to")


@dataclass(frozen=True)
class Grader:
    """Grades submissions to the exercise in a file; each has a folder for its results."""

    file: Path
    folders: list[tuple[Path, Path]]

    def kept(self, number: int) -> dict[str, Any]:
        """Return the mark from an earlier run with the same files; empty if there is none."""
        folder, out = self.folders[number]
        try:
            mark = json.loads((out / GRADE).read_text())
            return mark if mark["files"] == self._digest(folder) else {}
        except (OSError, ValueError, LookupError, TypeError):
            return {}

    def _digest(self, folder: Path) -> str:
        digest = hashlib.sha256(self.file.read_bytes())
        for path in sorted(path for path in folder.rglob("*") if os.path.isfile(path)):
            with contextlib.suppress(OSError):
                name = f"{path.relative_to(folder)} {path.stat().st_mode} {path.stat().st_size}"
                digest.update(name.encode(errors="replace"))
                digest.update(path.read_bytes())
        return digest.hexdigest()

    def __call__(self, number: int) -> dict[str, Any]:
        """Run and grade a submission, write the files of its mark, and return the mark."""
        exercise, (folder, out) = read_exercise(self.file), self.folders[number]
        make_folder(out)
        try:
            command_of(folder)
            seeds = range(exercise.seed, exercise.seed + exercise.runs)
            longest = exercise.wall_limit + MARGIN
            records = [_trial(self.file, seed, folder, out, longest) for seed in seeds]
        except (SubmissionError, OSError) as error:
            records = [Record(notes=[str(error)])]
        mark = grade(folder.name, exercise, records)
        is_slow = any(AGAIN in line for line in mark["why"])
        mark["files"] = "" if is_slow else self._digest(folder)
        write_grade(out, mark, exercise, records)
        return mark


def _trial(file: Path, seed: int, folder: Path, out: Path, longest: float) -> Record:
    """Run a submission once, for some wall seconds at most, and return what was seen."""
    with temporary_folder() as scratch:
        others = children_before()
        record, log, work = (Path(scratch) / name for name in ("record.json", "log", "work"))
        words = map(str, (file, seed, folder, work, out / "output.txt", record))
        environment = {**environment_without_ros(), "ROS_HOME": scratch, "ROS_LOG_DIR": scratch}
        process = _start([sys.executable, "-c", TRIAL, *words], log, env=environment)
        for number, seconds in ((0, longest), (signal.SIGTERM, STOP_TIMEOUT)):
            process.send_signal(number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(seconds)
                break
        # Also what is left if the submission has killed the process that watches it.
        end_children(others)
        try:
            return Record(**json.loads(record.read_text()))
        except (OSError, ValueError):
            return Record(notes=[f"the run ended with status {process.poll()} before its end"])


def check_topics(exercise: Exercise, name: str) -> None:
    """Raise LabError if a criterion's messages or their field do not exist, or are no numbers."""
    for number, one in enumerate(exercise.criteria, 1):
        if not one.topic:
            continue
        try:
            value = get_message_class(one.type)()
            float(attrgetter(one.path)(value) if one.path else 0.0)
        except (AttributeError, TypeError, ValueError):
            what = f"field '{one.path}' of type '{one.type}': there is no such number"
            raise LabError(f"{name}: criterion {number}: {what}") from None


def _run(out: Path, settings: GradeSettings, tell: Tell) -> list[str]:
    base = Path(settings.base)
    file = find_exercise(settings.exercise, base).resolve()
    exercise = read_exercise(file)
    check_topics(exercise, file.name)
    if bool(settings.class_folder) == bool(settings.submission):
        raise LabError("submission or class is needed, one of the two: the folder to grade")
    given = settings.class_folder or settings.submission
    folder = ResourceFinder.anywhere().find(given if "://" in given else str(base / given))
    folders = [(folder, out)]
    if settings.class_folder:
        submissions = sorted(one for one in folder.glob("[!.]*") if one.is_dir())
        folders = [(one, out / one.name) for one in submissions]
    if not folders or not folder.is_dir():
        raise LabError(f"there are no submissions in '{given}'")
    grader, total = Grader(file, folders), len(folders)
    marks = [grader.kept(number) for number in range(total)]
    todo = [number for number, mark in enumerate(marks) if not mark]
    found = workers(settings.workers)(grader, todo)
    for number, mark in progress(found, "submissions", total, tell, total - len(todo)):
        if isinstance(mark, TaskLostError):
            lost = Record(notes=[f"it has killed its grader: {mark}"])
            mark = grade(folders[number][0].name, exercise, [lost])
        marks[number] = mark
    heads = ("submission", "points", "of")
    rows = [
        {**{head: mark[head] for head in heads}, "why": "; ".join(mark["why"])} for mark in marks
    ]
    with file_errors(f"cannot write {out / TABLE}"):
        write_table(out / TABLE, rows)
    write_json(out / SUMMARY, {"job": NAME, "exercise": file.stem, "submissions": total})
    line = "{submission}: {points:g} of {of:g}"
    return [line.format(**row) + (row["why"] and f"; {row['why']}") for row in rows]


main = functools.partial(run_from, NAME, __doc__, (GradeSettings,), _run)
