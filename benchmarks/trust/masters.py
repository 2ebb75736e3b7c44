"""The masters that are given the corpus: the program `cosim`, FMPy, libcosim, Ecos."""

from __future__ import annotations

import subprocess
from importlib.util import find_spec
from pathlib import Path

from benchmarks.trust.trial import Master, python
from interop.tools import ecos, libcosim
from tests.support.corpus import Case

_FMPY = """
import sys
import fmpy
path, out = sys.argv[1:]
if path.endswith(".ssp"):
    from fmpy.ssp.simulation import simulate_ssp
    result = simulate_ssp(path, stop_time=1.0, step_size=0.1)
else:
    result = fmpy.simulate_fmu(path, output_interval=0.1, fmi_type="CoSimulation")
fmpy.write_csv(out, result)
"""

_LIBCOSIM = """
import sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
path, out = sys.argv[1:]
if path.endswith(".ssp"):
    execution = CosimExecution.from_ssp_file(ssp_path=path, step_size=100_000_000)
else:
    execution = CosimExecution.from_step_size(100_000_000)
    execution.add_local_slave(CosimLocalSlave(fmu_path=path, instance_name="x"))
execution.add_observer(observer=CosimObserver.create_to_dir(log_dir=out))
sys.exit(not execution.step(step_count=10))
"""

_ECOS = """
import sys
from ecospy import EcosSimulation, EcosSimulationStructure
path, out = sys.argv[1:]
with EcosSimulationStructure() as structure:
    structure.add_model("x", path)
    with EcosSimulation(structure=structure, step_size=0.1) as simulation:
        simulation.add_csv_writer(out)
        simulation.init()
        simulation.step(10)
        simulation.terminate()
"""


def _program(*options: str) -> Master:
    """The program itself."""

    def command(case: Case, path: Path, out: Path) -> list[str]:
        if case.kind == "reference":
            where = ("--fmu", path, "--fmu-reference", path.parent)
            return python("-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", path.parent, *where)
        return python("-m", "cosim", "run", path, "--out", out, *case.arguments, *options)

    kinds = ("archive", "system", "scenario") if options else ("archive", "system", "scenario", "reference")
    return Master(" ".join(("cosim run", *options)), kinds, command)


def _script(name: str, source: str, *kinds: str) -> Master:
    def command(_: Case, path: Path, out: Path) -> list[str]:
        if name != "FMPy":
            out.mkdir()
        return python("-c", source, path, out / "results.csv" if name == "Ecos" else out)

    return Master(name, kinds, command, results="*")


def masters() -> tuple[list[Master], dict[str, str]]:
    """Those that can run here, and why the others can't."""
    found = [_program()]
    options = subprocess.run(python("-m", "cosim", "run", "--help"), capture_output=True, text=True, check=True).stdout
    if "--isolated" in options:
        found.append(_program("--isolated", "--step-timeout", "10"))
    missing = {}
    for name, source, kinds, why in (
        ("FMPy", _FMPY, ("archive", "ssp"), None if find_spec("fmpy") else "pip install fmpy"),
        ("libcosim", _LIBCOSIM, ("archive", "ssp"), libcosim.unavailable()),
        ("Ecos", _ECOS, ("archive",), ecos.unavailable()),
    ):
        if why is None:
            found.append(_script(name, source, *kinds))
        else:
            missing[name] = why
    return found, missing
