"""The boundaries between the folders, read from the sources: who may import whom and where shader text may stand."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

PACKAGE_FOLDER = Path(__file__).resolve().parent.parent / "vir_addon"
BLENDER_MODULES = {"bpy", "bpy_extras", "bmesh", "mathutils", "addon_utils", "idprop", "imbuf"}
GPU_MODULES = {"moderngl", "glcontext", "gpu", "gpu_extras"}
BLENDER_GPU_DEVICE = "device/blender_gpu_device.py"
BACKENDS = {"device.moderngl_device", "device.blender_gpu_device"}
GLSL = re.compile(
    r"#version\s+\d|\bvoid\s+main\s*\(|\blayout\s*\(|\bgl_(Position|FragCoord|GlobalInvocationID|PrimitiveID)\b|\buniform\s+\w+\s+\w+\s*;"
)


def sources() -> list[Path]:
    return sorted(PACKAGE_FOLDER.rglob("*.py"))


def outside_imports(tree: ast.AST) -> set[str]:
    """First parts of the names of absolutely imported modules, imports inside functions included."""
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and not node.level and node.module}
    return {name.split(".")[0] for name in names}


def inside_imports(tree: ast.AST, path: Path) -> set[str]:
    """Modules of this package that are imported relatively, as "core.errors"; a name taken from a module counts as its module."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = path.relative_to(PACKAGE_FOLDER).parent.parts
            base = [*folder[: len(folder) - (node.level - 1)], *(node.module.split(".") if node.module else [])]
            for alias in node.names:
                deeper, as_module = PACKAGE_FOLDER.joinpath(*base, alias.name), ".".join([*base, alias.name])
                is_module = as_module in BACKENDS or deeper.is_dir() or deeper.with_suffix(".py").exists()
                found.add(as_module if is_module else ".".join(base))
    return found


def violations(path: Path, source: str) -> list[str]:
    """One sentence for every rule that `source`, standing at `path` inside the package, breaks."""
    name = path.relative_to(PACKAGE_FOLDER).as_posix()
    top = name.split("/")[0]
    tree = ast.parse(source)
    outside, inside = outside_imports(tree), inside_imports(tree, path)
    inside_tops = {module.split(".")[0] for module in inside}
    found = []
    if "vir_addon" in outside:
        found.append("imports vir_addon by name; inside an extension only relative imports work")
    if top != "blender" and name != BLENDER_GPU_DEVICE and outside & BLENDER_MODULES:
        found.append(f"imports {sorted(outside & BLENDER_MODULES)}; only vir_addon/blender does")
    if top != "blender" and name != BLENDER_GPU_DEVICE and "gpu" in outside:
        found.append(f"imports gpu; only vir_addon/blender and {BLENDER_GPU_DEVICE} do")
    if top not in ("device", "blender", "__main__.py") and outside & GPU_MODULES:
        found.append(f"imports {sorted(outside & GPU_MODULES)}; only vir_addon/device does")
    if top == "core" and inside_tops & {"blender", "analysis", "__main__"}:
        found.append("core imports what calls it")
    if top == "device" and inside_tops - {"device", "core", "resources", ""}:
        found.append("device imports what calls it")
    if top == "device" and {module for module in inside if module.startswith("core")} - {"core.errors"}:
        found.append("device imports more of core than its errors")
    if name.startswith(("core/passes/", "core/methods/")) and inside & BACKENDS:
        found.append("a pass or method imports a backend instead of the device's interface")
    if name.startswith("core/passes/") and any(module.startswith("core.methods") for module in inside):
        found.append("a pass imports a method")
    if name.startswith("core/passes/") and any(module.startswith("core.reflections") for module in inside):
        found.append("a pass imports what decides about reflections")
    if name.startswith("blender/materials/") and any(not module.startswith(("blender.materials", "core")) for module in inside):
        found.append("the reading of materials imports more than terms of core")
    found += [f"line {line}: GLSL belongs into gpu_shaders/" for line in glsl_lines(tree)]
    return found


def glsl_lines(tree: ast.AST) -> list[int]:
    """Lines of string constants that look like shader code; docstrings may speak of it."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, documented) and node.body and isinstance(node.body[0], ast.Expr)
    }
    strings = [
        node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings
    ]
    return [node.lineno for node in strings if len(GLSL.findall(node.value)) >= (1 if "\n" in node.value else 2)]


@pytest.mark.parametrize("path", sources(), ids=lambda path: path.relative_to(PACKAGE_FOLDER).as_posix())
def test_source_keeps_to_its_folder(path):
    assert violations(path, path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("core/a.py", "def f():\n    import bpy"),
        ("core/a.py", "from mathutils import Vector"),
        ("analysis/a.py", "import bpy.types"),
        ("core/a.py", "import moderngl"),
        ("core/a.py", "from gpu.types import GPUShader"),
        ("device/moderngl_device.py", "import gpu"),
        ("device/a.py", "import bpy"),
        ("blender/a.py", "from vir_addon.core import plan"),
        ("core/a.py", "from ..blender import extract"),
        ("core/a.py", "from .. import analysis"),
        ("device/a.py", "from ..core.plan import plan"),
        ("core/passes/a.py", "from ...device.moderngl_device import Device"),
        ("core/methods/a.py", "from ...device import blender_gpu_device"),
        ("core/passes/a.py", "from ..methods import mvr"),
        ("core/passes/a.py", "from ..reflections.views import looks"),
        ("blender/materials/a.py", "from ..extract.mesh import extract_mesh"),
        ("core/a.py", 'SHADER = """\n#version 430\n"""'),
        ("device/a.py", 'SHADER = "void main() { gl_Position = vec4(0); }"'),
    ],
)
def test_the_rules_notice(name, source):
    assert violations(PACKAGE_FOLDER / name, source)


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("blender/a.py", "import bpy, gpu\nfrom ..core import plan"),
        ("device/blender_gpu_device.py", "import gpu, bpy\nfrom ..core.errors import DeviceError"),
        ("core/passes/a.py", "from ...device.interface import Device"),
        ("core/a.py", '"""Makes #version lines for void main()."""'),
    ],
)
def test_the_rules_allow(name, source):
    assert violations(PACKAGE_FOLDER / name, source) == []
