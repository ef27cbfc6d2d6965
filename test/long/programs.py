"""Programs as the long tests run them."""

import subprocess
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2]
# Wall seconds.
LONGEST = 1800.0


def printed(program, *words, statuses=(0,), **options):
    """Return what a program prints, of the package if its path is not absolute, at its end.

    Its status has to be one of some; options are those of `subprocess.run`.
    """
    done = subprocess.run(
        [str(PACKAGE / program), *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LONGEST,
        **options,
    )
    assert done.returncode in statuses, done.stdout
    return done.stdout
