"""Composes every variant of every kernel and checks it against its declaration, without a GPU.

    python -m vir_addon.device.check_shaders

Not a compiler: what it finds are files and includes that are missing, interface names that nobody uses, names of the
interface that are used but not declared, and conditions on flags that no declaration has.
"""

from __future__ import annotations

import importlib
import itertools
import pkgutil
import re
import sys
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from ..core.errors import DeviceError
from . import shader_source
from .declaration import ComputeDeclaration, GeometryDeclaration, KernelDeclaration, RasterDeclaration

PASSES_PACKAGE = f"{__package__.rpartition('.')[0]}.core.passes"
CONDITION = re.compile(r"^\s*#\s*(ifdef|ifndef|if|elif|else|endif)\b\s*(\w*)")
DEFINE = re.compile(r"^\s*#\s*define\s+(\w+)")
COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
IDENTIFIER = re.compile(r"(?<![.\w])[A-Za-z_]\w*")
LOCAL = re.compile(r"\b(?:void|bool|u?int|float|[biu]?vec[234]|mat[234]|[A-Z]\w*)\s+(\w+)")
"""A variable, parameter or function of a built-in type or of a struct, whose names start with a capital."""


class Variant(NamedTuple):
    """What one choice of flags leaves of a kernel's bodies."""

    used: frozenset[str]
    """identifiers, macros' replacements included"""
    used_directly: frozenset[str]
    """identifiers outside of macros: a macro that is never used may name what is not there"""
    own: frozenset[str]
    """names that the bodies themselves declare or define"""
    line_count: int


def declarations() -> list[KernelDeclaration]:
    """Every kernel declaration in a module of core/passes."""
    passes = importlib.import_module(PASSES_PACKAGE)
    names = [f"{PASSES_PACKAGE}.{module.name}" for module in pkgutil.iter_modules(passes.__path__)]
    found: dict[int, KernelDeclaration] = {}
    for name in names:
        values = vars(importlib.import_module(name)).values()
        # a declaration that one module imports from another is one
        found |= {id(value): value for value in values if isinstance(value, KernelDeclaration)}
    return list(found.values())


def bodies(declaration: KernelDeclaration) -> list[str]:
    if isinstance(declaration, ComputeDeclaration):
        return [shader_source.load(declaration.source)]
    if isinstance(declaration, GeometryDeclaration):
        return [shader_source.load(declaration.geometry_source), shader_source.load(declaration.fragment_source)]
    assert isinstance(declaration, RasterDeclaration)
    return [shader_source.load(declaration.vertex_source), shader_source.load(declaration.fragment_source)]


def active_lines(text: str, defined: Iterable[str]) -> Iterator[str]:
    """Lines that #ifdef and #ifndef leave standing. Both branches of an #if with an expression stand."""
    known = set(defined)
    branches: list[bool | None] = []  # None: an expression, not evaluated
    for line in text.splitlines():
        condition = CONDITION.match(line)
        if not condition:
            if False not in branches:
                define = DEFINE.match(line)
                known |= {define[1]} if define else set()
                yield line
            continue
        keyword, name = condition.groups()
        if keyword == "endif":
            branches.pop()
        elif keyword in ("ifdef", "ifndef"):
            branches.append((name in known) == (keyword == "ifdef"))
        elif keyword == "else":
            branches[-1] = None if branches[-1] is None else not branches[-1]
        elif keyword == "elif":
            branches[-1] = None
        else:
            branches.append(None)


def conditions(text: str) -> set[str]:
    """Names that #ifdef and #ifndef ask for."""
    matches = filter(None, map(CONDITION.match, text.splitlines()))
    return {match[2] for match in matches if match[1] in ("ifdef", "ifndef")}


def variant(declaration: KernelDeclaration, flags: Iterable[str]) -> Variant:
    used, used_directly, own, line_count = set[str](), set[str](), set[str](), 0
    for body in bodies(declaration):
        lines = list(active_lines(COMMENT.sub("", body), [*flags, *declaration.defines]))
        text = "\n".join(lines)
        used |= set(IDENTIFIER.findall(text))
        used_directly |= set(IDENTIFIER.findall("\n".join(line for line in lines if not DEFINE.match(line))))
        own |= set(LOCAL.findall(text)) | {match[1] for match in map(DEFINE.match, lines) if match}
        line_count += len(lines)
    return Variant(frozenset(used), frozenset(used_directly), frozenset(own), line_count)


def interface_names(declaration: KernelDeclaration) -> frozenset[str]:
    names = declaration.binding_names | set(declaration.defines)
    if isinstance(declaration, RasterDeclaration):
        names |= {"position_os"}
    if isinstance(declaration, (RasterDeclaration, GeometryDeclaration)):
        names |= {declaration.output_name, *declaration.varyings}
    return names


def check(declaration: KernelDeclaration, all_names: frozenset[str]) -> tuple[list[str], int]:
    """Problems, each a sentence without the kernel's name, and how many variants were composed.

    all_names: interface names of all kernels, those that a body may name by mistake
    """
    own_names = interface_names(declaration)
    subsets = [flags for count in range(len(declaration.flags) + 1) for flags in itertools.combinations(declaration.flags, count)]
    try:
        variants = {flags: variant(declaration, flags) for flags in subsets}
        asked = set().union(*(conditions(body) for body in bodies(declaration)))
    except DeviceError as error:
        return [str(error)], 0
    used = frozenset().union(*(variant.used for variant in variants.values()))
    # a define may only choose between branches
    problems = [f"nothing uses {name}" for name in sorted(own_names - used - (asked & set(declaration.defines)))]
    problems += [f"no condition asks for the flag {flag}" for flag in sorted(set(declaration.flags) - asked)]
    for flags, found in variants.items():
        stray = (found.used_directly & all_names) - own_names - found.own
        problems += [f"with flags {list(flags)}: {name} is used but not declared" for name in sorted(stray)]
    return problems, len(variants)


def main() -> int:
    found = declarations()
    all_names = frozenset().union(*(interface_names(declaration) for declaration in found))
    known_conditions = {name for declaration in found for name in (*declaration.flags, *declaration.defines)}
    failed = False
    by_name: dict[str, KernelDeclaration] = {}
    for declaration in found:
        problems, variant_count = check(declaration, all_names)
        if declaration.name in by_name:
            # devices keep compiled kernels by name
            problems.append("another kernel has the same name")
        if variant_count:
            unknown = set().union(*(conditions(body) for body in bodies(declaration))) - known_conditions
            problems += [f"no kernel has the flag {name}" for name in sorted(unknown)]
        by_name[declaration.name] = declaration
        print(f"{declaration.name}: {variant_count} variants, {'; '.join(problems) or 'well'}")
        failed |= bool(problems)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
