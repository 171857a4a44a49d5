"""Counts what is alive on a GPU: everything that either device makes passes through here."""

from __future__ import annotations

import gc
import sys
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

import moderngl

BLENDERS = ("GPUTexture", "GPUVertBuf", "GPUIndexBuf", "GPUBatch", "GPUFrameBuffer", "GPUOffScreen", "GPUUniformBuf")
MODERNGLS = ("texture", "depth_texture", "buffer", "framebuffer", "vertex_array", "compute_shader", "program", "query")


def _references(entries: list[tuple[str, Any, Any]], index: int) -> int:
    return sys.getrefcount(entries[index][1])


_OWN_REFERENCES = _references([("", object(), None)], 0)
"""to what nobody else holds"""


class Living:
    """What was made since, by kind. Blender frees an object with its last Python reference, moderngl when it is told to."""

    def __init__(self, monkeypatch) -> None:
        self.made_count = 0
        self._made: list[tuple[str, Any, Any]] = []
        """kind, object, and the moderngl context that it goes with"""
        import gpu

        for name in BLENDERS:
            monkeypatch.setattr(gpu.types, name, self._recording(name, getattr(gpu.types, name)))
        monkeypatch.setattr(gpu.shader, "create_from_info", self._recording("GPUShader", gpu.shader.create_from_info))
        for name in MODERNGLS:
            monkeypatch.setattr(moderngl.Context, name, self._recording_method(name, getattr(moderngl.Context, name)))
        monkeypatch.setattr(moderngl, "create_context", self._recording("context", moderngl.create_context))

    def _note(self, kind: str, made: Any, context: Any) -> None:
        self.made_count += 1
        self._made.append((kind, made, context))

    def _recording(self, kind: str, make: Callable[..., Any]) -> Callable[..., Any]:
        def recorded(*arguments: Any, **options: Any) -> Any:
            made = make(*arguments, **options)
            self._note(kind, made, None)
            return made

        return recorded

    def _recording_method(self, kind: str, make: Callable[..., Any]) -> Callable[..., Any]:
        def recorded(context: Any, *arguments: Any, **options: Any) -> Any:
            made = make(context, *arguments, **options)
            self._note(kind, made, context)
            return made

        return recorded

    def count(self, unused: tuple[Any, ...] = ()) -> Counter[str]:
        """Kind -> how many are alive. unused: handles that a pool keeps, which do not count"""
        gc.collect()
        before = -1
        while len(self._made) != before:  # what is dead holds others
            before = len(self._made)
            self._made = [self._made[index] for index in range(before) if self._is_alive(index)]
        kept = {id(handle) for handle in unused}
        return Counter(kind for kind, made, _ in self._made if id(made) not in kept)

    def _is_alive(self, index: int) -> bool:
        if self._made[index][0].startswith("GPU"):
            return _references(self._made, index) > _OWN_REFERENCES
        _, made, context = self._made[index]
        return not any(isinstance(each.mglo, moderngl.InvalidObject) for each in (made, context or made))


def threads() -> set[str]:
    """Names and numbers: two may have the same name."""
    return {f"{thread.name} {thread.ident}" for thread in threading.enumerate() if "vir" in thread.name}
