"""The entry of an FMU that runs a script: what pythonfmu's binary starts in place of the script.

`script_slave` says why there is one. It needs the standard library only, so that a master can give it to archives
that others have made, too.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

#: How the entry of an archive begins; of other archives the binary runs the script itself.
ENTRY_BEGINS = '"""Entry of the FMU '

#: Ends of the names of files that hold modules.
_CODE = (".py", ".pyw", ".pyc")
_COMPILED = (".so", ".pyd", ".dylib")

#: The file that names the module which the binary starts.
MODULE_FILE = "slavemodule.txt"

_ENTRY = '''{begins}{name}; generated, do not edit."""

import ctypes

from {runtime}.script_slave import Fmi2Slave, new_instance

# pythonfmu's binary runs this file at every instantiation and then drops a reference to this dictionary that it does
# not own; without this line it is freed at the second instantiation.
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))
new_instance()


class {name}(Fmi2Slave):
    script = {script!r}
    slave = {slave!r}
    bundle = {bundle!r}
'''


def bundle_of(resources: Mapping[str, bytes]) -> dict[str, Any]:
    """Names of the modules among resources; `script_slave.namespace_of` says what is what."""
    parts: dict[str, list[str]] = {}
    for path in sorted(resources):
        top = path.partition("/")[0]
        name = top if "/" in path else path.partition(".")[0]  # a compiled one is called name.cpython-311-....so
        if is_module(path) and name.isidentifier() and (path.endswith(_CODE) or _is_compiled(path, resources[path])):
            parts.setdefault(name, []).append(path)
    compiled = {n for n, paths in parts.items() if any(_is_compiled(p, resources[p]) for p in paths)}
    libraries = {"pythonfmu"} & parts.keys() - compiled
    return {
        "modules": sorted(parts.keys() - compiled - libraries),
        "libraries": {n: _digest({p: resources[p] for p in parts[n]}) for n in sorted(libraries)},
        "compiled": {n: _digest({p: resources[p] for p in parts[n]}) for n in sorted(compiled)},
    }


def entry_members(name: str, script: str, resources: Mapping[str, bytes], slave: str = "") -> dict[str, bytes]:
    """What to put into the resources, so that the binary starts a script by way of an entry.

    Parameters
    ----------
    name : str
        The FMU's name.
    script : str
        The script's module name.
    resources : mapping of str to bytes
        The other resources, or those that are modules, by their path in the folder of resources.
    slave : str, optional
        Name of the script's slave class; otherwise that furthest down from Fmi2Slave.
    """
    package = {"__init__.py": b""}
    package |= {f"{n}.py": Path(__file__).with_name(f"{n}.py").read_bytes() for n in ("script_slave", "life_cycle")}
    runtime = f"script_slave_{_digest(package)}"
    identifier = re.sub(r"\W", "_", name)
    text = _ENTRY.format(
        begins=ENTRY_BEGINS,
        name=identifier,
        runtime=runtime,
        script=script,
        slave=slave,
        bundle=bundle_of(resources),
    )
    # FMUs of one process share sys.modules: the name of the entry says what is in it
    entry = f"{identifier}_{_digest({'entry': text.encode()})}"
    members = {f"{runtime}/{file}": content for file, content in package.items()}
    return {**members, f"{entry}.py": text.encode(), MODULE_FILE: entry.encode()}


def _digest(files: Mapping[str, bytes]) -> str:
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(f"{name}\0{len(files[name])}\0".encode() + files[name])
    return digest.hexdigest()[:16]


def is_module(path: str) -> bool:
    """Whether a resource may be a module of Python, by its path."""
    return path.endswith((*_CODE, *_COMPILED)) and "__pycache__/" not in path


def _is_compiled(path: str, content: bytes) -> bool:
    """Whether a file is a compiled module of Python; other libraries may lie in an archive, too."""
    return path.endswith(_COMPILED) and b"PyInit_" in content
