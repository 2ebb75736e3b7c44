"""Random calls of the C of native FMUs under sanitisers; native_calls.c says what must hold."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Literal

from fmu_export.modelling.model_class import AnyModel
from fmu_export.native.backend import build_native
from tests.support import SUPPORT
from tests.support.native_fmus import unpack
from tests.support.patience import PATIENCE

SANITISERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def compile_calls(
    model: AnyModel, flavour: Literal["fmi2", "fmi3"], folder: Path, compiler: str, *, arrays: bool = False
) -> tuple[Path, str]:
    """The program with the sources of an FMU, which is built in a folder, and the resources that it takes.

    Raises
    ------
    RuntimeError
        It can't be compiled.
    """
    fmu = unpack(build_native(model, folder, flavour, reference=False, arrays=arrays), folder / "fmu")
    sources = fmu / "sources"
    files = sorted(path.name for path in sources.glob("*.c"))
    options = [
        "-std=gnu99",
        "-g",
        "-O1",
        "-Wall",
        "-Wextra",
        "-Werror",
        *SANITISERS,
        f"-DFMI_VERSION={flavour[-1]}",
        "-I.",
    ]
    command = [
        compiler,
        *options,
        *files,
        str(SUPPORT / "native_calls.c"),
        "-o",
        str(folder.resolve() / "calls"),
        "-lm",
    ]
    done = subprocess.run(command, cwd=sources, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr[-3000:])
    resources = (fmu / "resources").resolve()
    return folder / "calls", resources.as_uri() if flavour == "fmi2" else str(resources)


def make_calls(program: Path, resources: str, calls: int, seed: int, patience: float = PATIENCE) -> tuple[int, str]:
    """How many calls were made, and what was wrong, which is nothing as a rule."""
    done = subprocess.run(
        [program, resources, str(calls), str(seed)],
        capture_output=True,
        text=True,
        errors="replace",
        timeout=patience,
        check=False,
    )
    made = re.match(r"(\d+) calls", done.stdout)
    return int(made[1]) if made else 0, "" if made and done.returncode == 0 else done.stderr[-3000:] or str(
        done.returncode
    )
