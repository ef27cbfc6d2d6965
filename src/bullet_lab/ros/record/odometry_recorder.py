"""Records the perfect and the noisy odometry of one robot as files."""

from __future__ import annotations

from pathlib import Path
from typing import Callable, Optional

import rospy
from nav_msgs.msg import Odometry

from bullet_lab.core.files import FileError, make_folder, move_file
from bullet_lab.reports.squares import PathsRecording, RecordingError
from bullet_lab.ros.node.node import Refusals
from bullet_lab.ros.node.odometry import FrameGuard, OdometryError, planar_pose

PERFECT, NOISY = "odom", "noisy_odom"
# Where the messages of each topic go.
FILES = {PERFECT: PathsRecording.PERFECT, NOISY: PathsRecording.NOISY}


class OdometryRecorder:
    """Takes messages one by one; refuses those that cannot be, and begins anew where time does.

    What was recorded before time was set back is moved to a folder run_1, run_2 and so on.

    Attributes:
        paths: what has been recorded since then.

    Args:
        folder: where the files go; made if need be.
        refusals: counts what is refused.
        begins_anew: called when time was set back.

    Raises:
        FileError: the folder or a file in it cannot be written.
    """

    def __init__(
        self, folder: Path, refusals: Refusals, begins_anew: Callable[[], None] = lambda: None
    ):
        self.paths = PathsRecording(folder)
        self._folder = folder
        self._refusals = refusals
        self._begins_anew = begins_anew
        self._guards = {topic: FrameGuard() for topic in FILES}
        self._runs = 0
        self._left_behind: Optional[str] = None
        self._left_at: Optional[int] = None
        self._failure: Optional[FileError] = None

    def last(self) -> Optional[int]:
        """Return the stamp in ns that both odometries have come to; None before that.

        Raises:
            FileError: what came could not be written.
        """
        if self._failure is not None:
            raise self._failure
        stamps = [self.paths.last(name) for name in FILES.values()]
        return None if None in stamps else min(stamps)

    def record(self, topic: str, msg: Odometry, name: str = "") -> bool:
        """Record a message of PERFECT or NOISY; return whether it was.

        Args:
            topic: which of the two.
            msg: the message.
            name: of the topic in reports; as above if empty.
        """
        if self._failure is not None:
            return False
        try:
            pose = planar_pose(msg)
            self._guards[topic].check(msg)
            stamp = msg.header.stamp.to_nsec()
            if not self._belongs_to_this_run(topic, stamp):
                return False
            if topic == PERFECT:
                self.paths.add_perfect(stamp, pose)
            else:
                self.paths.add_noisy(stamp, pose)
        except (OdometryError, RecordingError) as error:
            self._refusals.refuse(name or topic, str(error))
            return False
        except FileError as error:
            self._failure = error
            return False
        return True

    def _belongs_to_this_run(self, topic: str, stamp: int) -> bool:
        """Begin a new run where time was set back; drop what the old run still sends after."""
        last = self.paths.last(FILES[topic])
        if self._left_behind == topic:
            if self._left_at is not None and stamp > self._left_at:
                return False
            self._left_behind = None
        elif last is not None and stamp < last:
            other = NOISY if topic == PERFECT else PERFECT
            # Its messages of the old run may come yet, all of them later than its last one.
            self._left_behind, self._left_at = other, self.paths.last(FILES[other])
            self._begin_new_run()
        return True

    def _begin_new_run(self) -> None:
        self.paths.finish()
        self._runs += 1
        old = make_folder(self._folder / f"run_{self._runs}")
        for name in (*FILES.values(), PathsRecording.PAIRS):
            move_file(self._folder / name, old)
        rospy.loginfo("time was set back: what was recorded before is in %s", old)
        self.paths = PathsRecording(self._folder)
        self._begins_anew()
