"""Scenarios of the robot, as a family that the program finds by the entry-point group `cosim.scenarios`."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.errors import nearest
from cosim.scenario.family import ScenarioFamily
from cosim.scenario.scenario import Scenario, ScenarioComponent, ScenarioError
from cosim.system.system import Connection, System
from parallel_robot.choices import FLAVOURS, SCENARIOS, scenario_names
from parallel_robot.wiring import COMPONENTS, CONNECTIONS, OPTIONAL_INPUTS, UNFED_INPUTS

if TYPE_CHECKING:
    from cosim.results.results import Results
    from cosim.results.stored import StoredResults


@dataclass(frozen=True)
class RobotScenario(Scenario):
    """A run of the robot; see `cosim.scenario.Scenario` for the other attributes.

    Attributes
    ----------
    components : mapping
        Those that take part: "plant", "controller", "trajectory".
    steady_after : float
        From this time (s) on errors count as steady.
    """

    components: Mapping[str, ScenarioComponent] = field(
        default_factory=lambda: dict.fromkeys(COMPONENTS, ScenarioComponent())
    )
    stop_time: float = 15.0
    step_size: float = 1e-3
    steady_after: float = 8.0

    def system(self, folder: str | PathLike[str] | None = None, flavour: str = "fmi2") -> System:
        """The system that the scenario describes.

        Parameters
        ----------
        folder : path, optional
            The FMUs of components that have none of their own are those in `<folder>/<flavour>`.
        flavour : str
            One of `parallel_robot.choices.FLAVOURS`.

        Raises
        ------
        ScenarioError
            There is no folder, and a component has no FMU.
        """
        return Scenario.system(self if folder is None else self.with_flavour(folder, flavour))

    def with_flavour(self, folder: str | PathLike[str], flavour: str) -> RobotScenario:
        """A copy in which components without an FMU of their own have those in `<folder>/<flavour>`."""
        from parallel_robot.fmus import fmu_path  # the models take a while to import

        missing = [name for name, component in self.components.items() if component.fmu is None]
        scenario = self.with_fmus({name: fmu_path(Path(folder), flavour, name) for name in missing})
        for target, value in UNFED_INPUTS.items():
            component, _, name = target.partition(".")
            if component in missing and self.shape(target) is None and name not in self.start.get(component, {}):
                scenario = scenario.with_start_value(component, name, value)
        return scenario


class RobotFamily(ScenarioFamily):
    """Robot, controller and desired path of Han et al. 2021."""

    system = "parallel robot under adaptive robust control"
    folder = SCENARIOS
    default = "tracking"
    scenario = RobotScenario
    components = dict.fromkeys(COMPONENTS, ScenarioComponent())
    connections = tuple(Connection(source, target) for source, target in CONNECTIONS)
    optional_inputs = OPTIONAL_INPUTS
    metric_names = ("tracking", "control_effort", "closure_error_max", "steady_after")
    drawing = "parallel_robot.figures:write_figures"
    study = "parallel_robot.sweep:RobotStudy"

    def add_options(self, parser: argparse._ActionsContainer) -> None:
        """Add --flavour and --fmus."""
        parser.add_argument(
            "--flavour", choices=FLAVOURS, help="default fmi2; pythonfmu where there is no C compiler to build it"
        )
        parser.add_argument("--fmus", type=Path, metavar="DIR", help="FMU folder (default fmus)")

    def prepared(self, scenario: Scenario, options: argparse.Namespace) -> Scenario:
        """The scenario with FMUs of the flavour that is asked for, or the default one; missing ones are built.

        Raises
        ------
        BuildError
            As `parallel_robot.fmus.build`.
        """
        from parallel_robot.commands.robot_fmus import chosen_flavour, make_ready  # the models take a while to import

        assert isinstance(scenario, RobotScenario)
        folder = _folder(options)
        flavour = chosen_flavour(folder, options.flavour)
        make_ready(folder, flavour)
        return scenario.with_flavour(folder, flavour)

    def add_sweep_options(self, parser: argparse._ActionsContainer) -> None:
        """Add --flavour, for several of them, and --fmus."""
        parser.add_argument("--flavour", metavar="F,F", help=f"flavours of the FMUs, of {', '.join(FLAVOURS)}")
        parser.add_argument("--fmus", type=Path, metavar="DIR", help="FMU folder (default fmus)")

    def alternatives(self, options: argparse.Namespace) -> tuple[str, Sequence[str]]:
        """Flavours that are asked for, or the default one.

        Raises
        ------
        ScenarioError
            There is no such flavour.
        """
        from parallel_robot.commands.robot_fmus import chosen_flavour  # the models take a while to import

        if options.flavour is None:
            return "flavour", [chosen_flavour(_folder(options), None)]
        flavours = options.flavour.split(",")
        for flavour in flavours:
            if flavour not in FLAVOURS:
                raise ScenarioError(
                    f"--flavour {options.flavour}: '{flavour}' is unknown; {nearest(flavour, FLAVOURS)}"
                )
        return "flavour", flavours

    def prepared_alternative(
        self, scenarios: Mapping[str, Scenario], alternative: str, options: argparse.Namespace
    ) -> dict[str, Scenario]:
        """The scenarios with FMUs of a flavour; missing ones are built.

        Raises
        ------
        BuildError
            As `parallel_robot.fmus.build`.
        """
        from parallel_robot.commands.robot_fmus import make_ready

        make_ready(_folder(options), alternative)
        prepared: dict[str, Scenario] = {}
        for label, scenario in scenarios.items():
            assert isinstance(scenario, RobotScenario)
            prepared[label] = scenario.with_flavour(_folder(options), alternative)
        return prepared

    def metrics(self, scenario: Scenario, results: Results | StoredResults) -> dict[str, Any]:
        """Tracking errors, control effort, closure error."""
        from parallel_robot.metrics import metrics

        assert isinstance(scenario, RobotScenario)
        return metrics(results, scenario.steady_after)

    def drawing_arguments(self, scenario: Scenario) -> tuple[Any, ...]:
        """Title, and where the steady part begins (s)."""
        assert isinstance(scenario, RobotScenario)
        return scenario.title, scenario.steady_after

    def report(self, scenario: Scenario, metrics: Mapping[str, Any]) -> list[str]:
        """A table of tracking errors, and the control effort."""
        assert isinstance(scenario, RobotScenario)
        lines = []
        if metrics["tracking"]:
            steady = f"steady max (t >= {scenario.steady_after:g} s)"
            lines.append(f"\n{'tracking error':<16}{'max':>14}{'rms':>14}{'accumulated':>16}{steady:>28}")
            for name, e in metrics["tracking"].items():
                unit = "mm" if name in "xy" else "mrad"
                last = "-" if e["steady_max"] is None else f"{e['steady_max'] * 1e3:.4g} {unit}"
                lines.append(
                    f"{name:<16}{e['max'] * 1e3:>9.4g} {unit:<4}{e['rms'] * 1e3:>9.4g} {unit:<4}"
                    f"{e['accumulated'] * 1e3:>9.4g} {unit + ' s':<6}{last:>28}"
                )
        effort = metrics["control_effort"]
        if effort is not None:
            integral = "beyond floats" if effort["integral"] is None else f"{effort['integral']:.4g} N2.m2.s"
            lines.append(f"\nlargest torque {effort['max']:.4g} N.m, integral of its square {integral}")
        if metrics["closure_error_max"] is not None:
            lines.append(f"largest closure error {metrics['closure_error_max']:.2g} m")
        return lines


def _folder(options: argparse.Namespace) -> Path:
    return Path("fmus") if options.fmus is None else Path(options.fmus)


FAMILY = RobotFamily()


def load_scenario(name_or_path: str) -> RobotScenario:
    """Read a scenario of the robot by name, or from a TOML file.

    Raises
    ------
    ScenarioError
        There is none of that name, or the file is malformed or of another system; the message names file and key.
    """
    from cosim.scenario.reading import read_scenario  # takes a while to import

    path = SCENARIOS / f"{name_or_path}.toml" if name_or_path in scenario_names() else Path(name_or_path)
    if not path.is_file():
        raise ScenarioError(
            f"there is no scenario '{name_or_path}'; {nearest(name_or_path, scenario_names())} (or a TOML file)"
        )
    scenario, _ = read_scenario(path, FAMILY)
    if not isinstance(scenario, RobotScenario):
        raise ScenarioError(f"{path}: is a scenario of another system; read it with cosim.scenario.load_scenario")
    return scenario
