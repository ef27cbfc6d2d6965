"""Panda3D, headless: the one graphics engine of a process, and the buffers that it draws into.

It draws through EGL, without a screen and, where there is no GPU, in software (Mesa). What
Panda3D must be told before it starts, and what is particular about it, stands here.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import os
import threading
from collections import OrderedDict
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from bullet_lab.core.native_output import hidden_native_output
from bullet_lab.errors import LabError

PIPE = "p3headlessgl"
SETTINGS = """
window-type offscreen
audio-library-name null
notify-level error
notify-level-display fatal
# The caches of states and transforms would keep textures of models that are long gone.
state-cache 0
transform-cache 0
# Images keep their widths and heights; by default they are cut to powers of two.
textures-power-2 none
sync-video 0
"""
EGL_OPENGL_API = 0x30A2
# How many samples a pixel may have.
SAMPLES = (1, 2, 4)
# Buffers for pictures that are kept, for the sizes that were asked for last.
KEPT_BUFFERS = 8
KEPT_PROGRAMS = 64


NO_DRIVER = "pictures need EGL and a driver: on Debian, install libegl1 and libgl1-mesa-dri"


class RendererError(LabError):
    """Nothing can be drawn here, or not this picture."""


class Target:
    """A buffer to draw into, with the texture that the result is found in.

    Attributes:
        buffer: Panda3D's.
        texture: stays on the graphics side for shadow maps, is copied into memory otherwise.
        states: that its camera draws surfaces with, for whoever sets them to know.
        cameras: node paths, one for each tile of the buffer, row by row from the lower left.
    """

    def __init__(self, buffer: Any, texture: Any, tiles: Tuple[int, int] = (1, 1)):
        from panda3d.core import Camera, NodePath

        self.texture = texture
        self.states: Any = None
        self.cameras: List[Any] = []
        self.buffer = buffer
        columns, rows = tiles
        for tile in range(columns * rows):
            row, column = divmod(tile, columns)
            region = buffer.make_display_region(
                column / columns, (column + 1) / columns, row / rows, (row + 1) / rows
            )
            self.cameras.append(NodePath(Camera("camera")))
            region.set_camera(self.cameras[-1])
        buffer.set_active(False)

    def clear_with(self, colour: Sequence[float]) -> None:
        """Take the colour of what nothing is drawn on, RGB."""
        self.buffer.set_clear_color((*colour[:3], 1.0))

    def set_active(self, active: bool) -> None:
        """Draw into the buffer at the next frame, or not."""
        self.buffer.set_active(active)

    def pixels(self, kind: type, channels: int) -> np.ndarray:
        """Return what was drawn, (height, width, channels), in an array of its own."""
        data = np.frombuffer(self.texture.get_ram_image(), kind)
        shape = (self.texture.get_y_size(), self.texture.get_x_size(), channels)
        return data.reshape(shape).copy()


class Graphics:
    """Panda3D's engine with a graphics context; one for a process, see `shared_graphics`.

    Any thread may use it, one at a time: the context is let go after each use, since a driver draws
    nothing, and says nothing, for a thread while another one has it.

    Attributes:
        core: the module of Panda3D's classes.
        driver: what draws, as "llvmpipe (LLVM 15.0.6, 256 bits)".

    Raises:
        RendererError: Panda3D or a driver for EGL is missing.
    """

    def __init__(self):
        self._context_use = _ContextUse()
        self._kept: OrderedDict[tuple, Target] = OrderedDict()
        self._programs: OrderedDict[Tuple[str, str], Any] = OrderedDict()
        self.core = core = _panda3d()
        self._engine = core.GraphicsEngine.get_global_ptr()
        with hidden_native_output():
            selection = core.GraphicsPipeSelection.get_global_ptr()
            self._pipe = self._with_context(selection.make_module_pipe, PIPE)
            if self._pipe is None or not self._pipe.is_valid():
                raise RendererError(NO_DRIVER)
            self._context = None
            context = self._make("context", core.FrameBufferProperties(), (1, 1))
        if context is None or context.get_gsg() is None:
            raise RendererError(NO_DRIVER)
        context.set_active(False)
        self._context = context
        self.driver = context.get_gsg().get_driver_renderer()

    def picture_target(self, width: int, height: int, samples: int) -> Target:
        """Return the target for pictures of a size, RGB of 8 bits; raises RendererError."""
        properties = self.core.FrameBufferProperties()
        properties.set_rgba_bits(8, 8, 8, 0)
        properties.set_depth_bits(24)
        if samples > 1:
            properties.set_multisamples(samples)
        return self._keep(("picture", width, height, samples), properties)

    def depth_target(self, width: int, height: int) -> Target:
        """Return the target for one float32 for each pixel; raises RendererError."""
        properties = self.core.FrameBufferProperties()
        properties.set_float_color(True)
        properties.set_rgba_bits(32, 0, 0, 0)
        properties.set_depth_bits(32)
        properties.set_float_depth(True)
        return self._keep(("depth", width, height), properties)

    def shadow_target(self, size: int, tiles: Tuple[int, int]) -> Target:
        """Return a new target for square shadow maps with `size` pixels along each side.

        Args:
            size: of each map.
            tiles: columns and rows of maps.

        Raises:
            RendererError: there is no such buffer.
        """
        core = self.core
        properties = core.FrameBufferProperties()
        properties.set_depth_bits(24)
        texture = core.Texture("shadow")
        # Compared with the depth that is asked for, and the results interpolated.
        texture.set_minfilter(core.SamplerState.FT_shadow)
        texture.set_magfilter(core.SamplerState.FT_shadow)
        texture.set_wrap_u(core.SamplerState.WM_clamp)
        texture.set_wrap_v(core.SamplerState.WM_clamp)
        buffer = self._make("shadow", properties, (size * tiles[0], size * tiles[1]))
        self._attach(buffer, texture, core.GraphicsOutput.RTM_bind_or_copy, "RTP_depth")
        buffer.set_sort(-1)
        buffer.set_clear_depth_active(True)
        return Target(buffer, texture, tiles)

    def program(self, vertex: str, fragment: str) -> Any:
        """Return a shader from its two programs in GLSL; it is compiled once for all scenes."""
        key = (vertex, fragment)
        if key not in self._programs:
            while len(self._programs) >= KEPT_PROGRAMS:
                self._programs.popitem(last=False)
            self._programs[key] = self.core.Shader.make(self.core.Shader.SL_GLSL, *key)
        self._programs.move_to_end(key)
        return self._programs[key]

    def matrix(self, columns: np.ndarray) -> Any:
        """Return a (4, 4) matrix that multiplies columns as Panda3D has it."""
        return self.core.LMatrix4f(*columns.T.ravel().tolist())

    def draw(self, targets: Sequence[Target]) -> None:
        """Draw what the cameras of some targets see."""
        for target in targets:
            target.set_active(True)
        try:
            self._with_context(self._engine.render_frame)
        finally:
            for target in targets:
                target.set_active(False)

    def remove(self, target: Target) -> None:
        """Give a target's buffer back."""
        self._with_context(self._engine.remove_window, target.buffer)
        target.texture.release_all()

    def _keep(self, key: tuple, properties) -> Target:
        if key not in self._kept:
            core = self.core
            largest = self._context.get_gsg().get_max_texture_dimension()
            if max(key[1:3]) > largest:
                raise RendererError(f"{self.driver} draws up to {largest} pixels along each side")
            while len(self._kept) >= KEPT_BUFFERS:
                self.remove(self._kept.popitem(last=False)[1])
            texture = core.Texture(key[0])
            buffer = self._make(key[0], properties, key[1:3])
            self._attach(buffer, texture, core.GraphicsOutput.RTM_copy_ram, "RTP_color")
            buffer.set_clear_color_active(True)
            self._kept[key] = Target(buffer, texture)
        self._kept.move_to_end(key)
        return self._kept[key]

    def _attach(self, buffer, texture, mode, plane: str) -> None:
        if buffer is None:
            raise RendererError(f"{self.driver} has no buffer of this kind and size")
        buffer.add_render_texture(texture, mode, getattr(self.core.GraphicsOutput, plane))

    def _make(self, name: str, properties: Any, size: Tuple[int, int]) -> Any:
        core = self.core
        shared = () if self._context is None else (self._context.get_gsg(), self._context)
        return self._with_context(
            self._engine.make_output,
            self._pipe,
            name,
            0,
            properties,
            core.WindowProperties.size(*size),
            core.GraphicsPipe.BF_refuse_window,
            *shared,
        )

    def _with_context(self, call: Callable[..., Any], *arguments: Any) -> Any:
        try:
            with self._context_use:
                return call(*arguments)
        except AssertionError as error:
            # What Panda3D raises where one of its own conditions does not hold.
            raise RendererError(f"Panda3D gives up: {error}") from error


class _ContextUse:
    """Lets a thread have the graphics context for as long as it is needed.

    Raises:
        RendererError: there is no EGL on this machine.
    """

    def __init__(self):
        try:
            self._egl = ctypes.CDLL("libEGL.so.1")
        except OSError as error:
            raise RendererError(NO_DRIVER) from error
        self._egl.eglGetCurrentDisplay.restype = ctypes.c_void_p
        self._egl.eglMakeCurrent.argtypes = [ctypes.c_void_p] * 4
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        self._lock.acquire()
        # Of each thread for itself; its default is OpenGL ES.
        self._egl.eglBindAPI(EGL_OPENGL_API)

    def __exit__(self, *_) -> None:
        display = self._egl.eglGetCurrentDisplay()
        if display:
            self._egl.eglMakeCurrent(display, None, None, None)
        self._lock.release()


@functools.lru_cache(maxsize=None)
def _panda3d():
    """Return Panda3D's core, told how to behave; raises RendererError."""
    if importlib.util.find_spec("panda3d") is None:
        raise RendererError("pictures need Panda3D: run scripts/setup.sh, or 'pip install panda3d'")
    from panda3d import core

    core.load_prc_file_data("bullet_lab", SETTINGS)
    return core


class _Shared:
    """The graphics of this process, made when it is first asked for."""

    def __init__(self):
        self._made: Dict[int, Graphics] = {}
        self._refusal: Optional[RendererError] = None

    def get(self) -> Graphics:
        process = os.getpid()
        if self._refusal is not None:
            raise self._refusal
        if process not in self._made:
            try:
                if self._made:
                    raise RendererError("pictures were drawn before this process was forked")
                self._made[process] = Graphics()
            except RendererError as error:
                self._refusal = error
                raise
        return self._made[process]


_SHARED = _Shared()


def shared_graphics() -> Graphics:
    """Return this process's graphics; raises RendererError."""
    return _SHARED.get()


def driver_name() -> str:
    """Return what draws in this process, as `Graphics.driver`; raises RendererError."""
    return shared_graphics().driver
