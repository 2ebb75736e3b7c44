"""A motor whose torque is a table over two variables; this file builds its FMU, runs it and changes the data."""

import numpy as np

from cosim import System, simulate
from fmu_export import ModelClass, Table, build_native, input, output, parameter, state, write_table

SPEED = np.linspace(0.0, 600.0, 13)  # rad/s
THROTTLE = np.array([0.0, 0.1, 0.3, 0.6, 1.0])
#: In N.m, by speed, then by throttle; of a file it would be Table.from_file("torque.csv").
TORQUE = np.outer(np.minimum(180.0, 45e3 / (SPEED + 1.0)), THROTTLE) - 0.02 * SPEED[:, None]

torque = Table("torque", SPEED, THROTTLE, TORQUE)
efficiency = Table("efficiency", [0.0, 50.0, 200.0, 400.0, 600.0], [0.6, 0.85, 0.95, 0.93, 0.88])


class TorqueMap(ModelClass, stop_time=20.0, step_size=0.05):
    """A motor with a fan on its shaft."""

    inertia = parameter(0.5, "kg.m2", "Moment of inertia of motor and fan", min=1e-6)
    drag = parameter(2e-4, "N.m.s2", "Torque of the fan by the square of the speed", min=0.0)
    throttle = input(1.0, "1", "Position of the throttle, from 0 to 1", min=0.0, max=1.0)
    speed = state(0.0, "rad/s", "Speed of the shaft")
    drive = output("N.m", "Torque of the motor")
    power = output("W", "Electric power")

    def derivatives(m):
        return dict(speed=(torque(m.speed, m.throttle) - m.drag * m.speed**2) / m.inertia)

    def outputs(m):
        drive = torque(m.speed, m.throttle)
        return dict(drive=drive, power=drive * m.speed / efficiency(m.speed))


def speed_at_the_end(fmu):
    """Speed after 20 s, in rad/s."""
    system = System()
    system.add("motor", fmu)
    return simulate(system, 20.0, 0.05)["motor.speed"][-1]


if __name__ == "__main__":
    fmu = build_native(TorqueMap, "", "fmi2")
    print(f"after 20 s: {speed_at_the_end(fmu):.2f} rad/s")
    write_table(fmu, "torque", SPEED, THROTTLE, 0.9 * TORQUE)  # no compiler
    print(f"with nine tenths of the torque: {speed_at_the_end(fmu):.2f} rad/s")
