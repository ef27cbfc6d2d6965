import logging
import os
import subprocess
import sys
import threading

import pytest
from picture_worlds import CAMERA, simulation_of, usable

from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.rendering import choice
from bullet_lab.simulation.rendering.choice import (
    VARIABLE,
    RendererError,
    choose_renderer,
    probe_egl,
)
from bullet_lab.simulation.rendering.engine import shared_engine
from bullet_lab.simulation.rendering.frame import Shot
from bullet_lab.simulation.simulation import Simulation


@pytest.fixture(autouse=True)
def nothing_said(monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)


@pytest.fixture
def probe(monkeypatch):
    """Set what the probe finds."""

    def set_probe(*found):
        monkeypatch.setattr(choice, "probe_egl", lambda: found)
        choice._note.cache_clear()

    return set_probe


def test_auto_is_egl_where_it_works(probe, caplog):
    caplog.set_level(logging.INFO)
    probe(True, "some driver")
    assert choose_renderer() == "egl"
    assert "images are drawn with EGL (some driver)" in caplog.text


def test_auto_is_tiny_where_egl_does_not_work(probe, caplog):
    caplog.set_level(logging.INFO)
    probe(False, "no driver")
    assert choose_renderer("auto") == "tiny"
    assert "TinyRenderer (EGL does not work here: no driver)" in caplog.text
    with pytest.raises(RendererError, match="EGL does not work here: no driver"):
        choose_renderer("egl")


def test_the_environment_decides_for_auto_only(probe, monkeypatch):
    probe(True, "some driver")
    monkeypatch.setenv(VARIABLE, "tiny")
    assert choose_renderer("auto") == "tiny"
    assert choose_renderer("egl") == "egl"
    monkeypatch.setenv(VARIABLE, "egl")
    probe(False, "nobody asks")
    assert choose_renderer("auto") == "egl"
    assert choose_renderer("tiny") == "tiny"


@pytest.mark.parametrize("said", ["", "auto"])
def test_the_environment_may_say_nothing(probe, monkeypatch, said):
    probe(True, "some driver")
    monkeypatch.setenv(VARIABLE, said)
    assert choose_renderer("auto") == "egl"


def test_unknown_words(monkeypatch):
    with pytest.raises(RendererError, match="renderer 'opengl': it must be one of auto, egl, tiny"):
        choose_renderer("opengl")
    monkeypatch.setenv(VARIABLE, "gpu")
    with pytest.raises(RendererError, match="'gpu'"):
        choose_renderer("auto")


def fake_probe(monkeypatch, body):
    """Have the probe run some Python."""
    run = subprocess.run
    code = [sys.executable, "-c", body]
    monkeypatch.setattr(subprocess, "run", lambda command, **kwds: run(code, **kwds))
    return probe_egl.__wrapped__()


def test_a_driver_that_kills_the_process(monkeypatch):
    works, reason = fake_probe(monkeypatch, "import os; os.kill(os.getpid(), 11)")
    assert not works
    assert reason == "the driver ended the probe with signal 11"


def test_a_driver_that_ends_the_process_with_a_word(monkeypatch):
    body = "import sys; print('eglInitialize() failed', file=sys.stderr); sys.exit(1)"
    assert fake_probe(monkeypatch, body) == (False, "eglInitialize() failed")


def test_a_driver_that_never_answers(monkeypatch):
    monkeypatch.setattr(choice, "PATIENCE", 0.5)
    assert fake_probe(monkeypatch, "import time; time.sleep(60)") == (
        False,
        "no answer within 0.5 s",
    )


def test_a_missing_driver(monkeypatch):
    if not probe_egl()[0]:
        pytest.skip("EGL does not work here anyway")
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_FILENAMES", os.devnull)
    monkeypatch.setenv("LIBGL_DRIVERS_PATH", os.devnull)
    works, reason = probe_egl.__wrapped__()
    assert not works
    assert reason


def test_nothing_is_loaded_before_the_first_picture(monkeypatch):
    monkeypatch.setattr(choice, "probe_egl", lambda: pytest.fail("asked"))
    with Simulation.of("package://bullet_lab/worlds/docking.world") as simulation:
        simulation.spawn("package://bullet_lab/urdf/camera_robot.urdf")
        simulation.run_for(0.1)


def test_egl_belongs_to_one_thread():
    usable("egl")
    shared_engine("egl")
    caught = []

    def draw():
        with simulation_of(renderer="egl") as simulation:
            try:
                simulation.photographer().take(Pose(), Shot(CAMERA))
            except RendererError as error:
                caught.append(str(error))

    thread = threading.Thread(target=draw)
    thread.start()
    thread.join()
    assert caught == ["another thread of this process draws with EGL already"]


def test_a_photographer_stays_in_its_thread():
    caught = []
    with simulation_of() as simulation:
        photographer = simulation.photographer()

        def draw():
            try:
                photographer.take(Pose(), Shot(CAMERA))
            except RendererError as error:
                caught.append(str(error))

        thread = threading.Thread(target=draw)
        thread.start()
        thread.join()
    assert caught == ["images are drawn by the thread that drew the first one"]


@pytest.mark.parametrize("renderer", ["egl", "tiny"])
def test_the_driver_prints_nothing(renderer):
    usable(renderer)
    code = (
        "from bullet_lab.simulation.view import View, take_picture\n"
        "from bullet_lab.simulation.simulation import Simulation\n"
        "with Simulation() as s:\n"
        "  for _ in range(3):\n"
        f"    take_picture(s, View((0, 0, 1), (1, 0, 1), 32, 24), '{renderer}')\n"
    )
    path = os.pathsep.join(filter(None, sys.path))
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=dict(os.environ, PYTHONPATH=path),
        capture_output=True,
        check=True,
    )
    assert done.stdout + done.stderr == b""
