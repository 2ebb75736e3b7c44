"""The robot's closed loop as an SSP: the three FMUs, and the optimal gains of each row of the paper's Table 1."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from controller_fmu.optimal_gains import PerformanceIndex, optimal_gains
from cosim.robot.scenario import load_scenario
from cosim.ssp.writer import Experiment, ParameterSet, write_ssp

#: Weights (mu, nu) of the rows of Table 1.
TABLE_1 = ((1.0, 1.0), (5.0, 1.0), (10.0, 1.0), (1.0, 10.0), (1.0, 5.0))

_SCENARIO = "tracking"

_DESCRIPTION = (
    "Planar robot under adaptive robust control (Han et al. 2021, doi 10.1007/s11071-021-06739-y). Disturbance torque "
    "tau_d and mass change dm of the plant are left open and stay 0 unless a tool feeds them. The controller takes the "
    "optimal gains of the row of Table 1 that is bound to it; the other rows are in resources"
)


def write_robot_ssp(
    path: Path,
    folder: Path,
    flavour: str,
    *,
    row: tuple[float, float] = TABLE_1[0],
    version: Literal["1.0", "2.0"] = "1.0",
) -> None:
    """Write the closed loop as an SSP.

    Parameters
    ----------
    path : Path
    folder : Path
        The FMUs are `<folder>/<flavour>/*.fmu`.
    flavour : str
    row : tuple
        Weights (mu, nu) of the row of Table 1 whose gains the controller takes.
    version : {"1.0", "2.0"}
        Of SSP.

    Raises
    ------
    SetupError, SSPError, OSError
        As `write_ssp`.
    """
    scenario = load_scenario(_SCENARIO)
    write_ssp(
        path,
        scenario.system(folder, flavour),
        "RobotClosedLoop",
        Experiment(scenario.stop_time, scenario.step_size),
        [gains(mu, nu, bound=(mu, nu) == row) for mu, nu in TABLE_1],
        version=version,
        description=_DESCRIPTION,
    )


def gains(mu: float, nu: float, *, bound: bool) -> ParameterSet:
    """Optimal gains of the controller for weights of Table 1."""
    found = optimal_gains(PerformanceIndex(mu, nu))
    return ParameterSet(
        f"gains_mu{mu:g}_nu{nu:g}",
        "controller",
        {"alpha": found.alpha, "beta": found.beta},
        f"Optimal gains of the paper's Table 1, mu = {mu:g}, nu = {nu:g}",
        bound,
    )
