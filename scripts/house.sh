#!/usr/bin/env bash
# The size of the library, and what its users rely on:
# scripts/house.sh size [FOLDER]: tokens, lines and files by folder
# scripts/house.sh behaviour [--live] [--results DIR]: jobs, parameters, types, rows … for a diff
# scripts/house.sh walk [twist|image]: the files that a message passes through
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

case ${1-} in
  size | behaviour | walk) ;;
  *)
    echo "usage: scripts/house.sh size [FOLDER] | behaviour [--live] [--results DIR] | walk [twist|image]" >&2
    exit 2
    ;;
esac
"$LAB_ROOT/scripts/setup.sh" --with test
enter_lab
exec python "$LAB_ROOT/test/house/$1.py" "${@:2}"
