"""The PyBullet client that draws: a session of its own, apart from the physics.

What is loaded here is never stepped. So simulations without a camera pay nothing for one, and
the pictures may be lit, coloured and cut up as drawing wants it.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import os
import shutil
import tempfile
import threading
from pathlib import Path
from typing import IO, Callable, Dict, Optional, Tuple

import numpy as np

from bullet_lab.simulation.engine import pybullet
from bullet_lab.simulation.native_output import hidden_native_output, native_output_to
from bullet_lab.simulation.pose import Pose
from bullet_lab.simulation.rendering.choice import EGL, RendererError

Matrix = Tuple[float, ...]

IDENTITY = tuple(np.eye(4).ravel())
PLUGIN = "eglRenderer"
# EGL's frame buffer has this size, whatever is asked for: larger images come out wrong.
EGL_BUFFER = (1024, 768)
# EGL draws a shadow map of 4096 x 4096 pixels for its light. Where it has to, the light is so far
# away that nothing lies within the map: no shadows, and some of the time of a frame is saved.
EGL_LIGHT = (0.0, 0.0, 1e5)


class RenderEngine:
    """Bodies to look at, and the pictures of them.

    One thread may use it: EGL ends the process if another one draws.
    """

    def __init__(self, renderer: str):
        """Open a session for "egl" or "tiny"; raises RendererError."""
        self.renderer = renderer
        self.owner: Optional[object] = None
        self.folder = Path(tempfile.mkdtemp(prefix="bullet_lab_drawn_"))
        self.client = pybullet.connect(pybullet.DIRECT)
        self._thread = threading.get_ident()
        if renderer == EGL:
            try:
                with open(os.devnull, "wb") as sink:
                    load_egl(self.client, sink)
            except RendererError:
                self.close()
                raise
        self._drawn = 0
        self._flags = pybullet.ER_NO_SEGMENTATION_MASK
        self._kind = (
            pybullet.ER_BULLET_HARDWARE_OPENGL if renderer == EGL else pybullet.ER_TINY_RENDERER
        )

    def close(self) -> None:
        """Give everything back."""
        if self.client >= 0:
            with hidden_native_output(), contextlib.suppress(pybullet.error):
                pybullet.disconnect(self.client)
            self.client = -1
        shutil.rmtree(self.folder, ignore_errors=True)

    def write(self, name: str, data: bytes) -> Path:
        """Return a file of the engine's folder; a name always stands for the same content."""
        path = self.folder / name
        if not path.exists():
            path.write_bytes(data)
        return path

    def load(self, urdf: Path) -> int:
        """Load a body that is only looked at and return its id."""
        # Textures are told apart by the address of their pixels: without the cache, a second
        # texture at the address of a freed one comes out as the first.
        pybullet.setPhysicsEngineParameter(enableFileCaching=1, physicsClientId=self.client)
        try:
            with hidden_native_output():
                return pybullet.loadURDF(str(urdf), useFixedBase=True, physicsClientId=self.client)
        except pybullet.error as error:
            raise RendererError(f"PyBullet cannot load {urdf.name}: {error}") from error
        finally:
            pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=self.client)

    def place(self, body: int, pose: Pose) -> None:
        """Put a body somewhere."""
        pybullet.resetBasePositionAndOrientation(body, pose.position, pose.quaternion, self.client)

    def remove(self, body: int) -> None:
        """Take a body out."""
        pybullet.removeBody(body, self.client)

    def draw(
        self,
        width: int,
        height: int,
        view: Matrix,
        lens: Matrix,
        texture_map: Optional[Matrix] = None,
    ) -> Tuple[np.ndarray, np.ndarray]:
        """Draw what there is.

        Args:
            width: in pixels; EGL draws up to `EGL_BUFFER`.
            height: in pixels.
            view: OpenGL's view matrix, by columns.
            lens: OpenGL's projection matrix, by columns.
            texture_map: with EGL, from places in the world to places in all pictures, by
                columns; that is fast, since EGL then makes no shadow map.

        Returns:
            (height, width, 4) uint8 RGBA, and (height, width) depth in OpenGL's [0, 1] with 1
            where nothing is.

        Raises:
            RendererError: another thread than the one that made the engine asks.
        """
        if threading.get_ident() != self._thread:
            raise RendererError("images are drawn by the thread that drew the first one")
        flags, extra = self._flags, {}
        if texture_map is not None:
            flags |= pybullet.ER_USE_PROJECTIVE_TEXTURE
            extra = {"projectiveTextureView": texture_map, "projectiveTextureProj": IDENTITY}
        # The driver says its name with the first two pictures.
        self._drawn += 1
        with contextlib.nullcontext() if self._drawn > 2 else hidden_native_output():
            _, _, pixels, depth, _ = pybullet.getCameraImage(
                width,
                height,
                view,
                lens,
                lightDirection=EGL_LIGHT,
                lightAmbientCoeff=1.0,
                lightDiffuseCoeff=0.0,
                lightSpecularCoeff=0.0,
                shadow=0,
                renderer=self._kind,
                flags=flags,
                physicsClientId=self.client,
                **extra,
            )
        pixels = np.asarray(pixels, dtype=np.uint8).reshape(height, width, 4)
        return pixels, np.asarray(depth, dtype=np.float32).reshape(height, width)


def load_egl(client: int, log: IO) -> None:
    """Load PyBullet's EGL plugin; what the driver says goes to a file.

    Raises:
        RendererError: there is no plugin, or it refuses.
    """
    found = importlib.util.find_spec(PLUGIN)
    if found is None or not found.origin:
        raise RendererError("PyBullet was built without its EGL plugin")
    with native_output_to(log):
        plugin = pybullet.loadPlugin(found.origin, f"_{PLUGIN}Plugin", physicsClientId=client)
    if plugin < 0:
        raise RendererError("PyBullet's EGL plugin cannot be loaded")


class _Engines:
    """The engines of this process: one for each renderer and thread, made when first wanted.

    EGL knows one window per process, and one that is opened anew costs memory for good; so
    simulations share it. See `Scene` for how they take turns.
    """

    def __init__(self):
        self._made: Dict[Tuple[str, threading.Thread], RenderEngine] = {}
        self._process = os.getpid()

    def get(self, renderer: str) -> RenderEngine:
        self._check_process()
        key = (renderer, threading.current_thread())
        if key not in self._made:
            self._close(lambda thread: not thread.is_alive())
            if renderer == EGL and any(kind == EGL for kind, _ in self._made):
                raise RendererError("another thread of this process draws with EGL already")
            self._made[key] = RenderEngine(renderer)
        return self._made[key]

    def close(self) -> None:
        if os.getpid() == self._process:
            self._close(lambda thread: True)

    def _close(self, chosen: Callable[[threading.Thread], bool]) -> None:
        for key in [key for key in self._made if chosen(key[1])]:
            self._made.pop(key).close()

    def _check_process(self) -> None:
        """Start anew in a forked process, which has none of the driver's threads."""
        if os.getpid() == self._process:
            return
        if any(kind == EGL for kind, _ in self._made):
            raise RendererError("EGL was loaded before this process was forked from its parent")
        self._made.clear()
        self._process = os.getpid()


_ENGINES = _Engines()
atexit.register(_ENGINES.close)


def shared_engine(renderer: str) -> RenderEngine:
    """Return this thread's engine for a renderer; raises RendererError."""
    return _ENGINES.get(renderer)
