#!/usr/bin/env bash
# Runs a job of the lab: scripts/run.sh <job> [name:=value …]
# Without a job it lists them; <job> --help lists a job's arguments.
set -euo pipefail
# First: without a trap, bash ignores a SIGINT that only bash gets, while another program runs.
trap 'exit 130' INT

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

# The first picture does not wait for what other jobs need.
least=()
[[ $* != squares ]] || least=(--least)
"$LAB_ROOT/scripts/setup.sh" "${least[@]}"
# A SIGINT that comes between bash's last look for traps and `exec` would be lost.
trap - INT
# While Python starts, it answers a SIGINT with a traceback and status 1, so SIGINT is blocked until
# the launcher runs. catkin's setup files start Python, too.
# shellcheck disable=SC2016 # expanded by perl and the other bash
exec perl -MPOSIX -e 'sigprocmask(SIG_BLOCK, POSIX::SigSet->new(SIGINT)); exec @ARGV' \
  bash -euo pipefail -c 'source "$0" && enter_lab && exec python -m bullet_lab.ros.launcher "$@"' \
  "$LAB_ROOT/scripts/environment.sh" "$@"
