#!/usr/bin/env bash
# Checks the sources: scripts/lint.sh [check …]; by default all checks. Status 0 if all pass.
set -euo pipefail

# shellcheck source=scripts/environment.sh
source "$(dirname "${BASH_SOURCE[0]}")/environment.sh"

CHECKS=(ruff shellcheck catkin_lint xml sdf launch)

# Also without git, whose list of ignored files ruff uses.
check_ruff() { python -m ruff check --quiet --output-format concise --extend-exclude build,results .; }

check_shellcheck() { shellcheck --external-sources scripts/*.sh test/clients/*.sh .ci/run; }

check_catkin_lint() { catkin_lint --offline --quiet --strict .; }

# All hand-written XML must be well-formed.
check_xml() {
  local files
  mapfile -t files < <(find package.xml launch urdf worlds models meshes test -type f \
    '(' -name '*.xml' -o -name '*.launch' -o -name '*.test' -o -name '*.urdf' \
    -o -name '*.world' -o -name '*.sdf' -o -name '*.config' -o -name '*.dae' ')')
  python - "${files[@]}" <<'PYTHON'
import sys
from xml.parsers.expat import ExpatError

import defusedxml.minidom
from defusedxml import DefusedXmlException

problems = 0
for path in sys.argv[1:]:
    try:
        defusedxml.minidom.parse(path)
    except (ExpatError, DefusedXmlException) as error:
        print(f"{path}: {error}")
        problems += 1
sys.exit(bool(problems))
PYTHON
}

# Worlds and models must follow SDFormat's schema. The XSD files in the package sdformat-sdf have
# errors, which its *.sdf files do not have: types.xsd is missing, <pose> has no content, models are
# declared twice, and <include> has no <pose>.
check_sdf() {
  local given=(/usr/share/sdformat*/1.6) schema=$LAB_DIR/sdformat
  # That of Debian 11 names files that it does not have; Debian 13 has none.
  if [[ ! -e ${given[-1]}/air_pressure.xsd ]]; then
    echo "lint sdf: skipped, this Debian has no whole schema of SDF"
    return
  fi
  rm -rf "$schema"
  cp -r "${given[-1]}" "$schema"
  cp test/schema/*.xsd "$schema"
  sed -i 's#http://sdformat.org/schemas/##' "$schema"/*.xsd
  sed -i "/name='include'/,/maxOccurs='unbounded'>/ s#\(<xsd:choice maxOccurs='unbounded'>\)#\1<xsd:element ref='pose'/>#" \
    "$schema/world.xsd"
  xmllint --nonet --noout --schema "$schema/root.xsd" worlds/*.world models/*/model.sdf
}

# All files and packages that a launch file names must exist and be dependencies.
check_launch() {
  # In one process, because roslaunch-check takes a second for each file.
  python - launch/*.launch test/rostest/*.test <<'PYTHON'
import sys

from roslaunch.rlutil import check_roslaunch

errors = [(path, check_roslaunch(path, use_test_depends=True)) for path in sys.argv[1:]]
wrong = [f"{path}: {error}" for path, error in errors if error]
sys.exit("\n".join(wrong) or 0)
PYTHON
}

run_check() {
  local name=$1 log=$LAB_DIR/log/lint-$1.log
  if "check_$name" >"$log" 2>&1; then
    echo "lint $name: passed"
    echo 1 0 >>"${LAB_TALLY:-/dev/null}"
  else
    cat "$log"
    echo "lint $name: FAILED"
    echo 0 1 >>"${LAB_TALLY:-/dev/null}"
    return 1
  fi
}

main() {
  local name failed=0
  "$LAB_ROOT/scripts/setup.sh" --with test
  enter_lab
  cd "$LAB_ROOT"
  for name in "${@:-${CHECKS[@]}}"; do
    if [[ " ${CHECKS[*]} " != *" $name "* ]]; then
      echo "lint: there is no check '$name'; checks: ${CHECKS[*]}" >&2
      exit 2
    fi
    run_check "$name" || failed=1
  done
  return "$failed"
}

main "$@"
