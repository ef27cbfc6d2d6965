#!/bin/bash
# Leaves a process behind, which has left the process group.
setsid sleep 98765 &
setsid bash -c 'trap "" TERM; sleep 98764; true' &
exit 0
