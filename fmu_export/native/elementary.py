"""The elementary functions that FMUs bring along, so that they compute the same on every platform.

Sine and cosine are the project's own (`c_adapter/sines.h`), the others files of musl (`libm/`). Square roots, absolute
values, remainders, floors and ceilings have one right result, which every platform gives.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from importlib.resources import files

from fmu_export.errors import needs
from fmu_export.trace.graph import SINES
from fmu_export.trace.instructions import operations_of

with needs("export"):
    import casadi as ca

#: Functions of CasADi's operations, by the names of musl's files.
FUNCTIONS = {
    ca.OP_ACOS: "acos",
    ca.OP_ACOSH: "acosh",
    ca.OP_ASIN: "asin",
    ca.OP_ASINH: "asinh",
    ca.OP_ATAN: "atan",
    ca.OP_ATAN2: "atan2",
    ca.OP_ATANH: "atanh",
    ca.OP_CONSTPOW: "pow",
    ca.OP_COSH: "cosh",
    ca.OP_EXP: "exp",
    ca.OP_EXPM1: "expm1",
    ca.OP_HYPOT: "hypot",
    ca.OP_LOG: "log",
    ca.OP_LOG1P: "log1p",
    ca.OP_POW: "pow",
    ca.OP_SINH: "sinh",
    ca.OP_TAN: "tan",
    ca.OP_TANH: "tanh",
}

#: What the functions are called in C: a compiler takes the standard's names for functions that it knows.
PREFIX = "libm_"

#: What each file calls or includes besides libm.h.
_NEEDS = {
    "__expo2": ("exp",),
    "__math_oflow": ("__math_xflow",),
    "__math_uflow": ("__math_xflow",),
    "__rem_pio2": ("__rem_pio2_large",),
    "acosh": ("acosh_domain", "log", "log1p"),
    "asinh": ("log", "log1p"),
    "atan2": ("atan",),
    "atanh": ("log1p",),
    "cosh": ("__expo2", "exp", "expm1"),
    "exp": ("__math_oflow", "__math_uflow", "exp_data", "exp_data.h"),
    "log": ("__math_divzero", "__math_invalid", "log_data", "log_data.h"),
    "pow": ("__math_invalid", "__math_oflow", "__math_uflow", "exp_data", "exp_data.h", "pow_data", "pow_data.h"),
    "sinh": ("__expo2", "expm1"),
    "tan": ("__rem_pio2", "__tan"),
    "tanh": ("expm1",),
}

_FOLDER = "libm"


def declarations(functions: Iterable[ca.Function]) -> str:
    """What the C of traced functions has to include and declare."""
    used = set().union(*map(operations_of, functions))
    arguments = {"atan2": "double, double", "hypot": "double, double", "pow": "double, double"}
    names = sorted({FUNCTIONS[operation] for operation in used & FUNCTIONS.keys()})
    lines = ['#include "sines.h"\n'] if used & set(SINES) else []
    return "".join([*lines, *(f"double {PREFIX}{name}({arguments.get(name, 'double')});\n" for name in names)])


def elementary_sources(*sources: bytes) -> dict[str, bytes]:
    """The files that C sources with these declarations need, by their names beside them."""
    text = b"\n".join(sources).decode()
    found = {"sines.h": _read("c_adapter/sines.h")} if '#include "sines.h"' in text else {}
    names = _closure(set(re.findall(rf"\b{PREFIX}(\w+)\(", text)))
    if not names:
        return found
    for unit in _units([name for name in names if not name.endswith(".h")]):
        includes = "".join(f'#include "{name}.inc"\n' for name in unit)
        found[f"{PREFIX}{unit[0].strip('_')}.c"] = f'#include "libm.h"\n{includes}'.encode()
    for name in ("libm.h", *names):
        ending = "" if name.endswith(".h") else ".inc"  # no .c, for it is not compiled by itself
        found[name + ending] = _read(f"{_FOLDER}/{name}{ending and '.c'}")
    return found


def licences(sources: Iterable[str]) -> dict[str, bytes]:
    """Licences of the files of others among sources with these names, by their names in the archive."""
    return {"documentation/licenses/musl.txt": _read(f"{_FOLDER}/COPYRIGHT")} if "libm.h" in sources else {}


def _closure(names: set[str]) -> list[str]:
    """Files and all that they need, sorted."""
    found: set[str] = set()
    new = set(names)
    while new:
        found |= new
        new = {needed for name in new for needed in _NEEDS.get(name, ())} - found
    return sorted(found)


def _units(names: list[str]) -> list[list[str]]:
    """Files that can be compiled as one: none defines for itself what another one names."""
    units: list[list[str]] = []
    for name in names:
        for unit in units:
            if not any(_own(a) & _words(b) for other in unit for a, b in ((name, other), (other, name))):
                unit.append(name)
                break
        else:
            units.append([name])
    return units


def _words(name: str) -> set[str]:
    return set(re.findall(r"\w+", _code(name)))


def _own(name: str) -> set[str]:
    """Names that a file defines for itself: macros, static functions, static constants."""
    code = _code(name)
    macros = re.findall(r"^#define\s+(\w+)", code, re.MULTILINE)
    functions = re.findall(r"^static[\w\s*]*?(\w+)\s*\(", code, re.MULTILINE)
    constants = re.findall(r"(\w+)\s*(?:\[[^]]*\]\s*)*=", "".join(re.findall(r"^static\s+const[^;]*;", code, re.M)))
    return {*macros, *functions, *constants}


@cache
def _code(name: str) -> str:
    """Text of a file without comments."""
    return re.sub(r"/\*.*?\*/|//[^\n]*", "", _read(f"{_FOLDER}/{name}.c").decode(), flags=re.DOTALL)


@cache
def _read(path: str) -> bytes:
    return (files("fmu_export.native") / path).read_bytes()
