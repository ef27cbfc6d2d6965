"""Grades submissions to an exercise.

Each runs in the simulation, in processes of its own; a submission that fails is a mark, not an end.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

from roslib.message import get_message_class

from bullet_lab.core.files import file_errors, make_folder, write_json
from bullet_lab.core.parameters import text
from bullet_lab.errors import LabError
from bullet_lab.ros.grade.trial import SubmissionError, children_before, command_of, end_children
from bullet_lab.ros.launcher.output import environment_without_ros, temporary_folder, tied
from bullet_lab.simulation.world.resources import ResourceFinder
from bullet_lab.studies.grade import (
    AGAIN,
    GRADE,
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
# Wall seconds for start and end of the simulation, besides those of the exercise.
MARGIN = 120.0
STOP_TIMEOUT = 15.0


@dataclass(frozen=True)
class GradeSettings(WorkerSettings):
    """Parameters of the job."""

    exercise: str = text("", "name in config/exercises, or path of a .yaml")
    submission: str = text("", "folder with one submission")
    class_folder: str = text("", "folder with a folder for each submission, instead")
    base: str = text(".", "folder that paths are relative to")


@dataclass(frozen=True)
class Grader:
    """Grades submissions to the exercise in a file; `results` has a folder for each of them."""

    file: Path
    submissions: list[Path]
    results: list[Path]

    def kept(self, number: int) -> dict[str, Any]:
        """Return the mark from an earlier run with the same files; empty if there is none."""
        try:
            mark = json.loads((self.results[number] / GRADE).read_text())
            return mark if mark["files"] == self._digest(number) else {}
        except (OSError, ValueError, LookupError, TypeError):
            return {}

    def _digest(self, number: int) -> str:
        digest = hashlib.sha256(self.file.read_bytes())
        folder = self.submissions[number]
        for path in sorted(path for path in folder.rglob("*") if os.path.isfile(path)):
            with contextlib.suppress(OSError):
                name = f"{path.relative_to(folder)} {path.stat().st_mode} {path.stat().st_size}"
                digest.update(name.encode(errors="replace"))
                digest.update(path.read_bytes())
        return digest.hexdigest()

    def __call__(self, number: int) -> dict[str, Any]:
        """Run and grade a submission, write the files of its mark, and return the mark."""
        exercise, folder = read_exercise(self.file), self.submissions[number]
        out = make_folder(self.results[number])
        try:
            command_of(folder)
            seeds = range(exercise.seed, exercise.seed + exercise.runs)
            longest = exercise.wall_limit + MARGIN
            records = [_trial(self.file, seed, folder, out, longest) for seed in seeds]
        except (SubmissionError, OSError) as error:
            records = [Record(notes=[str(error)])]
        mark = grade(folder.name, exercise, records)
        is_slow = any(AGAIN in line for line in mark["why"])
        mark["files"] = "" if is_slow else self._digest(number)
        write_grade(out, mark, exercise, records)
        return mark


def _trial(file: Path, seed: int, folder: Path, out: Path, longest: float) -> Record:
    """Run a submission once, for some wall seconds at most, and return what was seen."""
    with temporary_folder() as scratch:
        others = children_before()
        record, log, work = (Path(scratch) / name for name in ("record.json", "log", "work"))
        words = map(str, (file, seed, folder, work, out / "output.txt", record))
        with log.open("wb") as output:
            process = subprocess.Popen(
                tied(sys.executable, "-m", "bullet_lab.ros.grade.trial", *words),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**environment_without_ros(), "ROS_HOME": scratch, "ROS_LOG_DIR": scratch},
            )
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
    submissions, results = [folder], [out]
    if settings.class_folder:
        submissions = sorted(one for one in folder.glob("[!.]*") if one.is_dir())
        results = [out / one.name for one in submissions]
    if not submissions or not folder.is_dir():
        raise LabError(f"there are no submissions in '{given}'")
    grader = Grader(file, submissions, results)
    marks = {number: grader.kept(number) for number in range(len(submissions))}
    todo = [number for number, mark in marks.items() if not mark]
    done, total = len(submissions) - len(todo), len(submissions)
    found = workers(settings.workers)(grader, todo)
    for number, mark in progress(found, "submissions", total, tell, done):
        if isinstance(mark, TaskLostError):
            lost = Record(notes=[f"it has killed its grader: {mark}"])
            mark = grade(submissions[number].name, exercise, [lost])
        marks[number] = mark
    heads = ("submission", "points", "of")
    rows = [
        {**{name: mark[name] for name in heads}, "why": "; ".join(mark["why"])}
        for mark in marks.values()
    ]
    with file_errors(f"cannot write {out / TABLE}"):
        write_table(out / TABLE, rows)
    write_json(out / SUMMARY, {"job": NAME, "exercise": file.stem, "submissions": total})
    line = "{submission}: {points:g} of {of:g}"
    return [line.format(**row) + (row["why"] and f"; {row['why']}") for row in rows]


main = functools.partial(run_from, NAME, __doc__, (GradeSettings,), _run)


if __name__ == "__main__":
    main()
