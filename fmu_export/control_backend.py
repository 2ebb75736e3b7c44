"""A `Model` as a python-control system: for linearisation, margins and as an oracle without FMUs and steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fmu_export.errors import ArgumentError, needs
from fmu_export.modelling.model_class import AnyModel, flat_model
from fmu_export.modelling.variables import Array, Layout

with needs("control"):
    import control


def to_control(
    model: AnyModel,
    name: str | None = None,
    parameters: Mapping[str, float | Sequence[float]] | None = None,
) -> control.NonlinearIOSystem:
    """Wrap a model as a continuous-time system.

    Parameters
    ----------
    model : Model or ModelClass
        Any model; its functions are called as they are.
    name : str, optional
        Name of the system; the model's by default.
    parameters : mapping, optional
        Values of parameters, scalars or vectors by their declared names; the others keep their start values.

    Returns
    -------
    control.NonlinearIOSystem
        Signals have the names of the model's variables, `theta_a[1]` and so on; where those hold dots, as in composed
        models, underscores, since python-control allows no dots. python-control's `params`, which all parts of an
        interconnected system share, override scalar parameters by name.

    Raises
    ------
    ArgumentError
        `parameters` has an unknown name or a value of the wrong size, or the model has discrete states or events.
    """
    model = flat_model(model)
    if not model.is_continuous:
        raise ArgumentError(
            f"{model.name}: python-control takes continuous models, without discrete states and events; build an FMU "
            "with build_native"
        )
    defaults = parameter_array(model.parameters, parameters or {})
    names = model.parameters.names

    def p(params: Mapping[str, Any]) -> Array:
        if not params:
            return defaults
        return np.array([params.get(n, default) for n, default in zip(names, defaults, strict=True)])

    return control.NonlinearIOSystem(
        lambda t, x, u, params: model.derivatives(t, x, u, p(params)),
        lambda t, x, u, params: model.output_values(t, x, u, p(params))[: len(model.outputs)],
        inputs=_labels(model.inputs),
        outputs=_labels(model.outputs),
        states=_labels(model.state_layout),
        name=name or model.name,
    )


def _labels(layout: Layout) -> list[str]:
    return [name.replace(".", "_") for name in layout.names]


def parameter_array(parameters: Layout, values: Mapping[str, float | Sequence[float]]) -> np.ndarray:
    """Parameters (n_p,) with the given values and start values for the others.

    Raises
    ------
    ArgumentError
        A name is not a parameter, or a value has the wrong size.
    """
    p = parameters.starts.copy()
    view = vars(parameters.unpack(np.arange(len(parameters))))
    for name, value in values.items():
        if name not in view:
            raise ArgumentError(f"there is no parameter '{name}'; known are {', '.join(view)}")
        try:
            p[view[name]] = value
        except (TypeError, ValueError):
            raise ArgumentError(
                f"parameter '{name}': {value!r} does not fit its {np.size(view[name])} values"
            ) from None
    return p
