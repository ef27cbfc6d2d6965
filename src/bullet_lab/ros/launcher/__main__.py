"""python -m bullet_lab.ros.launcher <job> [name:=value ...]."""

from bullet_lab.entry import run
from bullet_lab.ros.launcher.node_server import NodeServer

# It imports modules while the launcher does.
with NodeServer() as server:
    run("bullet_lab.ros.launcher.command", server)
