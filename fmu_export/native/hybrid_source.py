"""What the adapter reads of events and sampling: sizes, names, and which function belongs to which."""

from __future__ import annotations

from collections.abc import Callable

from fmu_export.trace.trace import TracedModel

_DIRECTIONS = {"falling": 1, "rising": -1, "both": 0}


def hybrid_sizes(traced: TracedModel) -> dict[str, int | str]:
    """Numbers of discrete states, events and samplers, by their name in C."""
    model = traced.model
    place = "(N_P + N_U + N_Y + N_X + N_STEP_REQUIREMENTS)"
    return {
        "N_Z": len(model.discrete),
        "N_EVENTS": len(model.events),
        "N_SAMPLED": len(model.sampled),
        "MODEL_Z": f"{place} /* where discrete states are behind the parameters */",
    }


def hybrid_tables(traced: TracedModel, quote: Callable[[str], str]) -> dict[str, str]:
    """Names and directions: declaration -> values."""
    model = traced.model
    tables = {}
    if model.events:
        tables["char *const model_event_names[N_EVENTS]"] = ", ".join(quote(e.name) for e in model.events)
        tables["int model_event_directions[N_EVENTS]"] = ", ".join(str(_DIRECTIONS[e.direction]) for e in model.events)
    if model.sampled:
        tables["char *const model_sampled_names[N_SAMPLED]"] = ", ".join(quote(s.name) for s in model.sampled)
    return tables


def hybrid_prototypes(traced: TracedModel) -> str:
    """Declarations of the functions that call one of several by its number."""
    return "".join(f"{_prototype(what)};\n" for what in _several(traced))


def hybrid_calls(traced: TracedModel) -> list[str]:
    """These functions."""
    return [
        f"{_prototype(what)}\n{{\n    switch (number) {{\n"
        + "".join(f"    case {i}: model_{what}_{i}(t, x, u, p, y); break;\n" for i in range(n))
        + "    }\n}\n"
        for what, n in _several(traced).items()
    ]


def _several(traced: TracedModel) -> dict[str, int]:
    model = traced.model
    return {what: n for what, n in (("update", len(model.sampled)), ("reset", len(model.events))) if n}


def _prototype(what: str) -> str:
    return f"void model_{what}(int number, double t, const double *x, const double *u, const double *p, double *y)"
