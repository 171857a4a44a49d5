"""Blender's own `gpu` module: nothing to install, any backend that Blender has (OpenGL, Vulkan, Metal).

Memory barriers: Python has none to call. `gpu.compute.dispatch` issues one for texture fetches and image access after every
dispatch (source/blender/python/gpu/gpu_py_compute.cc), which is all that one kernel needs to see what another wrote. Nothing
issues the barriers that OpenGL asks for between a dispatch and a read-back, a clear or a draw into the same texture; Mesa and
the vendors' drivers order these by themselves, and Vulkan and Metal are tracked by Blender.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np

from ..core.errors import DeviceError
from . import shader_source
from .blender_objects import ObjectHolder, free_put_by
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

FORMAT_NAMES = {TextureFormat.DEPTH32F: "DEPTH_COMPONENT32F"}
"""Where Blender's name is not the interface's."""
SAMPLER_TYPES = {"sampler2D": "FLOAT_2D", "usampler2D": "UINT_2D"}
IMAGE_QUALIFIERS = {"write": {"WRITE"}, "read_write": {"READ", "WRITE"}, "atomic": {"READ", "WRITE"}}
CONSOLE_LINE = re.compile(r"\.glsl:(\d+)")
"""Blender names every source python_shader.glsl and has already translated the driver's line numbers."""
VERSION_PROBE = re.compile(r"EGL Error \(0x3009\): EGL_BAD_MATCH\b.*\n?")
"""Blender asks EGL for OpenGL 4.6, 4.5, ... until the driver has one, and prints each refusal."""
STANDARD_OUTPUT, STANDARD_ERROR = 1, 2
EGL_PLATFORM_SURFACELESS = 0x31DD
INSTALL_EGL = "apt-get install libegl1 libgl1 libgl1-mesa-dri"


class BlenderTexture(Texture, ObjectHolder):
    def __init__(
        self, device: BlenderGpuDevice, width: int, height: int, texture_format: TextureFormat, texels: np.ndarray | None = None
    ) -> None:
        self.device, self.width, self.height, self.format = device, width, height, texture_format
        gpu = device.gpu
        # the Buffer looks into the array; creation copies, so neither has to outlive this call
        data = None if texels is None else gpu.types.Buffer("FLOAT", texels.size, texels.ravel())
        try:
            self.handle = gpu.types.GPUTexture((width, height), format=FORMAT_NAMES.get(texture_format, texture_format.value), data=data)
        except RuntimeError as error:
            raise DeviceError(self.no_memory()) from error

    def release(self) -> None:
        # Blender frees a GPU object with its last Python reference
        self.device.run(setattr, self, "handle", None)

    def held_objects(self) -> list[Any]:
        return [vars(self).get("handle")]


class BlenderMesh(DeviceMesh, ObjectHolder):
    def __init__(self, device: BlenderGpuDevice, positions: np.ndarray, triangles: np.ndarray) -> None:
        self.device, self.triangle_count = device, len(triangles)
        types = device.gpu.types
        vertex_format = types.GPUVertFormat()
        vertex_format.attr_add(id="position_os", comp_type="F32", len=3, fetch_mode="FLOAT")
        vertices = types.GPUVertBuf(vertex_format, len(positions))
        vertices.attr_fill("position_os", np.ascontiguousarray(positions, np.float32))
        indices = types.GPUIndexBuf(type="TRIS", seq=np.ascontiguousarray(triangles, np.uint32))
        self.batch = types.GPUBatch(type="TRIS", buf=vertices, elem=indices)

    def release(self) -> None:
        self.device.run(setattr, self, "batch", None)

    def held_objects(self) -> list[Any]:
        return [vars(self).get("batch")]


class _Framebuffer(ObjectHolder):
    """Each of Blender's windows has a context, which textures are shared with but framebuffers are not, and any may be active when Blender
    calls next: a framebuffer is made again in every call from outside."""

    def __init__(self, device: BlenderGpuDevice, **slots: Any) -> None:
        self.device, self._slots = device, slots
        self._made_in_call = -1
        self._handle: Any = None

    @property
    def handle(self) -> Any:
        """to bind and draw into"""
        if self._made_in_call != self.device.call_count:
            self._handle = self.device.gpu.types.GPUFrameBuffer(**self._slots)
            self._made_in_call = self.device.call_count
        return self._handle

    def release(self) -> None:
        self._handle, self._slots, self._made_in_call = None, {}, -1

    def held_objects(self) -> list[Any]:
        return [self._handle, self._slots]


class BlenderTarget(RenderTarget):
    def __init__(self, device: BlenderGpuDevice, color: BlenderTexture, depth: BlenderTexture) -> None:
        self.device, self.color, self.depth = device, color, depth
        self.framebuffer = _Framebuffer(device, depth_slot=depth.handle, color_slots=[color.handle])

    def release(self) -> None:
        self.device.run(self.framebuffer.release)


def _create_info(gpu: Any, declaration: KernelDeclaration, flags: tuple[str, ...]) -> Any:
    """The interface of a declaration in Blender's terms; sources, vertex inputs and outputs are still to come."""
    declaration.check_flags(flags)
    info = gpu.types.GPUShaderCreateInfo()
    for flag in flags:
        info.define(flag, "1")
    for name, number in declaration.defines.items():
        info.define(name, repr(number))
    for slot, (name, texture) in enumerate(declaration.textures.items()):
        info.sampler(slot, SAMPLER_TYPES[texture.sampler], name)
    for slot, (name, image) in enumerate(declaration.images.items()):
        kind = "UINT_2D" if image.texture_format.endswith("UI") else "FLOAT_2D"
        kind += "_ATOMIC" * (image.access == "atomic")
        info.image(slot, image.texture_format, kind, name, qualifiers=IMAGE_QUALIFIERS[image.access])
    for name, constant in declaration.constants.items():
        info.push_constant(constant.glsl_type.upper(), name)
    for slot, (name, table) in enumerate(declaration.tables.items()):
        info.uniform_buf(slot, "vec4", f"{name}[{table.length}]")
    return info


class _Bindings(ObjectHolder):
    """Binds a declaration's names to one shader; shared by compute and raster kernels."""

    def __init__(self, device: BlenderGpuDevice, declaration: KernelDeclaration, shader: Any) -> None:
        self.declaration, self.shader = declaration, shader
        self.table_buffers = {name: device.gpu.types.GPUUniformBuf(bytes(16 * table.length)) for name, table in declaration.tables.items()}
        self.locations: dict[str, int] = {}
        for name in declaration.constants:
            # the compiler drops names that a variant does not use; Blender then raises ValueError
            with contextlib.suppress(ValueError):
                self.locations[name] = shader.uniform_from_name(name)

    def bind(self, bindings: Mapping[str, Any]) -> None:
        declaration, shader = self.declaration, self.shader
        declaration.check_bindings(bindings)
        shader.bind()
        for name in declaration.textures:
            shader.uniform_sampler(name, bindings[name].handle)
        for name in declaration.images:
            shader.image(name, bindings[name].handle)
        for name in declaration.constants:
            self.set_constant(name, bindings[name])
        for name, table in declaration.tables.items():
            self.table_buffers[name].update(table.pack(name, bindings[name]))
            shader.uniform_block(name, self.table_buffers[name])

    def held_objects(self) -> list[Any]:
        return [vars(self).get("shader"), vars(self).get("table_buffers")]

    def set_constant(self, name: str, value: Any) -> None:
        location = self.locations.get(name)
        if location is None:
            return
        if self.declaration.constants[name].glsl_type == "int":
            # by name: four times faster than an array for the location
            self.shader.uniform_int(name, value)
        else:
            # transposed: numpy's rows are GLSL's columns; what has fewer than two axes stays as it is
            numbers = np.ascontiguousarray(np.asarray(value, np.float32).T).ravel()
            self.shader.uniform_vector_float(location, numbers, numbers.size, 1)


class BlenderComputeKernel(ComputeKernel):
    def __init__(self, device: BlenderGpuDevice, declaration: ComputeDeclaration, flags: tuple[str, ...]) -> None:
        self.device, self.declaration = device, declaration
        source = shader_source.load(declaration.source)
        info = _create_info(device.gpu, declaration, flags)
        info.local_group_size(*declaration.local_size)
        info.compute_source(source)
        self.shader = device.compile(declaration, info, {"ComputeShader": (declaration.source, source)})
        self.bindings = _Bindings(device, declaration, self.shader)

    def dispatch(self, group_counts: tuple[int, int, int], /, **bindings: Any) -> None:
        self.device.run(self._dispatch, group_counts, bindings)

    def _dispatch(self, group_counts: tuple[int, int, int], bindings: Mapping[str, Any]) -> None:
        self.bindings.bind(bindings)
        self.device.gpu.compute.dispatch(self.shader, *group_counts)
        self.device.note_run(self)


class BlenderRasterKernel(RasterKernel):
    def __init__(self, device: BlenderGpuDevice, declaration: RasterDeclaration, flags: tuple[str, ...]) -> None:
        self.device, self.declaration = device, declaration
        vertex, fragment = shader_source.load(declaration.vertex_source), shader_source.load(declaration.fragment_source)
        info = _create_info(device.gpu, declaration, flags)
        info.vertex_in(0, "VEC3", "position_os")
        if declaration.varyings:
            # kept until the shader exists: the info only points to it
            stages = device.gpu.types.GPUStageInterfaceInfo(f"{declaration.name}_varyings")
            for name, varying in declaration.varyings.items():
                getattr(stages, varying.interpolation)(varying.glsl_type.upper(), name)
            info.vertex_out(stages)
        info.fragment_out(0, declaration.output_type.upper(), declaration.output_name)
        if declaration.writes_depth:
            info.depth_write("ANY")
        info.vertex_source(vertex)
        info.fragment_source(fragment)
        stages = {"VertShader": (declaration.vertex_source, vertex), "FragShader": (declaration.fragment_source, fragment)}
        self.shader = device.compile(declaration, info, stages)
        self.bindings = _Bindings(device, declaration, self.shader)

    def draw(self, target: RenderTarget, viewport: tuple[int, int, int, int], draws: Sequence[Draw], /, **bindings: Any) -> None:
        if draws:
            self.device.run(self._draw, target, viewport, draws, bindings)

    def _draw(self, target: BlenderTarget, viewport: tuple[int, int, int, int], draws: Sequence[Draw], bindings: dict[str, Any]) -> None:
        state = self.device.gpu.state
        framebuffer = target.framebuffer.handle
        with self.device.restored_state(), framebuffer.bind():
            framebuffer.viewport_set(*viewport)
            state.blend_set("NONE")
            state.depth_test_set("LESS")
            state.depth_mask_set(True)
            self.bindings.bind({**bindings, **draws[0].constants})
            culling = None
            for draw in draws:
                # thousands of draws a batch: only what changes is said
                if draw.cull_back_faces is not culling:
                    culling = draw.cull_back_faces
                    state.face_culling_set("BACK" if culling else "NONE")
                for name, value in draw.constants.items():
                    self.bindings.set_constant(name, value)
                batch = cast(BlenderMesh, draw.mesh).batch
                if draw.triangle_range is None:
                    batch.draw_instanced(self.shader, instance_start=0, instance_count=draw.instance_count)
                else:
                    first, count = draw.triangle_range
                    batch.draw_range(self.shader, elem_start=3 * first, elem_count=3 * count)
        self.device.note_run(self)


class BlenderGpuDevice(Device):
    name = "gpu"
    stores_from_fragments = False  # nothing issues a barrier after a draw
    stores_from_geometry = False  # shaders have no such stage

    def __init__(self) -> None:
        try:
            import bpy  # gpu can only be imported once bpy is
            import gpu
        except ImportError as error:
            raise DeviceError(
                f"this Python has no Blender ({error}); use the device moderngl, or run: python -m pip install bpy"
            ) from error
        if bpy.app.version < (5, 2, 0):
            # in background there is none at all; in a window, arrays of what is read back are scrambled
            raise DeviceError(
                f"Blender {bpy.app.version_string} does not hand its graphics to scripts as VIR needs it, 5.2 and later do;"
                " use the device moderngl"
            )
        if bpy.app.background:
            if sys.platform == "linux" and bpy.context.preferences.system.gpu_backend == "OPENGL":
                _check_egl()
            _initialize(gpu)
        self.gpu = gpu
        self._thread_id = threading.get_ident()
        self._kernels: dict[tuple[str, tuple[str, ...]], Any] = {}
        self._started: set[Any] = set()
        self._call_depth = 0
        self.call_count = 0
        """calls from outside, one of which may hold many"""
        platform = gpu.platform
        self._describe(platform.renderer_get(), f"{platform.backend_type_get()} {platform.version_get()}")
        self.max_texture_size_px = int(gpu.capabilities.max_texture_size_get())
        self._fence = BlenderTexture(self, 1, 1, TextureFormat.RGBA32F)
        self._fence_target = _Framebuffer(self, color_slots=[self._fence.handle])

    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Blender's context belongs to one thread: a call from any other is refused."""
        if threading.get_ident() != self._thread_id:
            raise DeviceError(
                "Blender's gpu module works only on the thread that opened the device; use the device moderngl from other threads"
            )
        if self._call_depth == 0:
            free_put_by()
            self.call_count += 1
        self._call_depth += 1
        try:
            return function(*arguments)
        finally:
            self._call_depth -= 1

    def compile(self, declaration: KernelDeclaration, info: Any, stages: Mapping[str, tuple[str, str]]) -> Any:
        """stages: what Blender's console calls a stage -> file name and text"""
        try:
            return self.gpu.shader.create_from_info(info)
        except Exception as error:
            # Blender raises bare exceptions, and tells the reason only on the console: compile again and listen
            log: list[str] = []
            with contextlib.suppress(Exception), _console_output(STANDARD_OUTPUT, log):
                self.gpu.shader.create_from_info(info)
            text = "".join(log).strip() or str(error)
            raise DeviceError(shader_source.refusal(declaration.name, text, CONSOLE_LINE, stages)) from error

    @contextlib.contextmanager
    def restored_state(self) -> Iterator[None]:
        """Blender's interface draws with the same state. Culling cannot be asked for; nothing in Blender leaves it on."""
        state = self.gpu.state
        blend, depth_test, depth_mask = state.blend_get(), state.depth_test_get(), state.depth_mask_get()
        try:
            yield
        finally:
            state.blend_set(blend)
            state.depth_test_set(depth_test)
            state.depth_mask_set(depth_mask)
            state.face_culling_set("NONE")

    def compute_kernel(self, declaration: ComputeDeclaration, *flags: str) -> ComputeKernel:
        return self._kernel(BlenderComputeKernel, declaration, flags)

    def raster_kernel(self, declaration: RasterDeclaration, *flags: str) -> RasterKernel:
        return self._kernel(BlenderRasterKernel, declaration, flags)

    def geometry_kernel(self, declaration: GeometryDeclaration, *flags: str) -> GeometryKernel:
        raise DeviceError(f"kernel {declaration.name}: Blender's gpu module has no geometry shaders; choose the device moderngl")

    def create_texture(self, width: int, height: int, texture_format: TextureFormat) -> Texture:
        return self.run(BlenderTexture, self, width, height, texture_format)

    def upload_texture(self, texels: np.ndarray) -> Texture:
        height, width, _ = texels.shape
        return self.run(BlenderTexture, self, width, height, TextureFormat.RGBA32F, np.ascontiguousarray(texels, np.float32))

    def upload_mesh(self, positions: np.ndarray, triangles: np.ndarray) -> DeviceMesh:
        return self.run(BlenderMesh, self, positions, triangles)

    def create_target(self, color: Texture, depth: Texture) -> RenderTarget:
        return self.run(BlenderTarget, self, color, depth)

    def fill(self, texture: Texture, value: int) -> None:
        self.run(self._fill, texture, value)

    def _fill(self, texture: BlenderTexture, value: int) -> None:
        if texture.format is TextureFormat.DEPTH32F:
            framebuffer = self.gpu.types.GPUFrameBuffer(depth_slot=texture.handle)
            with self.restored_state(), framebuffer.bind():
                framebuffer.clear(depth=1.0)
        else:
            # the same 32 bits: the value of an unsigned texture is taken as a signed integer
            signed = value - (1 << 32) if value >> 31 else value
            texture.handle.clear(format="UINT", value=(signed,) * texture.format.channel_count)

    def read(self, texture: Texture) -> np.ndarray:
        return self.run(self._read, texture)

    def _read(self, texture: BlenderTexture) -> np.ndarray:
        if texture.format is TextureFormat.RG32UI:
            # Blender 5.2 converts these to float on the way
            raise DeviceError("Blender's gpu module cannot read RG32UI textures")
        shape = (texture.height, texture.width, texture.format.channel_count)
        # a copy: the Buffer's memory goes with the Buffer
        return np.array(texture.handle.read()).reshape(shape[:2] if shape[2] == 1 else shape)

    def finish(self) -> None:
        self.run(self._finish)

    def _finish(self) -> None:
        # There is no glFinish, but a read-back waits. Drawn to first: a driver that knows what each texture waits for (Mesa's
        # software rasterizer does not) might hand over an untouched one at once.
        framebuffer = self._fence_target.handle
        with self.restored_state(), framebuffer.bind():
            framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
        self._fence.handle.read()

    def close(self) -> None:
        self.run(self._kernels.clear)
        self._started.clear()
        self._fence_target.release()
        self._fence.release()


def _check_egl() -> None:
    """Without a driver that EGL can open, `gpu.init` ends the process instead of raising."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError as error:
        raise DeviceError(f"Blender finds no EGL ({error}); on Debian or Ubuntu run: {INSTALL_EGL}") from error
    egl.eglGetDisplay.argtypes, egl.eglGetDisplay.restype = [ctypes.c_void_p], ctypes.c_void_p
    egl.eglGetPlatformDisplay.argtypes, egl.eglGetPlatformDisplay.restype = [ctypes.c_uint] + [ctypes.c_void_p] * 2, ctypes.c_void_p
    egl.eglInitialize.argtypes = [ctypes.c_void_p] * 3
    # as Blender does: the default display, and where there is none, no surface at all
    display = egl.eglGetDisplay(None)
    if display and egl.eglInitialize(display, None, None):
        return
    display = egl.eglGetPlatformDisplay(EGL_PLATFORM_SURFACELESS, None, None)
    if not (display and egl.eglInitialize(display, None, None)):
        raise DeviceError(f"Blender finds no OpenGL driver through EGL; on Debian or Ubuntu run: {INSTALL_EGL}")


def _initialize(gpu: Any) -> None:
    """Give a Blender in background its context. Of what is printed meanwhile, refusals on the way to one that works are left out."""
    log: list[str] = []
    has_context = False
    try:
        with _console_output(STANDARD_ERROR, log):
            gpu.init()
        has_context = True
    except Exception as error:
        # Blender raises bare exceptions whose text is all there is to go by
        raise DeviceError(f"Blender found no usable GPU ({error}); use the device moderngl") from error
    finally:
        text = "".join(log)
        print(VERSION_PROBE.sub("", text) if has_context else text, end="", file=sys.stderr)


@contextlib.contextmanager
def _console_output(descriptor: int, log: list[str]) -> Iterator[None]:
    """Appends to `log` what the whole process writes to its standard output (1) or error (2) meanwhile, C and C++ included."""
    try:
        console = os.dup(descriptor)
    except OSError:
        # closed: nobody would have read it
        yield
        return
    with tempfile.TemporaryFile() as file:
        stream = sys.stdout if descriptor == STANDARD_OUTPUT else sys.stderr
        if stream is not None:
            stream.flush()
        os.dup2(file.fileno(), descriptor)
        try:
            yield
        finally:
            os.dup2(console, descriptor)
            os.close(console)
            file.seek(0)
            log.append(file.read().decode(errors="replace"))
