"""What is tried: which tool runs which files, how it exchanges values, and where it is known to fail."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

#: How a tool exchanges values at the communication points; the tolerance follows from it, see `verdict`.
Exchange = Literal["sequential", "parallel", "own", "none", "solver"]
#: Three FMUs that the tool connects, the closed loop in one FMU, or the three in an SSP.
Files = Literal["three FMUs", "one FMU", "SSP"]


@dataclass(frozen=True)
class Entry:
    """One cell of the matrix.

    Attributes
    ----------
    tool : str
        Module of `interop.tools`.
    files : str
    flavour : str
    exchange : str
        "sequential" and "parallel": as our master in that order, inputs held; "own": some other first-order exchange;
        "none": one FMU, which integrates itself; "solver": one FMU, which the tool integrates.
    fails : str
        Known failure: what happens, whose fault it is, and the way round it; empty where it runs.
    quick : bool
        Part of the tests.
    """

    tool: str
    files: Files
    flavour: str
    exchange: Exchange
    fails: str = ""
    quick: bool = False


_NO_PYTHON = (
    "the host is no Python: `undefined symbol: _Py_NoneStruct`; pythonfmu's wrapper does not link libpython. Take a "
    "native flavour, or start the host with LD_PRELOAD of libpython"
)
_ONLY_FMI_2 = "the tool knows FMI 1.0 and 2.0 only; take fmi2"

ENTRIES: tuple[Entry, ...] = (
    *(Entry("fmpy_loop", "three FMUs", f, "sequential") for f in ("fmi2", "fmi3", "pythonfmu")),
    *(Entry("fmpy_cli", "one FMU", f, "none") for f in ("fmi2", "fmi3", "pythonfmu")),
    Entry("fmpy_me", "one FMU", "fmi2", "solver", quick=True),
    Entry("fmpy_me", "one FMU", "fmi3", "solver"),
    Entry("fmpy_container", "three FMUs", "fmi2", "sequential", quick=True),
    Entry("fmpy_container", "three FMUs", "fmi3", "sequential"),
    Entry("fmpy_container", "three FMUs", "pythonfmu", "sequential"),
    Entry("fmpy_ssp", "SSP", "fmi2", "own", quick=True),
    Entry("fmu_toolbox", "three FMUs", "fmi2", "parallel", quick=True),
    Entry("fmu_toolbox", "three FMUs", "fmi3", "parallel", quick=True),
    Entry("fmu_toolbox", "three FMUs", "pythonfmu", "parallel"),
    *(Entry("fmu_toolbox_sequential", "three FMUs", f, "own") for f in ("fmi2", "fmi3", "pythonfmu")),
    Entry("fmu_toolbox_ssp", "SSP", "fmi2", "parallel", quick=True),
    Entry("ecos", "three FMUs", "fmi2", "parallel", quick=True),
    Entry("ecos", "three FMUs", "fmi3", "parallel", quick=True),
    Entry("ecos", "three FMUs", "pythonfmu", "parallel"),
    Entry("ecos", "one FMU", "fmi3", "none"),
    Entry("ecos_ssp", "SSP", "fmi2", "parallel", quick=True),
    Entry("libcosim", "three FMUs", "fmi2", "parallel", quick=True),
    Entry("libcosim", "three FMUs", "pythonfmu", "parallel"),
    Entry(
        "libcosim",
        "three FMUs",
        "fmi3",
        "parallel",
        "its FMI Library knows FMI 1.0 and 2.0 only (`cosim_last_error_message`: Unsupported FMI version), and "
        "libcosimpy passes the null pointer on instead of that message, so that `add_local_slave` crashes with an FMI "
        "3.0 file; take fmi2",
    ),
    Entry("libcosim_ssp", "SSP", "fmi2", "parallel", quick=True),
    Entry("fmi4j", "three FMUs", "fmi2", "sequential"),
    Entry("fmi4j", "three FMUs", "fmi3", "sequential", _ONLY_FMI_2),
    Entry("fmi4j", "three FMUs", "pythonfmu", "sequential", _NO_PYTHON),
    Entry("maestro", "three FMUs", "fmi2", "parallel"),
    Entry("maestro", "three FMUs", "fmi3", "parallel", _ONLY_FMI_2),
    Entry("maestro", "three FMUs", "pythonfmu", "parallel", _NO_PYTHON),
    Entry("cofmupy", "three FMUs", "fmi2", "own"),
    Entry("cofmupy", "three FMUs", "fmi3", "own"),
    Entry("cofmupy", "three FMUs", "pythonfmu", "own"),
    Entry("pathsim", "three FMUs", "fmi2", "own", quick=True),
    Entry("pathsim", "three FMUs", "fmi3", "own"),
    Entry("pathsim", "three FMUs", "pythonfmu", "own"),
    Entry("fmi_sim", "one FMU", "fmi2", "none"),
    Entry(
        "fmi_sim",
        "one FMU",
        "fmi3",
        "none",
        "its reader of FMI 3.0 knows no attribute `unit` of a Float64, which the schema of the standard has; take fmi2",
    ),
    Entry("c_host", "three FMUs", "fmi2", "sequential", quick=True),
    Entry("c_host", "three FMUs", "fmi3", "sequential", quick=True),
    Entry("c_host", "three FMUs", "pythonfmu", "sequential", _NO_PYTHON),
)

#: Tools that load and call FMUs by code of their own -> its name; the others call them through one of these.
IMPORTERS = {
    "fmpy_loop": "FMPy",
    "fmpy_cli": "FMPy",
    "fmpy_me": "FMPy",
    "fmpy_container": "FMPy",
    "fmpy_ssp": "FMPy",
    "fmu_toolbox": "FMU Manipulation Toolbox",
    "fmu_toolbox_sequential": "FMU Manipulation Toolbox",
    "fmu_toolbox_ssp": "FMU Manipulation Toolbox",
    "ecos": "Ecos",
    "ecos_ssp": "Ecos",
    "libcosim": "libcosim",
    "libcosim_ssp": "libcosim",
    "fmi4j": "FMI4j",
    "maestro": "Maestro",
    "fmi_sim": "fmi-sim",
    "c_host": "a C host of ours",
}
