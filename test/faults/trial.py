"""A trial: one job with one fault, and the checks afterwards."""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import uuid
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import rosgraph.names
import roslaunch.config
from kinds import (
    KINDS,
    LAUNCHER,
    NODE,
    PACKAGE,
    STOPPED_SECONDS,
    TERMINAL,
    WORKER,
    arguments_of,
    is_live,
)
from PIL import Image

sys.path.append(str(PACKAGE / "test" / "rostest"))
from lab_testing import Master, command_of, processes_with  # noqa: E402

# Environment variable that marks all processes of a trial.
MARK = "BULLET_LAB_FAULT"
# Wall seconds for a job to end.
PATIENCE = 600.0
# Wall seconds for the processes of a job to end after it.
GRACE = 30.0
# Wall seconds between two polls.
POLL = 0.0005
# Size of the disk that is filled.
DISK = "64m"
# Bytes that a process may write to a file, if this is not root and mounts no disk.
FILE_LIMIT = 4096
# A job with a live fault runs at 10 times real time, so that the fault comes in time.
SLOWLY = "rtf:=10"
# Nodes that write recordings begin with these names, and recordings end with these suffixes.
RECORDERS = ("plot_", "try_robot")
RECORDED = (".csv", ".tum", ".jsonl")
# A recording may lose a share and some lines when it is cut at its announced end.
KEPT = 0.8
CUT = 5


@dataclass
class Outcome:
    """The outcome of a trial: did the fault come in time, how the job ended, and what is wrong."""

    struck: bool = False
    victim: str = ""
    status: int = None
    seconds: float = 0.0
    wrong: list = field(default_factory=list)


class Trial:
    """Runs a job in a new folder, and injects the fault."""

    def __init__(self, fault, folder):
        self._fault, self._folder = fault, folder
        self._kind = KINDS[fault.kind]
        self._out, self._temporary = folder / "out", folder / "tmp"
        self._mark = uuid.uuid4().hex
        self._outcome = Outcome()
        self._before = {}
        self._was_done = False
        self._words = arguments_of(fault.job)
        if self._kind.live:
            self._words = [word for word in self._words if not word.startswith("rtf")] + [SLOWLY]

    def run(self):
        """Run the job, inject the fault, and check the results."""
        for path in (self._out, self._temporary):
            path.mkdir(parents=True)
        start = time.monotonic()
        with contextlib.ExitStack() as stack:
            if self._fault.kind == "disk_full" and not os.geteuid():
                stack.enter_context(_small_disk(self._out))
            self._start(stack)
            stack.callback(self._end_all)
            self._outcome.struck = self._inject()
            self._wait()
            self._judge()
            if self._outcome.wrong and self._fault.kind == "disk_full":
                ignored = shutil.ignore_patterns("filler")
                shutil.copytree(self._out, self._folder / "disk", ignore=ignored)
        self._outcome.seconds = round(time.monotonic() - start, 1)
        return self._outcome

    def _start(self, stack):
        environment = {k: v for k, v in os.environ.items() if not k.startswith("ROS_")}
        environment.update({MARK: self._mark, "TMPDIR": str(self._temporary)})
        if self._fault.kind.startswith("master"):
            self._master = Master()
            stack.callback(self._master.end)
            environment.update({"ROS_MASTER_URI": self._master.uri, "ROS_IP": "127.0.0.1"})
        out, err = (
            stack.enter_context((self._folder / name).open("w")) for name in ("stdout", "stderr")
        )
        self._job = subprocess.Popen(
            [str(PACKAGE / "scripts" / "run.sh"), self._fault.job, "out:=out", *self._words],
            cwd=self._folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,
        )

    # The faults

    def _inject(self):
        """Inject the fault; return whether the job was still running."""
        if self._kind.targets:
            return self._send_signal()
        if self._kind.live:
            return self._meddle()
        time.sleep(self._fault.moment)
        self._record_state()
        if not self._runs():
            return False
        if self._fault.kind == "disk_full":
            self._fill_the_disk()
        else:
            self._master.end()
            if self._fault.kind == "master_back":
                time.sleep(2.0 * self._fault.choice)
                self._master.start()
        return True

    def _send_signal(self):
        victim = self._await(self._find_target)
        if victim is None:
            return False
        time.sleep(self._fault.moment)
        self._record_state()
        if self._fault.target == WORKER:
            # The first worker may have finished.
            victim = self._find_target() or victim
        return self._signal(victim)

    def _signal(self, victim):
        number = self._kind.signal
        with contextlib.suppress(psutil.NoSuchProcess, ProcessLookupError):
            if victim.status() == psutil.STATUS_ZOMBIE:
                return False
            if self._fault.target == TERMINAL:
                os.killpg(victim.pid, number)
                return True
            victim.send_signal(number)
            if number == signal.SIGSTOP:
                time.sleep(STOPPED_SECONDS)
                victim.send_signal(signal.SIGCONT)
            return True
        return False

    def _find_target(self):
        if self._fault.target in (LAUNCHER, TERMINAL):
            return psutil.Process(self._job.pid)
        if self._fault.target == WORKER:
            workers = [one for one in self._processes() if "spawn_main" in command_of(one)]
            return workers[int(self._fault.choice * len(workers))] if workers else None
        nodes = _nodes_of(self._fault.job, self._words)
        self._outcome.victim = nodes[int(self._fault.choice * len(nodes))]
        return self._node(self._outcome.victim)

    def _node(self, name):
        # roslaunch adds a number to the name of the log.
        log = re.compile(rf"__log:=\S*/{name.strip('/').replace('/', '-')}-\d+\.log")
        return next((one for one in self._processes() if log.search(command_of(one))), None)

    def _meddle(self):
        uri = self._await(self._master_uri)
        if uri is None:
            return False
        name = self._fault.kind.split("_")[0]
        words = [name, str(STOPPED_SECONDS)] if name == "clock" else [name]
        with (self._folder / "meddle").open("w") as err:
            helper = subprocess.Popen(
                [sys.executable, str(Path(__file__).with_name("meddle.py")), *words],
                env={**os.environ, "ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1"},
                cwd=self._folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=err,
                text=True,
            )
        try:
            return self._meddle_by(helper)
        finally:
            helper.kill()
            helper.wait()

    def _meddle_by(self, helper):
        # Its first line; none if the job ends before.
        os.set_blocking(helper.stdout.fileno(), False)
        line = self._await(lambda: helper.stdout.readline() or None)
        os.set_blocking(helper.stdout.fileno(), True)
        if line is None:
            return False
        self._record_state()
        if self._fault.kind == "deaf":
            helper.send_signal(signal.SIGSTOP)
            time.sleep(STOPPED_SECONDS)
            return True
        if self._fault.kind == "clock":
            helper.wait()
            return True
        time.sleep(min(self._fault.moment, 1.0))
        self._outcome.victim = line.strip()
        driver = self._node(self._outcome.victim)
        if driver is None or not self._signal(driver):
            return False
        with contextlib.suppress(psutil.TimeoutExpired):
            driver.wait(PATIENCE)
        commands, _ = helper.communicate(timeout=PATIENCE)
        for topic, command in json.loads(commands or "{}").items():
            if any(command):
                self._wrong(f"the last command on {topic} was {command}")
        return True

    def _fill_the_disk(self):
        if os.geteuid():
            for one in self._processes():
                with contextlib.suppress(psutil.Error, PermissionError):
                    one.rlimit(psutil.RLIMIT_FSIZE, (FILE_LIMIT, FILE_LIMIT))
            return
        with contextlib.suppress(OSError), (self._out / "filler").open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))

    # State

    def _await(self, find):
        """Poll until something is found, and return it; None if the job ends before."""
        while self._runs():
            found = find()
            if found is not None:
                return found
            time.sleep(POLL)
        return None

    def _runs(self):
        return self._job.poll() is None

    def _master_uri(self):
        uri = re.search(r"master (http://\S+)", self._output("stdout"))
        return uri and uri[1]

    def _output(self, stream):
        return (self._folder / stream).read_text(errors="replace")

    def _processes(self):
        """Return the running processes of this trial."""
        return processes_with(f"{MARK}={self._mark}")

    def _record_state(self):
        """Record the state before the fault: whether all was done, and the lines of recordings."""
        self._was_done = (self._out / "summary.json").is_file()
        found = [path for path in self._out.rglob("*") if path.suffix in RECORDED]
        # Partial results are in hidden files and folders.
        shown = [path for path in found if "/." not in str(path.relative_to(self._folder))]
        self._before = {path: _lines(path) for path in shown}

    # The end

    def _wait(self):
        """Wait for the end of the job and of all its processes."""
        try:
            self._outcome.status = self._job.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._wrong(f"no end after {PATIENCE:g} s")
        else:
            deadline = time.monotonic() + GRACE
            while self._processes() and time.monotonic() < deadline:
                time.sleep(0.05)
            for one in self._processes():
                self._wrong(f"left running: {command_of(one)[:200]}")
        lines = [f"{one.pid} {command_of(one)}\n" for one in self._processes()]
        if lines:
            (self._folder / "processes").write_text("".join(lines))

    def _end_all(self):
        for one in self._processes():
            with contextlib.suppress(psutil.Error):
                one.kill()
        self._job.wait()

    def _wrong(self, what):
        self._outcome.wrong.append(what)

    # Checks

    def _judge(self):
        status, err = self._outcome.status, self._output("stderr")
        if status is None:
            return
        if status not in self._expected():
            self._wrong(f"status {status}")
        for stream in ("stdout", "stderr"):
            if "Traceback" in self._output(stream):
                self._wrong(f"a traceback on {stream}")
        ours = (f"{self._fault.job}: ", "run.sh: ", "setup: ")
        said = any(line.startswith(ours) for line in err.splitlines())
        if status > 0 and status not in (130, 143) and not said:
            self._wrong(f"status {status} without a line with the reason")
        self._judge_leftovers()
        self._judge_results()

    def _expected(self):
        """Return the right statuses; 0 only if the job has finished its work."""
        kind, at_launcher = self._fault.kind, self._fault.target in (LAUNCHER, TERMINAL)
        done = f"{self._fault.job}: done" in self._output("stdout")
        asked_to_end = self._outcome.struck and at_launcher and kind != "stop"
        right = {0} if done and (self._was_done or not asked_to_end) else set()
        if not self._outcome.struck:
            return right
        if kind == "int" and at_launcher:
            # Before run.sh has set its trap, it dies of the signal as any shell.
            return right | {130} | (set() if self._output("stdout") else {-signal.SIGINT})
        if kind in ("kill", "term") and at_launcher:
            return right | {-self._kind.signal, 128 + self._kind.signal} - {128 + signal.SIGKILL}
        if kind == "kill" and self._fault.target == NODE:
            return right | {128 + signal.SIGKILL}
        if kind in ("int", "term", "rest_int", "rest_term") and self._fault.target != WORKER:
            return right | {1, 130, 143}
        if kind.startswith("master"):
            return right | {1}
        return right | {1, 2} if kind == "disk_full" else right

    def _judge_leftovers(self):
        left = [path.name for path in self._temporary.iterdir()]
        if left:
            self._wrong(f"left in the temporary folder: {', '.join(left)}")
        parts = [str(path.relative_to(self._out)) for path in self._out.rglob(".*")]
        if parts:
            self._wrong(f"left among the results: {', '.join(parts)}")

    def _judge_results(self):
        killed = self._outcome.victim.rpartition("/")[2] if self._fault.kind == "kill" else ""
        for path, lines in self._before.items():
            kept = _lines(path)
            if kept < KEPT * lines - CUT:
                self._wrong(f"{path.name}: {kept} lines of {lines} kept")
        full = self._fault.kind == "disk_full"
        recording = is_live(self._fault.job) and any(n > 1 for n in self._before.values())
        excused = full or killed.startswith(RECORDERS)
        if recording and not excused and not (self._out / "summary.json").is_file():
            self._wrong("no summary of the recording")
        if killed != "record" and not full and list(self._out.rglob("*.active")):
            self._wrong("the bag was not closed")
        for path in self._out.rglob("*"):
            try:
                if path.suffix == ".json":
                    json.loads(path.read_text())
                elif path.suffix == ".png":
                    with Image.open(path) as picture:
                        picture.verify()
            except (ValueError, OSError, SyntaxError) as error:
                self._wrong(f"{path.name} is not complete: {error}")


def _nodes_of(job, words):
    """Return the names of a job's nodes in the order of their start."""
    path = str(PACKAGE / "launch" / f"{job}.launch")
    config = roslaunch.config.load_config_default([(path, list(words))], None, verbose=False)
    return [rosgraph.names.ns_join(node.namespace, node.name) for node in config.nodes]


def _lines(path):
    with contextlib.suppress(OSError):
        return path.read_bytes().count(b"\n")
    return 0


@contextlib.contextmanager
def _small_disk(folder):
    """Mount a small file system on a folder; needs root."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(folder)], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
