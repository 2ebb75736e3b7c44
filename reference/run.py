"""Run an FMU under the fixed inputs of a reference case.

    python reference/run.py reference/RobotPlant fmus/pythonfmu/RobotPlant.fmu out.csv
    cosim compare out.csv reference/RobotPlant/RobotPlant_ref.csv

A case is a folder: `<name>_in.csv` (inputs at the communication points, held in between; for an FMU without inputs the
times only), `<name>_ref.csv` (the result) and `<name>_ref.toml` (tolerances). To make a new reference after a wanted
change, let this write onto `<name>_ref.csv`, and say in the commit why it changed.
"""

from __future__ import annotations

import sys
from pathlib import Path

from cosim import Results, System, simulate


def run_case(case: Path, fmu: Path) -> Results:
    """Results of all outputs of an FMU under the inputs of a case."""
    inputs = Results.from_csv(case / f"{case.name}_in.csv")
    step = float(inputs.time[1] - inputs.time[0])
    system = System()
    system.add("fmu", fmu)
    for name in inputs.names:
        values = inputs[name]
        system.drive(f"fmu.{name}", lambda t, values=values: values[round(t / step)])
    results = simulate(system, float(inputs.time[-1]), step)
    outputs = [i for i, name in enumerate(results.names) if name.removeprefix("fmu.") not in inputs.names]
    names = [results.names[i].removeprefix("fmu.") for i in outputs]
    return Results(results.time, names, results.values[:, outputs])


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit("usage: python reference/run.py CASE_FOLDER FMU OUT.csv")
    run_case(Path(sys.argv[1]), Path(sys.argv[2])).to_csv(sys.argv[3])
