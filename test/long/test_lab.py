"""The guided lab as a student follows it: its commands run, and give the pictures on its page."""

import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from programs import printed

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "rostest"))
from lab_testing import PACKAGE, wait_for  # noqa: E402
from view_looker import Looker, wait_for_url  # noqa: E402

PAGE = PACKAGE / "docs" / "lab.md"
PART = re.compile(r"```bash\n(.*?)```|!\[[^\]]*\]\(([^ )]+)(?: \"([^\"]+)\")?\)", re.DOTALL)
SECONDS = 900.0
# Grey levels by which a picture that is made anew may differ, in the mean, from the page's: as
# much as other fonts make. And across, in pixels, what is compared.
ALIKE, ACROSS = 4.0, 200


def steps():
    """Return the blocks of commands, each with the pictures after it: here, and where they lie."""
    found = []
    for block, picture, result in PART.findall(PAGE.read_text()):
        if block:
            lines = block.replace("\\\n", " ").splitlines()
            found.append(([line for line in lines if shlex.split(line, comments=True)], []))
        elif result:
            found[-1][1].append((PAGE.parent / picture, result))
    return found


STEPS = steps()
assert len(STEPS) >= 8


@pytest.mark.parametrize(("commands", "pictures"), STEPS, ids=[s[0][0] for s in STEPS])
def test_what_the_page_says_works(commands, pictures, tmp_path):
    (tmp_path / "scripts").symlink_to(PACKAGE / "scripts")
    for command in commands:
        if "view:=browser" in command:
            look(command, tmp_path)
        else:
            assert "Traceback" not in printed("/bin/bash", "-c", command, cwd=tmp_path)
    for picture, result in pictures:
        assert picture.stat().st_size < 1e6
        assert difference(picture, tmp_path / result) < ALIKE, result


def look(command, folder):
    """Run a command that waits for somebody who opens its page, until it has its results."""
    log = folder / "printed"
    with log.open("w") as out:
        process = subprocess.Popen(
            ["bash", "-c", f"exec {command}"],
            cwd=folder,
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        looker = Looker(wait_for_url(log.read_text))
        wait_for(lambda: "the page stays until" in log.read_text(), log.read_text, SECONDS)
        wait_for(lambda: "/robots/0" in looker.nodes, "the robot to be seen")
        looker.close()
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT)
        process.wait(60.0)
    assert process.returncode == 0, log.read_text()


def difference(one, other):
    """Return by how many grey levels two pictures differ, in the mean; at most 255."""
    pictures = [Image.open(path).convert("L") for path in (one, other)]
    shapes = [picture.height / picture.width for picture in pictures]
    if abs(shapes[0] - shapes[1]) > 0.02 * shapes[0]:
        return 255.0
    size = (ACROSS, round(ACROSS * shapes[0]))
    first, second = (np.asarray(p.resize(size, Image.BOX), np.float64) for p in pictures)
    return float(np.abs(first - second).mean())
