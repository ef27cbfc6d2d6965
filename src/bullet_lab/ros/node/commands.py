"""Commands of a node that must be able to stop its robot at any moment."""

from __future__ import annotations

import threading
from typing import Optional, Tuple

from geometry_msgs.msg import Twist

from bullet_lab.ros.node.publishers import Publisher


class StoppableSender:
    """Sends commands; a stop takes effect at once and voids those that were on their way.

    All methods may be called from any thread.
    """

    def __init__(self, publisher: Publisher):
        self._publisher = publisher
        self._lock = threading.RLock()
        self._stops = 0
        self._ended = False

    def ticket(self) -> int:
        """Return what `send` wants to see, from before the command was thought of."""
        return self._stops

    def send(self, command: Tuple[float, float], ticket: Optional[int] = None) -> None:
        """Send a command (m/s, rad/s), unless there was a stop after the ticket that is given."""
        with self._lock:
            if ticket in (None, self._stops) and not self._ended:
                self._publish(command)

    def stop(self) -> None:
        """Have the robot stand still."""
        with self._lock:
            self._stops += 1
            if not self._ended:
                self._publish((0.0, 0.0))

    def end(self) -> None:
        """Have the robot stand still, and send nothing ever after."""
        with self._lock:
            self.stop()
            self._ended = True

    def _publish(self, command: Tuple[float, float]) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = command
        self._publisher.publish(twist)
