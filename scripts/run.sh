#!/usr/bin/env bash
# Runs a job of the lab: scripts/run.sh <job> [name:=value …]
# Without a job it lists them; <job> --help lists a job's arguments.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

# Without a trap, bash forgets a SIGINT that comes to it alone while another program runs.
trap 'exit 130' INT
"$LAB_ROOT/scripts/setup.sh"
# Python answers a SIGINT before it runs a line of ours with a traceback, and status 1: that waits
# for the launcher. Whoever sources catkin's files runs Python, too.
# shellcheck disable=SC2016 # perl's, and the other bash's
exec perl -MPOSIX -e 'sigprocmask(SIG_BLOCK, POSIX::SigSet->new(SIGINT)); exec @ARGV' \
  bash -euo pipefail -c 'source "$0" && enter_lab && exec python -m bullet_lab.ros.launcher "$@"' \
  "$LAB_ROOT/scripts/environment.sh" "$@"
