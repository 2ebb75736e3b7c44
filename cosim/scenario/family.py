"""Families of scenarios: what packages register, so that the program knows their systems by name."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from cosim.errors import nearest
from cosim.results.figure_process import DRAWING
from cosim.scenario.scenario import Scenario, ScenarioComponent, ScenarioError
from cosim.system.system import Connection

if TYPE_CHECKING:
    from cosim.results.results import Results
    from cosim.results.stored import StoredResults

#: Entry-point group by which packages add families of scenarios: name -> `module:instance of ScenarioFamily`.
SCENARIO_GROUP = "cosim.scenarios"


class ScenarioFamily:
    """Scenarios of one system, with all that they have in common.

    A package subclasses it and registers an instance in the entry-point group `cosim.scenarios`. The module of that
    instance is imported whenever `cosim run` is, so what takes a while to import belongs into the methods.

    Attributes
    ----------
    system : str
        One line for people: what system it is.
    folder : Path, optional
        Folder of the TOML files that come with it, which are known by their names; relative to the module of the class.
    default : str, optional
        The scenario that `cosim run` runs when none is named. At most one family on a machine should have one.
    scenario : type of Scenario
        Class of its scenarios; fields that it has besides those of `Scenario` are numbers, and become keys of `[run]`.
    components : mapping
        Name -> component; all take part unless a scenario lists some. Those without an FMU get it in `prepared`.
    connections : sequence of Connection
        Those between components that take part are made.
    optional_inputs : mapping
        Inputs `component.variable` that are held at this value where an FMU of the user has no output to feed them.
    metric_names : collection of str
        Keys of what `metrics` gives, which metrics of a TOML file can't have.
    drawing : str
        Function `module:name` that draws results into a folder, as `cosim.results.plot_file.write_plot`; called in a
        process of its own with the results, the folder, and `drawing_arguments`.
    study : str
        Class `module:name` of its sweeps, a subclass of `cosim.sweep.scenarios.ScenarioStudy`.
    """

    system: str = ""
    folder: Path | None = None
    default: str | None = None
    components: Mapping[str, ScenarioComponent] = {}
    connections: Sequence[Connection] = ()
    optional_inputs: Mapping[str, Any] = {}
    metric_names: Collection[str] = ()
    drawing: str = DRAWING
    study: str = "cosim.sweep.scenarios:ScenarioStudy"
    scenario: ClassVar[type[Scenario]] = Scenario

    def __init_subclass__(cls) -> None:
        """A relative folder is one beside the module, wherever the program runs."""
        super().__init_subclass__()
        file = getattr(sys.modules.get(cls.__module__), "__file__", None)
        if cls.folder is not None and file is not None:
            cls.folder = Path(file).parent / cls.folder

    def scenario_names(self) -> list[str]:
        """Names of the scenarios that come with it."""
        return [] if self.folder is None else sorted(path.stem for path in self.folder.glob("*.toml"))

    def add_options(self, parser: argparse._ActionsContainer) -> None:
        """Add options of its own to `cosim run`; their defaults must be None."""

    def add_sweep_options(self, parser: argparse._ActionsContainer) -> None:
        """Add options of its own to `cosim sweep`, by default those of `cosim run`; their defaults must be None."""
        self.add_options(parser)

    def alternatives(self, options: argparse.Namespace) -> tuple[str, Sequence[str]]:  # noqa: ARG002 -- for subclasses
        """A further factor of sweeps, such as the kind of FMUs: its name and its values."""
        return "", [""]

    def prepared_alternative(
        self,
        scenarios: Mapping[str, Scenario],
        alternative: str,  # noqa: ARG002 -- for subclasses
        options: argparse.Namespace,
    ) -> dict[str, Scenario]:
        """The scenarios of a sweep, as `prepared` gives them, with the FMUs of an alternative."""
        return {label: self.prepared(scenario, options) for label, scenario in scenarios.items()}

    def prepared(self, scenario: Scenario, options: argparse.Namespace) -> Scenario:  # noqa: ARG002 -- for subclasses
        """The scenario with an FMU for every component, all of which exist: this is where those that miss are built.

        Raises
        ------
        CosimError
            The FMUs can't be had.
        """
        return scenario

    def metrics(self, scenario: Scenario, results: Results | StoredResults) -> dict[str, Any]:  # noqa: ARG002
        """Numbers for the summary besides the metrics that the scenario names; called with at least one row."""
        return {}

    def drawing_arguments(self, scenario: Scenario) -> tuple[Any, ...]:
        """Further arguments of `drawing`: the title by default."""
        return (scenario.title,)

    def report(self, scenario: Scenario, metrics: Mapping[str, Any]) -> list[str]:  # noqa: ARG002
        """Lines for people about a run, from its metrics."""
        return []


@cache
def families() -> dict[str, ScenarioFamily]:
    """All families that installed packages register, by name.

    Raises
    ------
    ScenarioError
        An entry point can't be loaded, or is no family.
    """
    found = {}
    for entry in entry_points(group=SCENARIO_GROUP):
        here = f"entry point {entry.name} = {entry.value} of the group {SCENARIO_GROUP}"
        try:
            family = entry.load()
        except Exception as error:  # whatever a package raises
            raise ScenarioError(f"{here}: {type(error).__name__}: {error}; repair or uninstall its package") from error
        if not isinstance(family, ScenarioFamily):
            raise ScenarioError(f"{here}: is not an instance of cosim.scenario.ScenarioFamily")
        if family.folder is not None and not family.folder.is_dir():
            raise ScenarioError(f"{here}: there is no folder {family.folder}; repair or uninstall its package")
        found[entry.name] = family
    return found


def family_name(family: ScenarioFamily) -> str:
    """The name under which a family is registered; empty for one that is not."""
    return next((name for name, known in families().items() if known is family), "")


def default_scenario() -> str:
    """Name of the scenario that runs when none is named.

    Raises
    ------
    ScenarioError
        No family has one, or several do.
    """
    known = {name: family.default for name, family in families().items() if family.default is not None}
    if len(known) == 1:
        return next(iter(known.values()))
    names = ", ".join(name for family in families().values() for name in family.scenario_names())
    which = f"of {names}, or of a TOML file" if names else "of a TOML file"
    raise ScenarioError(f"there is no default scenario; give the name {which}")


def named(name_or_path: str) -> tuple[ScenarioFamily, Path] | None:
    """Family and file of a scenario that comes with a family, by name or path; None where there is none.

    Raises
    ------
    ScenarioError
        Several families have one of that name.
    """
    found = [
        (family, family.folder / f"{name}.toml")
        for family in families().values()
        for name in family.scenario_names()
        if family.folder is not None
        and (name == name_or_path or os.path.realpath(family.folder / f"{name}.toml") == os.path.realpath(name_or_path))
    ]
    if len(found) > 1:
        paths = ", ".join(str(path) for _, path in found)
        raise ScenarioError(f"several packages have a scenario '{name_or_path}'; give the file of one: {paths}")
    return found[0] if found else None


def family_of(system: str | None, *, own: bool) -> ScenarioFamily | None:
    """The family that a file belongs to: that which it names; else the only one, unless it has components of its own.

    Raises
    ------
    ScenarioError
        There is none of that name, or not just one.
    """
    known = families()
    if system is not None:
        if system not in known:
            raise ScenarioError(f"there is no system '{system}'; {nearest(system, known)}")
        return known[system]
    if own:
        return None
    if len(known) != 1:
        which = " or ".join(f'"{name}"' for name in known) or "NAME (no package that knows a system is installed)"
        raise ScenarioError(f"needs [components] with their FMUs, or a line system = {which}")
    return next(iter(known.values()))
