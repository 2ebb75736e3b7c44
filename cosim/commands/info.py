"""`cosim info`: what an FMU is, can do and has, as its archive says; nothing of it runs."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from fmpy.model_description import ModelDescription, ModelVariable

from cosim.fmi.compilation import has_sources
from cosim.fmi.fmu_file import LoadedFMU, read_fmu
from cosim.terminal import printable

#: What is listed, in this order; local variables and others only on demand.
_GROUPS = ("input", "output", "parameter", "structuralParameter")

#: Flags of an interface, as fmpy names them in all versions -> in words.
_CAPABILITIES = {
    "canHandleVariableCommunicationStepSize": "steps of any length",
    "canInterpolateInputs": "interpolates inputs",
    "providesIntermediateUpdate": "asks for inputs during a step",
    "hasEventMode": "events of the importer",
    "mightReturnEarlyFromDoStep": "may return early",
    "canGetAndSetFMUstate": "saves its state",
    "canSerializeFMUstate": "serialises its state",
    "providesDirectionalDerivative": "directional derivatives",
    "providesAdjointDerivatives": "adjoint derivatives",
    "canRunAsynchronuously": "computes by itself",
    "canBeInstantiatedOnlyOncePerProcess": "one instance in a process only",
    "needsExecutionTool": "needs its tool",
}

_INTERFACES = {
    "coSimulation": "co-simulation",
    "modelExchange": "model exchange",
    "scheduledExecution": "scheduled execution",
}

_EXAMPLES = """\
examples:
  cosim info Model.fmu
  cosim info Model.fmu --all
  cosim info Model.fmu --json
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim info`."""
    parser = subparsers.add_parser(
        "info",
        help="say what an FMU is, can do and has",
        epilog=_EXAMPLES,
        description="Say what an FMU is, can do and has: its interfaces, capabilities, platforms, default experiment, "
        "and its variables with units and start values. Nothing of the FMU runs.",
    )
    parser.add_argument("fmu", type=Path, help="FMU file")
    parser.add_argument("--all", action="store_true", help="list all variables, the local ones too")
    parser.add_argument("--json", action="store_true", help="print all of it as JSON, for machines")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim info`; returns 0.

    Raises
    ------
    SetupError
        There is no such file, or it is not an FMU.
    """
    about = description_of(read_fmu(args.fmu, str(args.fmu)))
    print(json.dumps(about, indent=2, allow_nan=False) if args.json else "\n".join(in_words(about, every=args.all)))
    return 0


def description_of(fmu: LoadedFMU) -> dict[str, Any]:
    """What an FMU is, can do and has, ready for JSON."""
    description = fmu.description
    experiment = description.defaultExperiment
    return {
        "file": str(fmu.path),
        "sha256": fmu.sha256,
        "model": description.modelName,
        "fmi_version": description.fmiVersion,
        "description": description.description,
        "author": description.author,
        "version": description.version,
        "license": description.license,
        "copyright": description.copyright,
        "tool": description.generationTool,
        "made": description.generationDateAndTime,
        "interfaces": {
            words: _interface(getattr(description, name))
            for name, words in _INTERFACES.items()
            if getattr(description, name) is not None
        },
        "states": description.numberOfContinuousStates,
        "event_indicators": description.numberOfEventIndicators,
        "platforms": _platforms(fmu.files),
        "sources": has_sources(fmu.files),
        "default_experiment": None
        if experiment is None
        else {key: getattr(experiment, key, None) for key in ("startTime", "stopTime", "stepSize", "tolerance")},
        "variables": [_variable(v, description) for v in description.modelVariables],
    }


def _interface(interface: Any) -> dict[str, Any]:
    """Identifier of an interface, and what it says it can do."""
    found = {"identifier": interface.modelIdentifier}
    found |= {name: True for name in _CAPABILITIES if getattr(interface, name, False)}
    for name in ("maxOutputDerivativeOrder", "fixedInternalStepSize"):
        if getattr(interface, name, None):
            found[name] = getattr(interface, name)
    return found


def _platforms(files: Iterable[str]) -> list[str]:
    parts = (PurePosixPath(name).parts for name in files if name.startswith("binaries/"))
    return sorted({p[1] for p in parts if len(p) > 2})


def _variable(variable: ModelVariable, description: ModelDescription) -> dict[str, Any]:
    declared = variable.declaredType
    items = getattr(declared, "items", None) or ()

    def of_type(name: str) -> Any:
        own = getattr(variable, name)
        return own if own is not None or declared is None else getattr(declared, name, None)

    return {
        "name": variable.name,
        "reference": variable.valueReference,
        "type": variable.type,
        "causality": variable.causality or "local",
        "variability": variable.variability,
        "shape": [_size(d, description) for d in variable.dimensions],
        "unit": of_type("unit"),
        "start": variable.start,
        "min": of_type("min"),
        "max": of_type("max"),
        "items": {item.name: item.value for item in items},
        "description": variable.description,
    }


def _size(dimension: Any, description: ModelDescription) -> int | str | None:
    """A size, or the name of the structural parameter that it follows."""
    if dimension.start is not None:
        return int(dimension.start)
    found = (v.name for v in description.modelVariables if v.valueReference == dimension.valueReference)
    return next(found, None)


def in_words(about: Mapping[str, Any], *, every: bool) -> list[str]:
    """Lines for people; all variables, or those that a user sets and reads."""
    lines = [f"{about['model']} (FMI {about['fmi_version']}){_after(': ', about['description'])}"]
    lines += _fact("file", f"{about['file']}, SHA-256 {about['sha256'][:16]}...")
    lines += _fact("version", about["version"])
    lines += _fact("made", ", ".join(str(x) for x in (about["tool"], about["author"], about["made"]) if x))
    lines += _fact("license", about["license"])
    for words, interface in about["interfaces"].items():
        can = [text for name, text in _CAPABILITIES.items() if interface.get(name)]
        if order := interface.get("maxOutputDerivativeOrder"):
            can.append(f"derivatives of outputs to order {order}")
        if step := interface.get("fixedInternalStepSize"):
            can.append(f"internal step of {step} s")
        if words == "model exchange":
            can.append(f"{about['states']} states, {about['event_indicators']} event indicators")
        lines += _fact(words, "; ".join(can) or "offered")
    platforms = [*about["platforms"], *(["C sources"] if about["sources"] else [])]
    lines += _fact("platforms", ", ".join(platforms) or "none: it has no binaries")
    lines += _fact("experiment", _experiment(about["default_experiment"]))
    kinds = {v["causality"] for v in about["variables"]}
    for kind in (*_GROUPS, *(sorted(kinds - set(_GROUPS)) if every else ())):
        lines += _table(kind, [v for v in about["variables"] if v["causality"] == kind])
    if rest := [] if every else [v for v in about["variables"] if v["causality"] not in _GROUPS]:
        lines += ["", f"and {len(rest)} {', '.join(sorted({v['causality'] for v in rest}))}; --all lists them"]
    return [printable(" ".join(line.splitlines())) for line in lines]


def _after(mark: str, text: str | None) -> str:
    return f"{mark}{' '.join(text.split())}" if text and text.strip() else ""


def _fact(name: str, text: Any) -> list[str]:
    return [f"  {name:<16}{' '.join(str(text).split())}"] if text else []


def _experiment(experiment: Mapping[str, Any] | None) -> str:
    if experiment is None:
        return ""
    parts = []
    if experiment["stopTime"] is not None:
        parts.append(f"{experiment['startTime'] or 0} to {experiment['stopTime']} s")
    if experiment["stepSize"] is not None:
        parts.append(f"step {experiment['stepSize']} s")
    if experiment["tolerance"] is not None:
        parts.append(f"tolerance {experiment['tolerance']}")
    return ", ".join(parts)


def _table(kind: str, variables: Sequence[Mapping[str, Any]]) -> list[str]:
    if not variables:
        return []
    head = ("name", "type", "unit", "start", "range", "")
    rows = [
        (
            f"{v['name']}{v['shape'] or ''}",
            v["type"] if not v["items"] else "/".join(v["items"]),
            v["unit"] or "",
            _short(v["start"]),
            "" if v["min"] is None and v["max"] is None else f"{_bound(v['min'], '-')}..{_bound(v['max'], '')}",
            " ".join((v["description"] or "").split()),
        )
        for v in variables
    ]
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head) - 1)]
    plural = {"structuralParameter": "structural parameters"}.get(kind, f"{kind}s")

    def line(row: Sequence[str]) -> str:
        cells = (f"{cell:<{width}}" for cell, width in zip(row[:-1], widths, strict=True))
        return f"  {'  '.join(cells)}  {row[-1]}".rstrip()

    return ["", f"{plural} ({len(variables)})", line(head), *map(line, rows)]


def _short(start: str | None, most: int = 24) -> str:
    text = " ".join((start or "").split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


def _bound(value: Any, infinite: str) -> str:
    return f"{infinite}inf" if value is None else str(value)
