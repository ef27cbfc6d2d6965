"""Draw pictures with Panda3D, without a screen: the graphics engine of a process, and its buffers.

It draws through EGL; without a GPU, Mesa draws in software. This is the one module that imports
Panda3D itself. `drawables` makes triangles and textures of shapes, `lights` has the lights with
their GLSL programs and shadow maps, and `renderer` takes pictures and depths through a pinhole
camera. `plugins.camera` adds the errors of lens and sensor.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import os
import threading
from pathlib import Path
from typing import Any, Callable, Sequence, Tuple

import numpy as np
from numpy import ndarray

from bullet_lab.core.pose import Pose
from bullet_lab.entry import hidden_native_output
from bullet_lab.errors import LabError

# Columns and rows.
Size = Tuple[int, int]

PIPE = "p3headlessgl"
SETTINGS = """
window-type offscreen
audio-library-name null
notify-level error
notify-level-display fatal
# The caches of states and transforms would keep the textures of removed models.
state-cache 0
transform-cache 0
# Textures keep their sizes; by default they are reduced to powers of two.
textures-power-2 none
# Otherwise each shadow map has a colour buffer of its size.
gl-force-fbo-color 0
sync-video 0
"""
EGL_OPENGL_API = 0x30A2
EGL_DRAW = 0x3059
# The number of threads of Mesa's llvmpipe, unless the user sets it. With threads, llvmpipe keeps
# several scenes with all their textures: up to 128 MB of removed shadow maps. Without threads, a
# picture of 640x480 takes 0.8 ms longer, and 14 % less processor time.
THREADS = "LP_NUM_THREADS", "0"
# The numbers of samples that a pixel may have.
SAMPLES = (1, 2, 4)
# Instead of a number of samples: a picture of depths.
DEPTHS = 0
# The number of buffers for pictures that are kept, those used last.
KEPT_BUFFERS = 8
KEPT_PROGRAMS = 64
# The priority of a camera's state over that of objects.
OVERRIDE = 100
# Major and minor version of the programs' language; Debian 11's llvmpipe has no more.
GLSL = (1, 40)
NO_DRIVER = "pictures need EGL and a driver: on Debian, install libegl1 and libgl1-mesa-dri"


class RendererError(LabError):
    """A picture cannot be drawn."""


def program_text(file: str) -> str:
    """Return a GLSL program beside this module."""
    return Path(__file__).with_name(file).read_text()


class Canvas:
    """A buffer of Panda3D, with the texture that holds the result.

    It has tiles that are `size` pixels wide, and a camera for each tile, row by row.
    """

    def __init__(self, buffer: Any, texture: Any, tiles: Size):
        core, (columns, rows) = panda3d(), tiles
        self.buffer, self.texture = buffer, texture
        self.size = buffer.get_x_size() // columns
        self.cameras: list[Any] = []
        for row, column in np.ndindex(rows, columns):
            sides = (column / columns, (column + 1) / columns, row / rows, (row + 1) / rows)
            self.cameras.append(core.NodePath(core.Camera("camera")))
            buffer.make_display_region(*sides).set_camera(self.cameras[-1])
        buffer.set_active(False)
        # A buffer that must exist as long as this one.
        self.sharer: Any = None
        # Panda3D's own picture, and a numpy view of it.
        self._seen: tuple[Any, ndarray] = (None, np.zeros(0, np.uint8))

    def aim(self, root: Any, state: Any, bit: int, matrices: Sequence[ndarray]) -> None:
        """Let the cameras show the nodes with a bit below a root, with projection matrices."""
        core = panda3d()
        for path, matrix in zip(self.cameras, matrices):
            node, lens = path.node(), core.MatrixLens()
            lens.set_user_mat(panda_matrix(matrix))
            node.set_lens(lens)
            node.set_scene(root)
            node.set_initial_state(state)
            node.set_camera_mask(core.BitMask32.bit(bit))

    def cut(self, rows: slice, columns: slice) -> None:
        """Draw only these rows and columns of the first camera's picture."""
        width, height = self.texture.get_x_size(), self.texture.get_y_size()
        (left, right, _), (low, high, _) = columns.indices(width), rows.indices(height)
        frame = panda3d().LVecBase4(left / width, right / width, low / height, high / height)
        node = self.cameras[0].node()
        scissors = panda3d().ScissorAttrib.make(frame)
        node.set_initial_state(node.get_initial_state().set_attrib(scissors))

    def pixels(self, kind: type, channels: int) -> ndarray:
        """Return the result, (height, width, channels), until the next picture."""
        image = self.texture.get_ram_image()
        # Panda3D uses the same memory again, and leaks 32 bytes with each view of it.
        if image != self._seen[0]:
            self._seen = (image, np.frombuffer(image, np.uint8))
        shape = (self.texture.get_y_size(), self.texture.get_x_size(), channels)
        return self._seen[1].view(kind).reshape(shape)


class Graphics:
    """Panda3D's engine with a graphics context; one per process, see `shared_graphics`.

    Any thread may use it, one at a time. The context is released after each use, since a driver
    silently draws nothing for a thread while another thread has it.

    `driver` is the name of the driver, such as "llvmpipe (LLVM 15.0.6, 256 bits)"; `program` makes
    a shader from two GLSL programs, the same one for all scenes; `depth_program` draws depths.
    """

    def __init__(self):
        core = panda3d()
        make = functools.partial(core.Shader.make, core.Shader.SL_GLSL)
        self.program = functools.lru_cache(maxsize=KEPT_PROGRAMS)(make)
        self.depth_program = self.program(program_text("depth.vert"), program_text("depth.frag"))
        self._lock = threading.Lock()
        self._kept: dict[tuple[int, int, int], Canvas] = {}
        try:
            self._egl = ctypes.CDLL("libEGL.so.1")
        except OSError as error:
            raise RendererError(NO_DRIVER) from error
        for now in ("eglGetCurrentDisplay", "eglGetCurrentSurface", "eglGetCurrentContext"):
            getattr(self._egl, now).restype = ctypes.c_void_p
        self._egl.eglMakeCurrent.argtypes = [ctypes.c_void_p] * 4
        # What the last use released: display, surface twice, context.
        self._current: tuple[Any, ...] = ()
        self._engine = core.GraphicsEngine.get_global_ptr()
        self._shared: tuple[Any, ...] = ()
        with hidden_native_output():
            selection = core.GraphicsPipeSelection.get_global_ptr()
            self._pipe = self._with_context(selection.make_module_pipe, PIPE)
            known = self._pipe is not None and self._pipe.is_valid()
            context = self._buffer(core.FrameBufferProperties(), (1, 1)) if known else None
        if context is None or context.get_gsg() is None:
            raise RendererError(NO_DRIVER)
        context.set_active(False)
        state = context.get_gsg()
        self._shared = (state, context)
        self.driver = state.get_driver_renderer()
        # Panda3D would draw without them, and so without light.
        version = state.get_driver_shader_version_major(), state.get_driver_shader_version_minor()
        if version < GLSL:
            has = ".".join(map(str, version))
            raise RendererError(f"{self.driver} has GLSL {has}, 1.40 at least is needed")

    def target(self, width: int, height: int, samples: int) -> Canvas:
        """Return a target for pictures, RGB of 8 bits, or float32 DEPTHS; raise RendererError."""
        # The target used last is removed last.
        kept = self._kept.pop((width, height, samples), None)
        if kept is None:
            if len(self._kept) >= KEPT_BUFFERS:
                self.remove(self._kept.pop(next(iter(self._kept))))
            properties, is_depth = _properties(), samples == DEPTHS
            properties.set_rgba_bits(*((32, 0, 0, 0) if is_depth else (8, 8, 8, 8)))
            properties.set_float_color(is_depth)
            properties.set_multisamples(samples if samples > 1 else 0)
            kept = self._target(panda3d().Texture("picture"), properties, (width, height))
            kept.buffer.set_clear_color_active(True)
            if samples > 1:
                # Panda3D then averages only the colours of samples: it leaves out the depths that
                # a buffer shares, unless its place in the order is 0.
                kept.sharer = self._buffer(properties, (width, height))
                kept.buffer.share_depth_buffer(kept.sharer)
                kept.buffer.set_sort(1)
                self._with_context(self._engine.remove_window, kept.sharer)
        self._kept[(width, height, samples)] = kept
        return kept

    def shadow_target(self, size: int, tiles: Size) -> Canvas:
        """Return a new target for columns and rows of square shadow maps; raise RendererError."""
        core = panda3d()
        properties, texture = _properties(), core.Texture("shadow")
        # A look-up compares with a depth, and interpolates the results.
        texture.minfilter = texture.magfilter = core.SamplerState.FT_shadow
        texture.wrap_u = texture.wrap_v = core.SamplerState.WM_clamp
        target = self._target(texture, properties, (size * tiles[0], size * tiles[1]), tiles)
        target.buffer.set_sort(-1)
        for camera in target.cameras:
            # Objects between a light and its map cast shadows, too.
            camera.node().set_cull_bounds(core.OmniBoundingVolume())
        return target

    def state(self, program: Any = None, cull: str = "counter_clockwise", samples: int = 1) -> Any:
        """Return the state of a camera; its program is for all objects, None for their own."""
        # All is set, so that nothing depends on the picture before.
        core = panda3d()
        state, modes = core.NodePath("state"), core.AntialiasAttrib
        state.set_attrib(core.CullFaceAttrib.make(getattr(core.CullFaceAttrib, f"M_cull_{cull}")))
        state.set_antialias(modes.M_multisample if samples > 1 else modes.M_none)
        if program is not None:
            state.set_shader(program, OVERRIDE)
            # Transparent objects are drawn as opaque.
            state.set_transparency(core.TransparencyAttrib.M_none, OVERRIDE)
        return state.get_state()

    def draw(self, targets: Sequence[Canvas]) -> None:
        """Draw into some targets."""
        for target in targets:
            target.buffer.set_active(True)
        try:
            self._with_context(self._engine.render_frame)
        finally:
            for target in targets:
                target.buffer.set_active(False)

    def remove(self, target: Canvas) -> None:
        """Remove a canvas, and free its memory."""
        self._with_context(self._engine.remove_window, target.buffer)
        target.texture.release_all()

    def _target(self, texture: Any, properties: Any, size: Size, tiles: Size = (1, 1)) -> Canvas:
        largest = self._shared[0].get_max_texture_dimension()
        if max(size) > largest:
            raise RendererError(f"{self.driver} draws up to {largest} pixels along each side")
        buffer, kinds = self._buffer(properties, size), panda3d().GraphicsOutput
        if buffer is None:
            raise RendererError(f"{self.driver} has no buffer of this kind and size")
        coloured = (kinds.RTM_copy_ram, kinds.RTP_color)
        deep = (kinds.RTM_bind_or_copy, kinds.RTP_depth)
        buffer.add_render_texture(texture, *(coloured if properties.get_red_bits() else deep))
        # Otherwise events of new buffers pile up.
        panda3d().EventQueue.get_global_event_queue().clear()
        return Canvas(buffer, texture, tiles)

    def _buffer(self, properties: Any, size: Size) -> Any:
        core = panda3d()
        size, kind = core.WindowProperties.size(*size), core.GraphicsPipe.BF_refuse_window
        arguments = (self._pipe, "buffer", 0, properties, size, kind, *self._shared)
        return self._with_context(self._engine.make_output, *arguments)

    def _with_context(self, call: Callable[..., Any], *arguments: Any) -> Any:
        with self._lock:
            # This is set per thread; the default is OpenGL ES.
            self._egl.eglBindAPI(EGL_OPENGL_API)
            # Panda3D takes the context to draw, but not to release buffers; without a context, the
            # driver does not release them.
            if self._current:
                self._egl.eglMakeCurrent(*self._current)
            try:
                return call(*arguments)
            except AssertionError as error:
                # Panda3D raises this if one of its assertions fails.
                raise RendererError(f"Panda3D failed: {error}") from error
            finally:
                egl = self._egl
                display, surface = egl.eglGetCurrentDisplay(), egl.eglGetCurrentSurface(EGL_DRAW)
                if display:
                    self._current = (display, surface, surface, egl.eglGetCurrentContext())
                    egl.eglMakeCurrent(display, None, None, None)


def _properties() -> Any:
    """Return those of a buffer of depths; Mesa's software is fastest with floats."""
    properties = panda3d().FrameBufferProperties()
    properties.set_depth_bits(32)
    properties.set_float_depth(True)
    return properties


@functools.lru_cache
def panda3d() -> Any:
    """Return Panda3D's core with our settings; raise RendererError if it is not installed."""
    if importlib.util.find_spec("panda3d") is None:
        raise RendererError("pictures need Panda3D: run scripts/setup.sh, or 'pip install panda3d'")
    os.environ.setdefault(*THREADS)
    from panda3d import core

    core.load_prc_file_data("bullet_lab", SETTINGS)
    return core


def panda_matrix(columns: ndarray) -> Any:
    """Return Panda3D's form of a (4, 4) matrix that multiplies column vectors."""
    return panda3d().LMatrix4f(*columns.T.ravel().tolist())


def set_pose(path: Any, pose: Pose) -> None:
    """Set the pose of a node in its parent's frame."""
    x, y, z, w = pose.quaternion
    path.set_pos_quat(panda3d().LPoint3(*pose.position), panda3d().LQuaternion(w, x, y, z))


@functools.lru_cache
def _made() -> tuple[int, Graphics | RendererError]:
    """Return the id of the process that made the graphics, and the graphics or the error."""
    try:
        return os.getpid(), Graphics()
    except RendererError as error:
        return os.getpid(), error


def shared_graphics() -> Graphics:
    """Return the graphics of this process; raise RendererError."""
    process, made = _made()
    if isinstance(made, RendererError):
        raise made
    if process != os.getpid():
        raise RendererError("pictures were drawn before this process was forked")
    return made


def driver_name() -> str:
    """Return the name of the driver, see `Graphics`; raise RendererError."""
    return shared_graphics().driver
