"""`RobotSurroundings`: what acts on the robot, by the formulas of the scenarios' signals, as a model."""

from __future__ import annotations

from typing import Any

import numpy as np

from cosim.scenario.signals import Sine, sum_of_sines, unit_sine
from fmu_export.modelling.model import DefaultExperiment, Model
from fmu_export.modelling.variables import Layout, Variable
from parallel_robot.paper.reproduce.acting import DISTURBANCE, MASS_CHANGE, multisine
from parallel_robot.scenario import RobotScenario


def surroundings(scenario: RobotScenario) -> Model:
    """The mass change and the disturbance torque of a scenario as outputs of a model.

    What is random in the disturbance, its frequencies and phases, are parameters, as is its size.
    """
    mass, torque = scenario.signals[MASS_CHANGE], multisine(scenario)
    assert isinstance(mass, Sine)
    frequencies, phases = torque.drawn(3, scenario.seed, DISTURBANCE)
    shape = (torque.components, 3)
    parameters = Layout(
        [
            Variable("rms", "N.m", "Root mean square of the disturbance torque", start=torque.rms, min=0.0),
            Variable("onset", "s", "When the disturbance torque sets in", start=torque.start_time),
            Variable("frequencies", "Hz", "Frequencies of its sines", size=shape, start=frequencies.tolist()),
            Variable("phases", "rad", "Phases of its sines", size=shape, start=phases.tolist()),
            Variable("mass_amplitude", "kg", "Amplitude of the mass change", start=mass.amplitude),
            Variable("mass_frequency", "Hz", "Frequency of the mass change", start=mass.frequency),
            Variable("mass_phase", "rad", "Phase of the mass change", start=mass.phase),
            Variable("at_rest", "1", "Whether the changing mass arrives at rest", type="boolean"),
        ]
    )
    outputs = Layout(
        [
            Variable("tau_d", "N.m", "Disturbance torque", size=3),
            Variable("dm", "kg", "Mass change"),
            Variable("dm_rate", "kg/s", "Its derivative where the mass arrives at rest, else 0"),
        ]
    )

    def output_values(t: Any, x: Any, u: Any, p: Any) -> Any:  # noqa: ARG001
        P = parameters.unpack(p)
        amplitude = P.rms * np.sqrt(2.0 / torque.components)
        waves = amplitude * sum_of_sines(t - P.onset, P.frequencies, P.phases)
        dm = P.mass_amplitude * unit_sine(t, P.mass_frequency, P.mass_phase)
        rate = 2.0 * np.pi * P.mass_frequency * P.mass_amplitude
        dm_rate = P.at_rest * rate * unit_sine(t, P.mass_frequency, P.mass_phase + np.pi / 2.0)
        return outputs.pack(tau_d=np.where(t >= P.onset, waves, 0.0), dm=dm, dm_rate=dm_rate)

    return Model(
        name="RobotSurroundings",
        description="Mass change and disturbance torque of a scenario of the robot",
        parameters=parameters,
        outputs=outputs,
        output_values=output_values,
        default_experiment=DefaultExperiment(scenario.stop_time, scenario.step_size),
    )
