"""A room whose heater switches at two temperatures, a machine of two modes; this file builds its FMU and runs it."""

import numpy as np

from cosim import System, simulate
from fmu_export import ModelClass, build_native, discrete, input, output, parameter, require, state, when


class Thermostat(ModelClass, stop_time=600.0, step_size=1.0):
    """A room with a heater between two temperatures."""

    low = parameter(18.0, "degC", "The heater switches on below")
    high = parameter(22.0, "degC", "The heater switches off above")
    tau = parameter(100.0, "s", "Time constant of the room", min=1e-6)
    rate = parameter(0.3, "K/s", "Rise of the temperature by the heater")
    ambient = input(10.0, "degC", "Temperature outside")
    T = state(20.0, "degC", "Temperature of the room")
    on = discrete(False, description="Whether the heater is on")
    heating = output("K/s", "Present rise by the heater")

    def derivatives(m):
        return dict(T=(m.ambient - m.T) / m.tau + np.where(m.on, m.rate, 0.0))

    def outputs(m):
        return dict(heating=np.where(m.on, m.rate, 0.0))

    @when(lambda m: m.T - m.low, "falling")
    def too_cold(m):
        return dict(on=True)

    @when(lambda m: m.T - m.high, "rising")
    def too_warm(m):
        return dict(on=False)

    @require("high must be above low", at="start")
    def high_is_above_low(m):
        return m.high - m.low


if __name__ == "__main__":
    system = System()
    system.add("room", build_native(Thermostat, "", "fmi2"))
    results = simulate(system, 600.0, 1.0)
    print(f"heater on {results['room.on'].mean():.0%} of 600 s; {np.ptp(results['room.T']):.2f} K between extremes")
