"""SSPs written by hand, for tests of the reader."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

from cosim.ssp.format.schema import NAMESPACES
from cosim.ssp.reader import read_ssp
from cosim.system.read import ReadSystem

SPACES = " ".join(f'xmlns:{prefix}="{space}"' for prefix, space in NAMESPACES.items())
UNITS = """<ssd:Units>
  <ssc:Unit name="m"><ssc:BaseUnit m="1"/></ssc:Unit>
  <ssc:Unit name="mm"><ssc:BaseUnit m="1" factor="0.001"/></ssc:Unit>
  <ssc:Unit name="N.m"><ssc:BaseUnit kg="1" m="2" s="-2"/></ssc:Unit>
</ssd:Units>"""
EXPERIMENT = '<ssd:DefaultExperiment startTime="0.0" stopTime="1.0"/>'


def description(system: str, *, units: str = UNITS, experiment: str = EXPERIMENT, version: str = "1.0") -> str:
    """A whole description around the content of its root system."""
    root = f'<ssd:System name="root">{system}</ssd:System>{units}{experiment}'
    head = f'<ssd:SystemStructureDescription {SPACES} version="{version}" name="by hand">'
    return f'<?xml version="1.0" encoding="UTF-8"?>{head}{root}</ssd:SystemStructureDescription>'


def archive(path: Path, text: str, fmus: Mapping[str, Path] | None = None, **files: str) -> Path:
    """An SSP of a description, FMUs by name and further files by name, whose endings are written as _ssv."""
    with zipfile.ZipFile(path, "w") as out:
        out.writestr("SystemStructure.ssd", text)
        for name, fmu in (fmus or {}).items():
            out.write(fmu, f"resources/{name}.fmu")
        for name, content in files.items():
            out.writestr(f"resources/{name.replace('_ss', '.ss')}", content)
    return path


def connectors(*items: str) -> str:
    """Connectors from `kind name` or `kind name unit`."""
    parts = []
    for item in items:
        kind, name, *unit = item.split()
        inner = f'<ssc:Real unit="{unit[0]}"/>' if unit else "<ssc:Real/>"
        parts.append(f'<ssd:Connector kind="{kind}" name="{name}">{inner}</ssd:Connector>')
    return f"<ssd:Connectors>{''.join(parts)}</ssd:Connectors>"


def component(name: str, fmu: str, *items: str, bindings: str = "", more: str = "") -> str:
    """A component with connectors."""
    inner = connectors(*items) if items else ""
    return f'<ssd:Component name="{name}" source="resources/{fmu}.fmu"{more}>{inner}{bindings}</ssd:Component>'


def connection(start: str, end: str, inner: str = "", more: str = "") -> str:
    """A connection between `element.connector`, or `.connector` of the system itself."""
    text = []
    for side, path in (("start", start), ("end", end)):
        element, _, name = path.partition(".")
        text.append((f'{side}Element="{element}" ' if element else "") + f'{side}Connector="{name}"')
    return f"<ssd:Connection {' '.join(text)}{more}>{inner}</ssd:Connection>"


def linear(factor: float, offset: float = 0.0) -> str:
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def elements(*items: str) -> str:
    return f"<ssd:Elements>{''.join(items)}</ssd:Elements>"


def connections(*items: str) -> str:
    return f"<ssd:Connections>{''.join(items)}</ssd:Connections>"


def parameter_set(*values: str, version: str = "1.0") -> str:
    """A parameter set from `name Type value` or `name Type value unit`."""
    parts = []
    for value in values:
        name, kind, text, *unit = value.split()
        more = f' unit="{unit[0]}"' if unit else ""
        parts.append(f'<ssv:Parameter name="{name}"><ssv:{kind} value="{text}"{more}/></ssv:Parameter>')
    return (
        f'<ssv:ParameterSet {SPACES} version="{version}" name="set"><ssv:Parameters>{"".join(parts)}</ssv:Parameters>'
        f"{UNITS.replace('ssd:', 'ssv:')}</ssv:ParameterSet>"
    )


def mapping(*entries: str) -> str:
    return f'<ssm:ParameterMapping {SPACES} version="1.0">{"".join(entries)}</ssm:ParameterMapping>'


def entry(source: str, target: str, inner: str = "", more: str = "") -> str:
    return f'<ssm:MappingEntry source="{source}" target="{target}"{more}>{inner}</ssm:MappingEntry>'


def bindings(*items: str) -> str:
    return f"<ssd:ParameterBindings>{''.join(items)}</ssd:ParameterBindings>"


def binding(*values: str, more: str = "", mapped: str = "") -> str:
    """An inline binding, or one of a file where `more` has a source."""
    inner = f"<ssd:ParameterValues>{parameter_set(*values)}</ssd:ParameterValues>" if values else ""
    inner += f"<ssd:ParameterMapping>{mapped}</ssd:ParameterMapping>" if mapped else ""
    return f"<ssd:ParameterBinding{more}>{inner}</ssd:ParameterBinding>"


def step_size_hint(value: str) -> str:
    """A step of its own for a component, as libcosim notes it."""
    return (
        '<ssd:Annotations><ssc:Annotation type="com.opensimulationplatform">'
        f'<osp:StepSizeHint xmlns:osp="http://opensimulationplatform.com/SSP/OSPAnnotations" value="{value}"/>'
        "</ssc:Annotation></ssd:Annotations>"
    )


def read(path: Path) -> ReadSystem:
    """Read an SSP; its FMUs go beside it."""
    return read_ssp(path, path.with_suffix(".unpacked"))


def start(path: Path) -> dict[str, float]:
    """Start values by `component.variable` that an SSP gives."""
    components = read(path).system.components.values()
    return {f"{c.name}.{name}": value for c in components for name, value in c.start.items()}
