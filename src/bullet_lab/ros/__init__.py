"""ROS adapters: one module per node, parameters, conversions and the launcher of jobs."""

import threading

# Debian 11's rospy calls by its old name what Python 3.9 has renamed.
if not hasattr(threading.Thread, "isAlive"):
    threading.Thread.isAlive = threading.Thread.is_alive
