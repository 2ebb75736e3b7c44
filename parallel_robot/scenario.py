"""Scenarios of the robot: its components and connections by default, and FMUs by folder and flavour."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cosim.errors import nearest
from cosim.scenario.scenario import Scenario, ScenarioComponent, ScenarioError
from cosim.system.system import System
from parallel_robot.choices import SCENARIOS, scenario_names
from parallel_robot.wiring import COMPONENTS


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

    def system(self, folder: Path | None = None, flavour: str = "fmi2") -> System:
        """The system that the scenario describes.

        Parameters
        ----------
        folder : Path, optional
            The FMUs of components that have none of their own are those in `<folder>/<flavour>`.
        flavour : str
            One of `parallel_robot.choices.FLAVOURS`.

        Raises
        ------
        ScenarioError
            There is no folder, and a component has no FMU.
        """
        return Scenario.system(self if folder is None else self.with_flavour(folder, flavour))

    def with_flavour(self, folder: Path, flavour: str) -> RobotScenario:
        """A copy in which components without an FMU of their own have those in `<folder>/<flavour>`."""
        from parallel_robot.fmus import fmu_path  # the models take a while to import

        missing = [name for name, component in self.components.items() if component.fmu is None]
        return self.with_fmus({name: fmu_path(folder, flavour, name) for name in missing})


def load_scenario(name_or_path: str) -> RobotScenario:
    """Read a scenario of the robot by name, or from a TOML file.

    Raises
    ------
    ScenarioError
        There is none of that name, or the file is malformed or of another system; the message names file and key.
    """
    from cosim.scenario.reading import read_scenario  # takes a while to import
    from parallel_robot.family import FAMILY

    path = SCENARIOS / f"{name_or_path}.toml" if name_or_path in scenario_names() else Path(name_or_path)
    if not path.is_file():
        raise ScenarioError(
            f"there is no scenario '{name_or_path}'; {nearest(name_or_path, scenario_names())} (or a TOML file)"
        )
    scenario, _ = read_scenario(path, FAMILY)
    if not isinstance(scenario, RobotScenario):
        raise ScenarioError(f"{path}: is a scenario of another system; read it with cosim.scenario.load_scenario")
    return scenario
