"""The robot's closed loop as an SSP: the three FMUs, and the optimal gains of each row of the paper's Table 1."""

from __future__ import annotations

from os import PathLike
from typing import Literal

from cosim.master.coupling.algorithm import fixed
from cosim.ssp.errors import SSPError
from cosim.ssp.writer import Experiment, ParameterSet, write_ssp
from parallel_robot.paper.reproduce.table import table1
from parallel_robot.scenario import load_scenario

_SCENARIO = "tracking"

_DESCRIPTION = (
    "Planar robot under adaptive robust control (Han et al. 2021, doi 10.1007/s11071-021-06739-y). Disturbance torque "
    "tau_d and mass change dm of the plant are left open and stay 0 unless a tool feeds them. The controller takes the "
    "optimal gains of the row of Table 1 that is bound to it; the other rows are in resources"
)


def write_robot_ssp(
    path: str | PathLike[str],
    folder: str | PathLike[str],
    flavour: str,
    *,
    row: tuple[float, float] = (1.0, 1.0),
    version: Literal["1.0", "2.0"] = "1.0",
) -> None:
    """Write the closed loop as an SSP.

    Parameters
    ----------
    path : path
    folder : path
        The FMUs are `<folder>/<flavour>/*.fmu`.
    flavour : str
    row : tuple
        Weights (mu, nu) of the row of Table 1 whose gains the controller takes.
    version : {"1.0", "2.0"}
        Of SSP.

    Raises
    ------
    SSPError
        Table 1 has no such row.
    SetupError, SSPError, OSError
        As `write_ssp`.
    """
    sets = _parameter_sets(*row)
    scenario = load_scenario(_SCENARIO)
    write_ssp(
        path,
        scenario.system(folder, flavour),
        "RobotClosedLoop",
        Experiment(scenario.stop_time, fixed(scenario.step_size, "an SSP has")),
        sets,
        version=version,
        description=_DESCRIPTION,
    )


def _parameter_sets(mu: float, nu: float) -> list[ParameterSet]:
    """Optimal gains of all rows of Table 1, one of them bound."""
    rows = table1()
    if (mu, nu) not in [(row.mu, row.nu) for row in rows]:
        known = ", ".join(f"({row.mu:g}, {row.nu:g})" for row in rows)
        raise SSPError(f"Table 1 has no row for mu = {mu:g}, nu = {nu:g}; its rows (mu, nu) are {known}")
    return [
        ParameterSet(
            f"gains_mu{row.mu:g}_nu{row.nu:g}",
            "controller",
            {"alpha": row.alpha, "beta": row.beta},
            f"Optimal gains of the paper's Table 1, mu = {row.mu:g}, nu = {row.nu:g}",
            (row.mu, row.nu) == (mu, nu),
        )
        for row in rows
    ]
