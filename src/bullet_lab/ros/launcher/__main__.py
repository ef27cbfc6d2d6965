"""python -m bullet_lab.ros.launcher <job> [name:=value ...]."""

import sys

from bullet_lab.ros.launcher.command import main

sys.exit(main(sys.argv[1:]))
