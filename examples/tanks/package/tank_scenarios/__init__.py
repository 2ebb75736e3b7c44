"""Scenarios of one tank under level control."""

from pathlib import Path

from cosim import Connection
from cosim.scenario import ScenarioComponent, ScenarioFamily


class TankFamily(ScenarioFamily):
    """What all of its scenarios have in common."""

    system = "a tank under level control"
    folder = Path(__file__).parent  # of level.toml, which `cosim run level` runs
    components = dict.fromkeys(("tank", "controller"), ScenarioComponent())
    connections = (Connection("controller.flow", "tank.inflow"), Connection("tank.level", "controller.level"))
    metric_names = ("highest_level",)

    def add_options(self, parser):
        """Options of its own, which are None unless they are given."""
        parser.add_argument("--tank-fmus", type=Path, metavar="DIR", help="folder of the FMUs (default .)")

    def prepared(self, scenario, options):
        """Find the FMUs; what is missing could be built here."""
        folder = options.tank_fmus or Path()
        return scenario.with_fmus({"tank": folder / "Tank.fmu", "controller": folder / "LevelController.fmu"})

    def metrics(self, scenario, results):
        """Numbers for summary.json."""
        return {"highest_level": float(results["tank.level"].max())}

    def report(self, scenario, metrics):
        """Lines for the terminal."""
        return [f"highest level {metrics['highest_level']:.3f} m"]


FAMILY = TankFamily()
