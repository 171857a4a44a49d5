"""OpenGL through moderngl, in a context of its own that needs no display.

The context is created and used on one dedicated thread. On Blender's main thread it would damage Blender's own context:
glcontext ignores a failed eglMakeCurrent and leaves no context current on exit.
"""

from __future__ import annotations

import ctypes
import re
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, cast

import numpy as np

from ..core.errors import DeviceError
from . import shader_source
from .declaration import ComputeDeclaration, GeometryDeclaration, KernelDeclaration, RasterDeclaration
from .interface import (
    ComputeKernel,
    Device,
    DeviceMesh,
    Draw,
    GeometryKernel,
    RasterKernel,
    RenderTarget,
    Result,
    Texture,
    TextureFormat,
)
from .owned import Owned
from .texture_pool import TexturePool

MINIMUM_OPENGL = 430
GL_COLOR = 0x1800
GL_TEXTURE_2D = 0x0DE1
GL_DEPTH_COMPONENT = 0x1902
GL_DEPTH_COMPONENT32F = 0x8CAC
GL_FLOAT = 0x1406
GL_MAX_GEOMETRY_IMAGE_UNIFORMS = 0x90CD
GL_MAX_COMPUTE_IMAGE_UNIFORMS = 0x91BD
GEOMETRY_IMAGES = 2
"""that geometry shaders of this program store into; OpenGL guarantees none"""
UNUSED_TEXTURES_BYTES = 512 << 20
"""kept for the next who wants them; what a frame of 1920 x 1080 pixels holds"""
DRIVER_LINE = re.compile(r"\b0[:(](\d+)\b")
"""'0:7(10): error' of Mesa, '0(7) : error' of NVIDIA, 'ERROR: 0:7:' of others"""


HEARING_S = 0.2
"""how long a waiting thread may not notice a Ctrl-C"""


class ModernglTexture(Texture):
    def __init__(self, device: ModernglDevice, width: int, height: int, texture_format: TextureFormat, texels: bytes | None = None) -> None:
        self.device, self.width, self.height, self.format = device, width, height, texture_format
        context = device.context
        # the pool is where the handles come from that it hands out
        self.handle: Any = device.unused_textures.take((width, height, texture_format))
        if self.handle is not None:
            if texels is not None:
                self.handle.write(texels)
        elif texture_format is TextureFormat.DEPTH32F:
            self.handle = context.depth_texture((width, height))
            device.give_float_depth(self.handle.glo, width, height)
        else:
            self.handle = context.texture(
                (width, height), texture_format.channel_count, texels, dtype="u4" if texture_format.is_unsigned else "f4"
            )
            self.handle.filter = (device.moderngl.NEAREST, device.moderngl.NEAREST)
        # drivers have limits below that of the sides, and go on without the texture
        if context.error == "GL_OUT_OF_MEMORY":
            self.handle.release()
            raise DeviceError(self.no_memory())

    def release(self) -> None:
        # once only: memory kept twice would be handed to two owners
        handle, self.handle = self.handle, None
        if handle is not None:
            self.device.run(self.device.unused_textures.keep, (self.width, self.height, self.format), handle)


class ModernglMesh(DeviceMesh):
    def __init__(self, device: ModernglDevice, positions: np.ndarray, triangles: np.ndarray) -> None:
        self.device, self.triangle_count = device, len(triangles)
        self.vertex_arrays: dict[int, Any] = {}
        with Owned() as owned:
            self.positions = owned.own(device.context.buffer(np.ascontiguousarray(positions, np.float32)))
            self.triangles = owned.own(device.context.buffer(np.ascontiguousarray(triangles, np.int32)))
            self._owned = owned.pop_all()

    def vertex_array(self, program: Any) -> Any:
        if program.glo not in self.vertex_arrays:
            content = [(self.positions, "3f", "position_os")]
            self.vertex_arrays[program.glo] = self._owned.own(self.device.context.vertex_array(program, content, self.triangles))
        return self.vertex_arrays[program.glo]

    def release(self) -> None:
        self.device.run(self._owned.close)


class ModernglTarget(RenderTarget):
    def __init__(self, device: ModernglDevice, color: ModernglTexture, depth: ModernglTexture) -> None:
        self.device, self.color, self.depth = device, color, depth
        self.handle = device.context.framebuffer([color.handle], depth.handle)

    def release(self) -> None:
        self.device.run(self.handle.release)


class _Bindings:
    """Binds a declaration's names to one program; shared by compute and raster kernels. Runs on the device's thread."""

    def __init__(self, device: ModernglDevice, declaration: KernelDeclaration, program: Any, fetches_from_images: bool = False) -> None:
        self.declaration, self.fetches_from_images = declaration, fetches_from_images
        # the compiler drops names that a variant does not use; a program is slow to ask, and draws set constants one by one
        self.uniforms = {name: program[name] for name in program if name in declaration.binding_names}
        self.table_buffers = {name: device.context.buffer(reserve=16 * table.length) for name, table in declaration.tables.items()}
        if not fetches_from_images:
            for unit, name in enumerate(declaration.textures):
                self.set_constant(name, unit)

    def set_constant(self, name: str, value: Any) -> None:
        uniform = self.uniforms.get(name)
        if uniform is not None:
            uniform.value = value

    def bind(self, bindings: Mapping[str, Any]) -> None:
        self.declaration.check_bindings(bindings)
        if self.fetches_from_images:
            for slot, (name, texture) in enumerate(self.declaration.textures.items(), len(self.declaration.images)):
                if bindings[name].format.value != texture.texture_format:
                    raise TypeError(f"kernel {self.declaration.name}: {name} is declared as {texture.texture_format}")
                bindings[name].handle.bind_to_image(slot, read=True, write=False)
        else:
            for unit, name in enumerate(self.declaration.textures):
                bindings[name].handle.use(unit)
        for slot, (name, image) in enumerate(self.declaration.images.items()):
            bindings[name].handle.bind_to_image(slot, read=image.access != "write", write=True)
        for name, constant in self.declaration.constants.items():
            value = bindings[name]
            if constant.glsl_type == "mat4":
                value = tuple(np.asarray(value, np.float32).T.ravel().tolist())
            elif constant.glsl_type.startswith("vec"):
                value = tuple(float(v) for v in value)
            self.set_constant(name, value)
        for slot, (name, table) in enumerate(self.declaration.tables.items()):
            self.table_buffers[name].write(table.pack(name, bindings[name]))
            self.table_buffers[name].bind_to_uniform_block(slot)


class ModernglComputeKernel(ComputeKernel):
    def __init__(self, device: ModernglDevice, declaration: ComputeDeclaration, flags: tuple[str, ...]) -> None:
        self.device, self.declaration = device, declaration
        image_count = len(declaration.textures) + len(declaration.images)
        for_software = device.is_software and not declaration.is_long and image_count <= device.compute_image_limit
        text = shader_source.opengl_compute(declaration, flags, for_software)
        stages = {"compute_shader": (declaration.source, text)}
        self.shader = device.compile(declaration, stages, lambda: device.context.compute_shader(text))
        self.bindings = _Bindings(device, declaration, self.shader, fetches_from_images=for_software)

    def dispatch(self, group_counts: tuple[int, int, int], /, **bindings: Any) -> None:
        self.device.run(self._dispatch, group_counts, bindings)

    def _dispatch(self, group_counts: tuple[int, int, int], bindings: Mapping[str, Any]) -> None:
        self.bindings.bind(bindings)
        self.shader.run(*group_counts)
        self.device.context.memory_barrier()
        self.device.note_run(self)


class ModernglRasterKernel(RasterKernel):
    def __init__(self, device: ModernglDevice, declaration: RasterDeclaration, flags: tuple[str, ...]) -> None:
        self.device, self.declaration = device, declaration
        vertex, fragment = shader_source.opengl_raster(declaration, flags)
        stages = {"vertex_shader": (declaration.vertex_source, vertex), "fragment_shader": (declaration.fragment_source, fragment)}
        self.program = device.compile(declaration, stages, lambda: device.context.program(vertex_shader=vertex, fragment_shader=fragment))
        self.bindings = _Bindings(device, declaration, self.program)

    def draw(self, target: RenderTarget, viewport: tuple[int, int, int, int], draws: Sequence[Draw], /, **bindings: Any) -> None:
        if draws:
            self.device.run(self._draw, target, viewport, draws, bindings)

    def _draw(
        self, target: ModernglTarget, viewport: tuple[int, int, int, int], draws: Sequence[Draw], bindings: Mapping[str, Any]
    ) -> None:
        context, moderngl = self.device.context, self.device.moderngl
        target.handle.use()
        target.handle.viewport = viewport
        self.bindings.bind({**bindings, **draws[0].constants})
        tested = moderngl.DEPTH_TEST if self.declaration.has_depth_test else moderngl.NOTHING
        culling = None
        for draw in draws:
            # thousands of draws a batch: only what changes is said
            if draw.cull_back_faces is not culling:
                culling = draw.cull_back_faces
                context.enable_only(tested | (moderngl.CULL_FACE if culling else 0))
            for name, value in draw.constants.items():
                self.bindings.set_constant(name, value)
            vertex_array = cast(ModernglMesh, draw.mesh).vertex_array(self.program)
            if draw.triangle_range is None:
                vertex_array.render(instances=draw.instance_count)
            else:
                first, count = draw.triangle_range
                vertex_array.render(vertices=3 * count, first=3 * first)
        if self.declaration.images:
            context.memory_barrier()
        self.device.hand_over()
        self.device.note_run(self)


class ModernglGeometryKernel(GeometryKernel):
    def __init__(self, device: ModernglDevice, declaration: GeometryDeclaration, flags: tuple[str, ...]) -> None:
        self.device, self.declaration = device, declaration
        vertex, geometry, fragment = shader_source.opengl_geometry(declaration, flags)
        stages = {
            "vertex_shader": (shader_source.NUMBER_SOURCE, vertex),
            "geometry_shader": (declaration.geometry_source, geometry),
            "fragment_shader": (declaration.fragment_source, fragment),
        }
        self.program = device.compile(
            declaration,
            stages,
            lambda: device.context.program(vertex_shader=vertex, geometry_shader=geometry, fragment_shader=fragment),
        )
        self.bindings = _Bindings(device, declaration, self.program)
        self.numbers = device.context.vertex_array(self.program, [])

    def draw(self, target: RenderTarget, viewport: tuple[int, int, int, int], strip_count: int, /, **bindings: Any) -> None:
        if strip_count > 0:
            self.device.run(self._draw, target, viewport, strip_count, bindings)

    def _draw(self, target: ModernglTarget, viewport: tuple[int, int, int, int], strip_count: int, bindings: Mapping[str, Any]) -> None:
        context, moderngl = self.device.context, self.device.moderngl
        target.handle.use()
        target.handle.viewport = viewport
        self.bindings.bind(bindings)
        context.enable_only(moderngl.NOTHING)
        self.numbers.render(moderngl.POINTS, vertices=strip_count)
        context.memory_barrier()
        self.device.note_run(self)


class ModernglDevice(Device):
    name = "moderngl"
    stores_from_fragments = True

    def __init__(self) -> None:
        try:
            import glcontext
            import moderngl
        except ImportError as error:
            raise DeviceError(f"the package moderngl is not installed ({error}); run: python -m pip install moderngl") from error
        self.glcontext, self.moderngl = glcontext, moderngl
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="vir-opengl")
        self._kernels: dict[tuple[str, tuple[str, ...]], Any] = {}
        self._started: set[Any] = set()
        try:
            self._worker.submit(self._open).result()
        except Exception:
            self._worker.shutdown()
            raise

    def _open(self) -> None:
        self._thread_id = threading.get_ident()
        try:
            # on Linux the default would be X11, which needs a display and replaces the context of a running Blender;
            # elsewhere EGL is missing
            backend = self.glcontext.get_backend_by_name("egl") if sys.platform == "linux" else self.glcontext.default_backend()
            native = backend(mode="standalone", glversion=MINIMUM_OPENGL)
            self.context = self.moderngl.create_context(require=MINIMUM_OPENGL, standalone=True, context=native)
        except Exception as error:
            # glcontext raises bare Exceptions whose text is all there is to go by
            raise DeviceError(
                f"no OpenGL 4.3 context without a display could be made ({error}); on Debian or Ubuntu run: "
                "apt-get install libegl1 libgl1 libgl1-mesa-dri"
            ) from error
        info = self.context.info
        self._describe(info["GL_RENDERER"], f"OpenGL {info['GL_VERSION']}")
        self.max_texture_size_px = int(info["GL_MAX_TEXTURE_SIZE"])
        get_integer = ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.POINTER(ctypes.c_int))(native.load("glGetIntegerv"))

        def limit(name: int) -> int:
            value = ctypes.c_int()
            get_integer(name, ctypes.byref(value))
            return value.value

        self.stores_from_geometry = limit(GL_MAX_GEOMETRY_IMAGE_UNIFORMS) >= GEOMETRY_IMAGES
        self.compute_image_limit = limit(GL_MAX_COMPUTE_IMAGE_UNIFORMS)
        # moderngl clears with float colours only, which is undefined for unsigned textures; drawing or writing takes 4 to 7 times longer
        clear = ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.c_int, ctypes.POINTER(ctypes.c_uint))
        self._clear_unsigned = clear(native.load("glClearBufferuiv"))
        bind = ctypes.CFUNCTYPE(None, ctypes.c_uint, ctypes.c_uint)
        self._bind_texture = bind(native.load("glBindTexture"))
        specify = ctypes.CFUNCTYPE(None, ctypes.c_uint, *[ctypes.c_int] * 5, ctypes.c_uint, ctypes.c_uint, ctypes.c_void_p)
        self._specify_texture = specify(native.load("glTexImage2D"))
        # moderngl keeps Python's lock while it waits, and so Blender's interface from drawing; ctypes lets it go
        self._wait = ctypes.CFUNCTYPE(None)(native.load("glFinish"))
        flush = ctypes.CFUNCTYPE(None)(native.load("glFlush"))
        # a software rasterizer fills texels of what it was given while it places the next draw's vertices; a GPU gains nothing from it
        self.hand_over: Callable[[], None] = flush if self.is_software else lambda: None
        self.unused_textures = TexturePool(UNUSED_TEXTURES_BYTES if self.is_software else 0)

    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        if threading.get_ident() == self._thread_id:
            return function(*arguments)
        future = self._worker.submit(function, *arguments)
        # Ctrl-C may reach another thread than the one that waits here, which hears of it only when it wakes
        while not wait((future,), timeout=HEARING_S).done:
            pass
        return future.result()

    def compile(self, declaration: KernelDeclaration, stages: Mapping[str, tuple[str, str]], build: Callable[[], Result]) -> Result:
        """stages: moderngl's name of a stage -> file name and composed text"""
        try:
            return build()
        except self.moderngl.Error as error:
            log = str(error).strip()
            raise DeviceError(shader_source.refusal(declaration.name, log, DRIVER_LINE, stages)) from error

    def compute_kernel(self, declaration: ComputeDeclaration, *flags: str) -> ComputeKernel:
        return self._kernel(ModernglComputeKernel, declaration, flags)

    def raster_kernel(self, declaration: RasterDeclaration, *flags: str) -> RasterKernel:
        return self._kernel(ModernglRasterKernel, declaration, flags)

    def geometry_kernel(self, declaration: GeometryDeclaration, *flags: str) -> GeometryKernel:
        return self._kernel(ModernglGeometryKernel, declaration, flags)

    def create_texture(self, width: int, height: int, texture_format: TextureFormat) -> Texture:
        return self.run(ModernglTexture, self, width, height, texture_format)

    def upload_texture(self, texels: np.ndarray) -> Texture:
        height, width, _ = texels.shape
        data = np.ascontiguousarray(texels, np.float32)
        return self.run(ModernglTexture, self, width, height, TextureFormat.RGBA32F, data)

    def upload_mesh(self, positions: np.ndarray, triangles: np.ndarray) -> DeviceMesh:
        return self.run(ModernglMesh, self, positions, triangles)

    def create_target(self, color: Texture, depth: Texture) -> RenderTarget:
        return self.run(ModernglTarget, self, color, depth)

    def give_float_depth(self, texture: int, width: int, height: int) -> None:
        """To a depth texture, by its number: moderngl makes those of 24 bits, fixed point. On the device's thread."""
        self._bind_texture(GL_TEXTURE_2D, texture)
        self._specify_texture(GL_TEXTURE_2D, 0, GL_DEPTH_COMPONENT32F, width, height, 0, GL_DEPTH_COMPONENT, GL_FLOAT, None)

    def fill(self, texture: Texture, value: int) -> None:
        self.run(self._fill, texture, value)

    def _fill(self, texture: ModernglTexture, value: int) -> None:
        if texture.format is TextureFormat.DEPTH32F:
            framebuffer = self.context.framebuffer(depth_attachment=texture.handle)
            framebuffer.clear(depth=1.0)
        else:
            framebuffer = self.context.framebuffer([texture.handle])
            framebuffer.use()
            self._clear_unsigned(GL_COLOR, 0, (ctypes.c_uint * 4)(value, value, value, value))
        framebuffer.release()
        self.context.memory_barrier()

    def read(self, texture: Texture) -> np.ndarray:
        return self.run(self._read, texture)

    def _read(self, texture: ModernglTexture) -> np.ndarray:
        self._wait()
        dtype = np.uint32 if texture.format.is_unsigned else np.float32
        values = np.frombuffer(texture.handle.read(), dtype)
        shape = (texture.height, texture.width, texture.format.channel_count)
        return values.reshape(shape[:2] if shape[2] == 1 else shape)

    def finish(self) -> None:
        self.run(self._wait)

    def close(self) -> None:
        self.run(self.context.release)
        self._worker.shutdown()
