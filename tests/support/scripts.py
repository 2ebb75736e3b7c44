"""FMUs that run scripts, built for tests: by `build_script`, and by pythonfmu's own builder."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from textwrap import dedent

from fmu_export import build_script
from tests.support.patience import PATIENCE

#: A slave with Real outputs, as `<name> = ...` in what a test gives as the body of `do_step`.
_SLAVE = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real
{head}


class {name}(Fmi2Slave):
    def __init__(self, **arguments):
        super().__init__(**arguments)
        for output in {outputs!r}:
            setattr(self, output, 0.0)
            self.register_variable(Real(output, causality=Fmi2Causality.output))
{init}

    def do_step(self, t, h):
{step}
        return True
"""


def slave(step: str, head: str = "", init: str = "", name: str = "Script", outputs: tuple[str, ...] = ("y",)) -> str:
    """A script whose class has some outputs and this body of `do_step`."""

    def indented(text: str) -> str:
        return "\n".join(f"        {line}" for line in dedent(text).strip("\n").splitlines())

    return _SLAVE.format(head=dedent(head), name=name, outputs=outputs, init=indented(init), step=indented(step))


def written(folder: Path, script: str, files: Mapping[str, str] = {}) -> tuple[Path, list[Path]]:
    """`script.py` in a folder, with other files; returns its path, and those of files and folders beside it."""
    for name, text in {"script.py": script, **files}.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(dedent(text), encoding="utf-8")
    return folder / "script.py", sorted({folder / name.partition("/")[0] for name in files})


def scripted(folder: Path, script: str, files: Mapping[str, str] = {}) -> Path:
    """The FMU of a script with other files, by `build_script`."""
    path, others = written(folder, script, files)
    return build_script(path, folder / "built", files=others)


def stock(folder: Path, script: str, files: Mapping[str, str] = {}) -> Path:
    """The same by pythonfmu's own builder, in a process of its own."""
    path, others = written(folder, script, files)
    target = folder / "stock"
    target.mkdir()
    command = [
        sys.executable,
        "-I",
        "-m",
        "pythonfmu",
        "build",
        "-f",
        path.name,
        "-d",
        target,
        *[o.name for o in others],
    ]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    (fmu,) = target.glob("*.fmu")
    return fmu


#: Runs FMUs together in cosim, several times, in a process that can't import what lies beside the scripts.
_COSIM = """
import json, sys
from cosim import System, simulate

for _ in range(3):
    system = System()
    for i, fmu in enumerate(sys.argv[1:]):
        system.add(f"c{i}", fmu)
    results = simulate(system, 0.2, 0.1)
print(json.dumps({name: float(results[name][-1]) for name in results.names}))
"""


def in_cosim(folder: Path, *fmus: Path, script: str = _COSIM, **environment: str) -> str:
    """What a new process prints that runs a script (by default three runs of all FMUs in one system)."""
    import os

    folder.mkdir(parents=True, exist_ok=True)
    done = subprocess.run(
        [sys.executable, "-I", "-X", "faulthandler", "-c", script, *fmus],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout
