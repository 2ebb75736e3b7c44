"""FMUs with the features of the Reference FMUs, compared with results in their archives, as those bring them along.

Their results follow from closed forms: Euler's explicit method multiplies by 1 + h a step, a counter counts.
"""

from __future__ import annotations

import re
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cosim.fmi.fmu_file import read_fmu
from cosim.regression.outcome import check
from cosim.regression.run import ScheduledOnly, interfaces_of
from cosim.regression.shipped import FOLDER, MANIFEST, Shipped, shipped_cases
from tests.support import CHECKOUT, SUPPORT, some
from tests.support.c_fmus import binary, compile_c, packed
from tests.support.fmi3_events import state_space
from tests.support.regression_fmus import built_fmus

_MANIFEST = """<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0-alpha.1">
<Related type="text/csv" source="{0}_out.csv" role="result" description="Output of the default experiment"/>
</fmiReferences>"""


def with_result(fmu: Path, header: str, rows: list[str]) -> Shipped:
    """The case of an FMU that gets a result; no description in the manifest, as those of version alpha.1 lack it."""
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.writestr(MANIFEST, _MANIFEST.format(fmu.stem))
        archive.writestr(f"{FOLDER}{fmu.stem}_out.csv", "\n".join([header, *rows]) + "\n")
    return shipped_cases(fmu, fmu.parent / "unpacked")


def test_state_space(tmp_path):
    """The arrays x' = x + u, y = x + u, with the matrices 1, from 0: Euler's method gives x = u ((1 + h)^n - 1)."""
    fmu = state_space(tmp_path)
    u = np.array([1.0, 2.0, 3.0])
    y = [u * 2.0**n for n in range(11)]
    found = with_result(fmu, "time,y", [f"{n}," + " ".join(map(repr, row.tolist())) for n, row in enumerate(y)])
    (case,) = found.cases
    outcome = check(case, fmu, "co_simulation", isolated=False)
    assert outcome.findings == []
    assert [signal.name for signal in outcome.signals] == ["y[1]", "y[2]", "y[3]"]


_STAIR = """<fmiModelDescription fmiVersion="2.0" modelName="Stair" guid="{stair}" numberOfEventIndicators="0">
<ModelExchange modelIdentifier="Stair"/>
<CoSimulation modelIdentifier="Stair" canHandleVariableCommunicationStepSize="true"/>
<DefaultExperiment startTime="0" stopTime="10" stepSize="0.2"/>
<ModelVariables>
<ScalarVariable name="counter" valueReference="1" causality="output" variability="discrete" initial="exact">
<Integer start="1"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="1"/></Outputs></ModelStructure>
</fmiModelDescription>"""


@pytest.mark.parametrize("interface", ["co_simulation", "model_exchange"])
def test_stair(tmp_path, interface):
    """A counter by time events, which ends the simulation at 9 s with the last row in place."""
    library = compile_c(SUPPORT / "fmi2_stair.c", tmp_path / "Stair.so")
    fmu = packed(tmp_path / "Stair.fmu", _STAIR, {binary("Stair"): library})
    times = [n / 5 for n in range(46)]
    (case,) = with_result(fmu, "time,counter", [f"{t!r},{1 + n // 5}" for n, t in enumerate(times)]).cases
    outcome = check(case, fmu, interface, isolated=False)
    assert outcome.findings == []
    assert outcome.signals[0].result.values[-1] == 10.0


@pytest.mark.parametrize("interface", ["co_simulation", "model_exchange"])
def test_bouncing_ball(tmp_path, interface):
    """A state event: flights in closed form, each with 0.7 of the speed of the one before."""
    fmu = tmp_path / "Ball.fmu"
    shutil.copyfile(built_fmus() / "Ball.fmu", fmu)
    g, until, speed, rows = 9.81, (2.0 / 9.81) ** 0.5, (2.0 * 9.81) ** 0.5, []
    begin, v0, h0 = 0.0, 0.0, 1.0
    for n in range(151):
        t = n / 100
        while t > until:
            speed *= 0.7
            begin, v0, h0, until = until, speed, 0.0, until + 2.0 * speed / g
        s = t - begin
        rows.append(f"{t!r},{h0 + v0 * s - g * s * s / 2!r},{v0 - g * s!r}")
    (case,) = with_result(fmu, "time,h,v", rows).cases
    outcome = check(case, fmu, interface, isolated=False)
    assert (outcome.findings, outcome.unclear, len(outcome.signals)) == ([], "", 2)


def test_the_page_of_features_names_tests_that_exist():
    page = (CHECKOUT / "docs" / "matrix.md").read_text(encoding="utf-8")
    for name in some(re.findall(r"`(\w+/test_\w+\.py)`", page)):
        assert (CHECKOUT / "tests" / name).is_file(), name


def test_what_has_scheduled_execution_only_is_refused_in_one_line(tmp_path):
    description = """<fmiModelDescription fmiVersion="3.0" modelName="Clocks" instantiationToken="{clocks}">
<ScheduledExecution modelIdentifier="Clocks"/>
<ModelVariables><Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
</ModelVariables><ModelStructure/></fmiModelDescription>"""
    fmu = tmp_path / "Clocks.fmu"
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", description)
    with pytest.raises(ScheduledOnly, match="has scheduled execution only, which is not run; export co-simulation"):
        interfaces_of(read_fmu(fmu, "Clocks.fmu"))
