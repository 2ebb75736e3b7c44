"""What annotations say of a run: the communication step, steps of components, and isolation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from cosim.files.xml_elements import child, children
from cosim.ssp.errors import SSPError
from cosim.ssp.format.description import TOOL
from cosim.ssp.format.document import Document
from cosim.ssp.format.structure import Part
from cosim.system.read import STEPS, assumed_stop_time, fitting_step, longest_experiment, multiple_of_step

if TYPE_CHECKING:
    from xmlschema import DataElement

#: Attributes by which other tools note the communication step: libcosim, OMSimulator.
_STEP_SIZES = {"FixedStepAlgorithm": "baseStepSize", "FixedStepMaster": "stepSize"}

#: Annotation of libcosim for the step of a component.
_STEP_OF_COMPONENT = {"StepSizeHint": "value"}


def times_of(
    document: Document,
    root: Part,
    start_time: float | None = None,
    stop_time: float | None = None,
    duration: float | None = None,
) -> tuple[float, float | None]:
    """Start and stop time (s); where the description has no stop time, the latest of its FMUs' default experiments.

    Parameters
    ----------
    document : Document
    root : Part
    start_time, stop_time : float, optional
        The times (s) that a user wants.
    duration : float, optional
        How long the run is (s) where nothing says when it stops.
    """
    experiment = child(document.content, "DefaultExperiment")
    said = {} if experiment is None else experiment.attrib
    start_time = float(said.get("startTime", 0.0)) if start_time is None else start_time
    stop_time = said.get("stopTime") if stop_time is None else stop_time
    if stop_time is not None:
        return start_time, float(stop_time)
    fmus = [part.ports.description for part in root.all_parts() if part.ports is not None]
    found = longest_experiment(fmus, start_time)
    if found is not None:
        document.findings.note(
            f"{document.where}: has no stop time; {found:g} s is taken, the latest of its FMUs' default experiments"
        )
    elif duration is not None:
        found = start_time + duration
        document.findings.note(assumed_stop_time(document.where, start_time, duration))
    return start_time, found


def step_size_of(document: Document, root: Part, times: tuple[float, float | None]) -> float | None:
    """The communication step (s): from annotations, else the smallest that an FMU asks for, else a share of the run.

    Parameters
    ----------
    document : Document
    root : Part
    times : tuple of float
        Start and stop time (s), as `times_of` gives them.

    Raises
    ------
    SSPError
        An annotation is malformed.
    """
    description = document.content
    for holder in (child(description, "DefaultExperiment"), root.element, description):
        for step in _numbers(holder, _STEP_SIZES, document):
            return step
    for annotation in children(root.element, "Annotations", "Annotation"):
        if any(_name(element) == "VariableStepMaster" for element in annotation.iter()):
            document.findings.note(f"{document.where}: its steps are controlled by OMSimulator; here the step is fixed")
    experiments = [p.ports.description.defaultExperiment for p in root.all_parts() if p.ports is not None]
    steps = [float(e.stepSize) for e in experiments if e is not None and e.stepSize is not None]
    if not steps:
        hints = (_numbers(part.element, _STEP_OF_COMPONENT, part.document) for part in root.all_parts())
        steps = [step for found in hints for step in found]
    smallest = min((s for s in steps if s > 0 and math.isfinite(s)), default=None)
    start_time, stop_time = times
    if stop_time is None:
        return smallest
    if smallest is not None:
        step = fitting_step(stop_time - start_time, smallest)
        if step == smallest:
            return smallest
        document.findings.note(
            f"{document.where}: the run is not a whole number of steps of {smallest:g} s, the smallest that an FMU "
            f"asks for; {step:g} s is taken"
        )
        return step
    step = (stop_time - start_time) / STEPS
    document.findings.note(
        f"{document.where}: neither it nor its FMUs have a default step; {step:g} s is taken, {STEPS} steps in all"
    )
    return step


def steps_of(part: Part, step_size: float | None) -> int:
    """Of how many communication steps (s) a step of a component is made."""
    for step in _numbers(part.element, _STEP_OF_COMPONENT, part.document):
        here = f"{part.document.where}: component '{part.path}'"
        return multiple_of_step(step, step_size, f"{here}: StepSizeHint", part.document.findings)
    return 1


def is_isolated(part: Part) -> bool:
    """Whether our annotation wants the FMU of a component in a process of its own.

    Raises
    ------
    SSPError
        It says neither true nor false.
    """
    said = [str(element.attrib.get("isolate", "false")) for element in _of_ours(part)]
    if wrong := next((text for text in said if text not in ("true", "false")), None):
        where = f"{part.document.where}: component '{part.path}'"
        raise SSPError(f"{where}: isolate is '{wrong}' in its annotation; write true or false")
    return "true" in said


def place_of(part: Part) -> str | None:
    """Where our annotation wants the FMU of a component, if it says it."""
    return next((str(text) for element in _of_ours(part) if (text := element.attrib.get("place"))), None)


def _of_ours(part: Part) -> Iterator[DataElement]:
    """What our annotations of a component have."""
    for annotation in children(part.element, "Annotations", "Annotation"):
        if annotation.attrib.get("type") == TOOL:
            yield from annotation.iter()


def _numbers(holder: DataElement | None, attributes: dict[str, str], document: Document) -> Iterator[float]:
    """Numbers that annotations of an element have."""
    for annotation in children(holder, "Annotations", "Annotation"):
        for element in annotation.iter():
            text = element.attrib.get(attributes.get(_name(element), ""))
            if text is None:
                continue
            try:
                yield float(text)
            except ValueError:
                raise SSPError(f"{document.where}: the step size '{text}' in an annotation is not a number") from None


def _name(element: DataElement) -> str:
    return str(element.tag).rpartition("}")[2]
