"""The interfaces of FMUs, co-simulation and model exchange, and the choice between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription

CO_SIMULATION, MODEL_EXCHANGE = "co-simulation", "model-exchange"

#: The choice of co-simulation where an FMU has it, and else of model exchange.
AUTO_INTERFACE = "auto"

#: What can be chosen.
INTERFACES = (AUTO_INTERFACE, CO_SIMULATION, MODEL_EXCHANGE)


def is_model_exchange(description: ModelDescription) -> bool:
    """Whether a component with a model description that `load` gave is in model exchange."""
    return description.coSimulation is None


def used_interface(description: ModelDescription) -> Any:
    """What a model description that `load` gave says of the interface that is used."""
    return description.modelExchange if is_model_exchange(description) else description.coSimulation
