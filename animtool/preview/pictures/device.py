"""Off-screen OpenGL context: programs, textures and framebuffers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from animtool.core.errors import Fault, OptionError
from animtool.preview.pictures.sources import SHADER_HEADER, shader_source

if TYPE_CHECKING:
    from animtool.preview.pictures.camera import EyeMatrices

Array: TypeAlias = npt.NDArray[Any]
INSTALL_COMMAND = "pip install 'animtool[pictures]'"
# Samples per pixel, as on the page.
MULTISAMPLES = 4
# Maximum number of texels per row of a table texture.
MAX_ROW_TEXELS = 1024
_PACKAGES_HINT = (
    "to draw without a graphics card: apt-get install libegl1 libgl1 "
    "libgl1-mesa-dri, or dnf install mesa-libEGL mesa-dri-drivers"
)


def import_package(name: str) -> ModuleType:
    """Import a package of an optional extra; raise IO005 if it is not installed."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        package = {"PIL": "Pillow", "PIL.Image": "Pillow"}.get(name, name)
        message = f"pictures need the package {package}"
        raise OptionError(Fault("IO005", message, hint=INSTALL_COMMAND)) from error


class TextureTable:
    """A float texture that vertex shaders read, with four numbers per texel."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._width = self._height = 0
        self.texture: Any = None

    def upload(self, texels: Array) -> None:
        """Upload texels ``(N, 4)`` to the texture, replacing its content."""
        count = len(texels)
        width = min(MAX_ROW_TEXELS, max(count, 64))
        height = max(-(-count // width), 1)
        if self.texture is None or width > self._width or height > self._height:
            if self.texture is not None:
                self.texture.release()
            self._width = max(width, self._width)
            self._height = max(height, self._height)
            size = self._width, self._height
            self.texture = self._device.gl.texture(size, 4, dtype="f4")
            nearest = self._device.moderngl.NEAREST
            self.texture.filter = nearest, nearest
        row_count = max(-(-count // self._width), 1)
        padded_texels = np.zeros((row_count * self._width, 4), "<f4")
        padded_texels[:count] = texels
        self.texture.write(
            padded_texels.tobytes(), viewport=(0, 0, self._width, row_count)
        )


class Device:
    """An OpenGL context with cached programs."""

    def __init__(self) -> None:
        self.moderngl = import_package("moderngl")
        self.gl = _create_context(self.moderngl)
        self.gl.enable(self.moderngl.PROGRAM_POINT_SIZE)
        self._program_by_key: dict[tuple[str, ...], Any] = {}
        self._empty_vertex_array_by_program: dict[Any, Any] = {}

    def program(
        self,
        module: str,
        vertex: str = "VERTEX",
        fragment: str = "FRAGMENT",
        defines: tuple[str, ...] = (),
    ) -> Any:
        """Return a program of the viewer; ``defines`` are vertex shader defines."""
        program_key = module, vertex, fragment, *defines
        if program_key not in self._program_by_key:
            define_lines = "".join(f"#define {name}\n" for name in defines)
            self._program_by_key[program_key] = self.gl.program(
                vertex_shader=SHADER_HEADER
                + define_lines
                + shader_source(module, vertex),
                fragment_shader=SHADER_HEADER + shader_source(module, fragment),
            )
        return self._program_by_key[program_key]

    def set_uniforms(self, program: Any, eye: EyeMatrices, **uniforms: Any) -> None:
        """Set the uniforms of a program, including the camera's."""
        value_by_uniform = {
            "viewProjection": eye.view_projection,
            "view": eye.view,
            "light": eye.light,
            "opacity": eye.opacity,
            **uniforms,
        }
        for name, value in value_by_uniform.items():
            if name not in program:
                continue
            if hasattr(value, "texture"):
                value.texture.use(0)
                program[name].value = 0
            elif isinstance(value, np.ndarray) and value.ndim == 2:
                # OpenGL stores matrices by columns.
                program[name].write(value.T.astype("<f4").tobytes())
            elif np.ndim(value):
                program[name].value = tuple(map(float, value))
            else:
                program[name].value = float(value)

    def draw_generated(
        self, program: Any, vertex_count: int, mode: int | None = None
    ) -> None:
        """Draw triangles whose corners the vertex shader generates."""
        if program not in self._empty_vertex_array_by_program:
            self._empty_vertex_array_by_program[program] = self.gl.vertex_array(
                program, []
            )
        mode = self.moderngl.TRIANGLES if mode is None else mode
        self._empty_vertex_array_by_program[program].render(mode, vertices=vertex_count)

    @contextmanager
    def blending(self) -> Iterator[None]:
        """Return a context in which drawing is alpha-blended."""
        self.gl.enable(self.moderngl.BLEND)
        self.gl.blend_func = self.moderngl.SRC_ALPHA, self.moderngl.ONE_MINUS_SRC_ALPHA
        try:
            yield
        finally:
            self.gl.disable(self.moderngl.BLEND)

    def close(self) -> None:
        """Release the OpenGL context and everything in it."""
        self.gl.release()


class Framebuffer:
    """A multisampled framebuffer whose pixels can be read back."""

    def __init__(self, device: Device, width: int, height: int) -> None:
        gl = device.gl
        self._device, self.size = device, (width, height)
        samples = min(MULTISAMPLES, gl.max_samples)
        self._samples_buffer = gl.framebuffer(
            [gl.renderbuffer(self.size, 3, samples=samples)],
            gl.depth_renderbuffer(self.size, samples=samples),
        )
        self._pixel_buffer = gl.framebuffer([gl.renderbuffer(self.size, 3)])

    def draw(
        self, background: tuple[int, int, int], draw: Callable[[Any], None]
    ) -> Array:
        """Return the pixels ``(H, W, 3)`` that a function draws."""
        gl = self._device.gl
        self._samples_buffer.use()
        self._samples_buffer.depth_mask = True
        self._samples_buffer.clear(*(x / 255 for x in background), 1.0, depth=1.0)
        gl.enable(self._device.moderngl.DEPTH_TEST)
        draw(self._samples_buffer)
        gl.copy_framebuffer(self._pixel_buffer, self._samples_buffer)
        width, height = self.size
        pixel_bytes = self._pixel_buffer.read(components=3, alignment=1)
        return np.frombuffer(pixel_bytes, np.uint8).reshape(height, width, 3)[::-1]


def _create_context(graphics_module: ModuleType) -> Any:
    """Return a windowless context (PRV005 if none can be created)."""
    backends: list[dict[str, Any]] = [{}]
    if sys.platform.startswith("linux"):
        backends = [{"backend": "egl"}, {}]
    reasons = []
    for backend in backends:
        try:
            return graphics_module.create_context(
                standalone=True, require=330, **backend
            )
        # Backends raise exceptions of any type.
        except Exception as error:
            reasons.append(str(error))
    message = f"OpenGL 3.3 could not be started: {reasons[0]}"
    raise OptionError(Fault("PRV005", message, hint=_PACKAGES_HINT))
