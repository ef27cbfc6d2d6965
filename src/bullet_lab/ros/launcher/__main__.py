"""python -m bullet_lab.ros.launcher <job> [name:=value ...]."""

from bullet_lab.entry import run

run("bullet_lab.ros.launcher.command")
