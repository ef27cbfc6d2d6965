#!/usr/bin/env bash
# Runs a job of the lab: scripts/run.sh <job> [name:=value …]
# Without a job it lists them; <job> --help lists a job's arguments.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

# Without a trap, bash forgets a SIGINT that comes to it alone while another program runs.
trap 'exit 130' INT
"$LAB_ROOT/scripts/setup.sh"
enter_lab
# Python answers a SIGINT with status 1 before it runs a line of ours: it waits until then.
# shellcheck disable=SC2016 # perl's
exec perl -MPOSIX -e 'sigprocmask(SIG_BLOCK, POSIX::SigSet->new(SIGINT)); exec @ARGV' \
  python -m bullet_lab.ros.launcher "$@"
