"""The model description of the FMUs: the contract of names, units and start values, and reproducible archives."""

import math
import os
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from controller_fmu.model import MODEL as CONTROLLER
from fmu_export.modelling.units import rate_unit, unit
from fmu_export.modelling.variables import Layout
from fmu_export.package.interface import interface_of
from fmu_export.pythonfmu.backend import build_pythonfmu
from fmu_export.trace.trace import trace
from plant_fmu.model import MODEL as PLANT
from tests.support import some
from tests.support.bare_host import fresh
from tests.support.patience import PATIENCE
from trajectory_fmu.model import MODEL as TRAJECTORY

CHECKOUT = Path(__file__).resolve().parents[3]
MODELS = {m.name: m for m in (PLANT, CONTROLLER, TRAJECTORY)}
ALL = pytest.mark.parametrize("name", MODELS)

#: The contract: other people's tools use these names. (FMU, causality): "names unit; ...".
CONTRACT = {
    ("RobotPlant", "input"): "tau_a[3] tau_d[3] N.m; dm kg; dm_rate kg/s",
    (
        "RobotPlant",
        "output",
    ): "theta_a[3] theta_b[3] rad; omega_a[3] omega_b[3] rad/s; x_E y_E m; F_c[6] N.m; "
    "closure_error m; kinetic_energy J",
    (
        "RobotPlant",
        "parameter",
    ): "X Y Z kg.m2; m_a m_b kg; l r_a x_E_start y_E_start m; v_x_start v_y_start m/s; baumgarte s-1; rtol 1; "
    "max_step s",
    ("RobotController", "input"): "theta_a[3] theta_ref[3] rad; omega_a[3] omega_ref[3] rad/s; tau_ref[3] N.m",
    ("RobotController", "output"): "tau_a[3] N.m; psi[2] 1",
    (
        "RobotController",
        "parameter",
    ): "alpha k bound_angles bound_constant psi_start[2] feedforward 1; "
    "beta N.m.s/rad; S[3] leakage s-1; tau_max[3] N.m; rtol 1; max_step s",
    ("RobotTrajectory", "input"): "",
    ("RobotTrajectory", "output"): "theta_ref[3] rad; omega_ref[3] rad/s; x_ref y_ref m; tau_ref[3] N.m",
    ("RobotTrajectory", "parameter"): "x_c y_c b m; phase rad; w rad/s; n R a 1; X Y Z kg.m2",
}

#: Parameters that may change during a run.
TUNABLE = {
    "RobotPlant": "X Y Z baumgarte",
    "RobotController": "alpha beta S k leakage bound_angles bound_constant feedforward tau_max",
    "RobotTrajectory": "x_c y_c phase R a b X Y Z",
}

#: Dimensions by hand: (kg, m, s, rad).
DIMENSIONS = {
    "1": (0, 0, 0, 0),
    "s": (0, 0, 1, 0),
    "s-1": (0, 0, -1, 0),
    "m": (0, 1, 0, 0),
    "m/s": (0, 1, -1, 0),
    "kg": (1, 0, 0, 0),
    "kg/s": (1, 0, -1, 0),
    "kg.m2": (1, 2, 0, 0),
    "J": (1, 2, -2, 0),
    "N.m": (1, 2, -2, 0),
    "N.m.s/rad": (1, 2, -1, -1),
    "rad": (0, 0, 0, 1),
    "rad/s": (0, 0, -1, 1),
    "rad/s2": (0, 0, -2, 1),
}


def contract(name, causality):
    """Scalar names with their units."""
    result = {}
    for group in filter(None, CONTRACT[name, causality].split("; ")):
        *variables, unit_name = group.split()
        for variable in variables:
            base, size = re.fullmatch(r"(\w+)(?:\[(\d)\])?", variable).groups()
            for i in range(int(size or 1)):
                result[f"{base}[{i + 1}]" if size else base] = unit_name
    return result


def read(fmu: Path, member="modelDescription.xml"):
    with zipfile.ZipFile(fmu) as archive:
        return archive.read(member)


def root_of(fmu):
    return ET.fromstring(read(fmu))


def members(fmu: Path):
    with zipfile.ZipFile(fmu) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def variables(fmu):
    return {v.get("name"): v for v in root_of(fmu).iter("ScalarVariable")}


def text_starts(fmu):
    """Start values as `resources/start_values.txt` gives them, as text."""
    return dict(line.split(" = ") for line in read(fmu, "resources/start_values.txt").decode().splitlines())


@ALL
def test_fmpy_finds_nothing_to_complain_about(fmus, name):
    assert validate_fmu(str(fmus / f"{name}.fmu")) == []


def test_validation_can_fail(fmus, tmp_path):
    broken = tmp_path / "RobotController.fmu"
    files = members(fmus / "RobotController.fmu")
    xml = files["modelDescription.xml"].decode()
    files["modelDescription.xml"] = re.sub(r"<InitialUnknowns>.*</InitialUnknowns>", "", xml, flags=re.S).encode()
    with zipfile.ZipFile(broken, "w") as archive:
        for member, data in files.items():
            archive.writestr(member, data)
    assert validate_fmu(str(broken)) != []


@ALL
@pytest.mark.parametrize("causality", ["input", "output", "parameter"])
def test_contract_of_names_causalities_and_units(fmus, name, causality):
    found = {
        n: v.find("Real").get("unit")
        for n, v in variables(fmus / f"{name}.fmu").items()
        if v.get("causality") == causality
    }
    expected = contract(name, causality)
    if causality == "parameter":
        assert expected.items() <= found.items()
    else:
        assert found == expected


@ALL
def test_identifiers(fmus, name):
    root = root_of(fmus / f"{name}.fmu")
    assert root.get("fmiVersion") == "2.0"
    assert root.get("modelName") == name
    assert root.find("CoSimulation").get("modelIdentifier") == name
    assert root.find("ModelExchange") is None
    assert root.get("description")
    assert re.fullmatch(r"\{[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}\}", root.get("guid"))
    assert all(v.get("description") for v in root.iter("ScalarVariable"))
    # the time of building would make the bytes differ
    assert root.get("generationDateAndTime") is None
    for flag in ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate"):
        assert root.find("CoSimulation").get(flag) == "true"
    assert root.find("CoSimulation").get("needsExecutionTool") == "false"


@ALL
def test_variability_and_initial_of_each_causality(fmus, name):
    tunable = TUNABLE[name].split()
    for v in some(variables(fmus / f"{name}.fmu").values()):
        expected = {
            "parameter": ("tunable" if v.get("name").partition("[")[0] in tunable else "fixed", "exact"),
            "input": ("continuous", None),
            "output": ("continuous", "calculated"),
        }[v.get("causality")]
        assert (v.get("variability"), v.get("initial")) == expected
        assert ("start" in v.find("Real").attrib) == (v.get("causality") != "output")


@ALL
def test_value_references_are_positions(fmus, name):
    references = [int(v.get("valueReference")) for v in variables(fmus / f"{name}.fmu").values()]
    assert references == list(range(len(references)))


@ALL
def test_every_float_of_the_description_round_trips(fmus, name):
    found = 0
    for element in some(root_of(fmus / f"{name}.fmu").iter()):
        for key in ("start", "min", "max", "factor", "startTime", "stopTime", "stepSize"):
            text = element.get(key)
            if text is not None:
                assert repr(float(text)) == text
                assert math.isfinite(float(text))
                found += 1
    assert found > 15


@ALL
def test_start_values_are_the_same_everywhere(fmus, tmp_path, name):
    """Model, model description, start value file, and what an instance reports when nothing is set (through fmpy)."""
    fmu, model = fmus / f"{name}.fmu", MODELS[name]
    described = {n: v.find("Real").get("start") for n, v in variables(fmu).items() if v.get("causality") != "output"}
    declared = dict(zip(model.parameters.names, model.parameters.starts, strict=True))
    if model.states:
        declared |= {"rtol": 1e-5, "max_step": 1e300}
    declared |= dict(zip(model.inputs.names, model.inputs.starts, strict=True))
    assert described == {n: repr(float(s)) for n, s in declared.items()}
    assert text_starts(fmu) == described
    script = """
import fmpy
from fmpy.fmi2 import FMU2Slave
description = fmpy.read_model_description(A.fmu)
slave = FMU2Slave(guid=description.guid, unzipDirectory=str(fmpy.extract(A.fmu, os.path.abspath("x"))),
                  modelIdentifier=description.coSimulation.modelIdentifier, instanceName="x")
slave.instantiate()
known = [v for v in description.modelVariables if v.causality != "output"]
references = [v.valueReference for v in known]
slave.setupExperiment()
slave.enterInitializationMode()
early = slave.getReal(references)
slave.exitInitializationMode()
assert slave.getReal(references) == early
slave.doStep(0.0, 0.001)
assert slave.getReal(references) == early
slave.terminate()
slave.freeInstance()
report(dict(zip((v.name for v in known), early)))
"""
    reported = fresh(tmp_path, script, fmu=fmu)
    assert {n: repr(v) for n, v in reported.items()} == described


@ALL
def test_minima_maxima_are_those_of_the_model_and_hold_for_the_start_values(fmus, name):
    model = MODELS[name]
    found = {
        n: (v.find("Real").get("min"), v.find("Real").get("max")) for n, v in variables(fmus / f"{name}.fmu").items()
    }
    declared = [v for layout in (model.parameters, model.inputs, model.outputs) for v in layout.variables]
    expected = {n: tuple(None if b is None else repr(b) for b in (v.min, v.max)) for v in declared for n in v.names}
    if model.states:
        expected |= {"rtol": ("0.0", "0.1"), "max_step": ("1e-09", None)}
    assert found == expected
    for n, text in some(text_starts(fmus / f"{name}.fmu").items()):
        lower, upper = found[n]
        assert float(lower or -math.inf) <= float(text) <= float(upper or math.inf)


@ALL
def test_default_experiment(fmus, name):
    experiment = root_of(fmus / f"{name}.fmu").find("DefaultExperiment")
    assert {k: float(v) for k, v in experiment.attrib.items()} == {
        "startTime": 0,
        "stopTime": 15,
        "stepSize": 1e-3,
    }


# Units


@ALL
def test_units_have_the_right_dimensions_and_display_units(fmus, name):
    root = root_of(fmus / f"{name}.fmu")
    used = {v.find("Real").get("unit") for v in root.iter("ScalarVariable")}
    defined = {u.get("name"): u for u in root.iter("Unit")}
    assert defined.keys() == used
    for unit_name, element in defined.items():
        base = element.find("BaseUnit")
        assert base.get("factor") is None  # SI already
        assert base.get("offset") is None
        assert tuple(int(base.get(k, 0)) for k in ("kg", "m", "s", "rad")) == DIMENSIONS[unit_name]
        assert set(base.attrib) <= {"kg", "m", "s", "rad"}
    shown = {d.get("name"): float(d.get("factor")) for u in defined.values() for d in u.iter("DisplayUnit")}
    # FMI 2.0, section 2.2.2: display value = factor * value
    one = {"mm": 1000.0, "deg": math.degrees(1.0), "deg/s": math.degrees(1.0)}
    assert shown == {d: one[d] for d in shown}
    for v in some(root.iter("ScalarVariable")):
        real = v.find("Real")
        expected = {"m": "mm", "rad": "deg", "rad/s": "deg/s"}.get(real.get("unit"))
        assert real.get("displayUnit") == expected


def test_fmpy_reads_the_display_units_with_their_factors(fmus):
    description = fmpy.read_model_description(str(fmus / "RobotPlant.fmu"))
    by_name = {v.name: v for v in description.modelVariables}
    assert by_name["theta_a[1]"].declaredType is None
    factors = {d.name: d.factor for u in description.unitDefinitions for d in u.displayUnits}
    assert factors == {"mm": 1000.0, "deg": math.degrees(1.0), "deg/s": math.degrees(1.0)}


def test_units_are_those_by_hand():
    for name, exponents in DIMENSIONS.items():
        assert tuple(unit(name).exponents.get(k, 0) for k in ("kg", "m", "s", "rad")) == exponents


@pytest.mark.parametrize(
    ("name", "exponents", "rate"),
    [
        ("N.m/(rad.s)", {"kg": 1, "m": 2, "s": -3, "rad": -1}, "N.m/(rad.s2)"),
        ("rad.s", {"s": 1, "rad": 1}, "rad"),
        ("s", {"s": 1}, "1"),
        ("1/s", {"s": -1}, "s-2"),
        ("V.A", {"kg": 1, "m": 2, "s": -3}, "V.A/s"),
        ("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}, "N.m/rad"),
        ("m/m", {}, "s-1"),
    ],
)
def test_products_of_units(name, exponents, rate):
    assert unit(name).exponents == exponents
    assert rate_unit(name) == rate
    assert unit(rate).exponents == {
        k: n for k in unit("kg.m.s.A.rad").exponents if (n := exponents.get(k, 0) - (k == "s"))
    }


@pytest.mark.parametrize("name", ["furlongs_", "", "/", "N.", "m/", "m/()", "m/s/s", "m 2", "m0", "rad/(s", "wibble"])
def test_unknown_unit_is_refused_with_the_remedy(name):
    with pytest.raises(
        ValueError, match=rf"unit '{re.escape(name)}': '.*' is not defined; write a product of kg, m, s"
    ):
        unit(name)


# Structure


@ALL
def test_structure_lists_all_outputs_with_the_dependencies_of_the_equations(fmus, name):
    """Against the expression graphs; that these are right is shown in test_trace."""
    root = root_of(fmus / f"{name}.fmu")
    names = [v.get("name") for v in root.iter("ScalarVariable")]
    outputs = [n for n, v in variables(fmus / f"{name}.fmu").items() if v.get("causality") == "output"]
    interface = interface_of(trace(MODELS[name]))
    for tag, rows in (
        ("Outputs", interface.dependencies),
        ("InitialUnknowns", interface.initial_dependencies),
    ):
        unknowns = root.findall(f"ModelStructure/{tag}/Unknown")
        assert [names[int(u.get("index")) - 1] for u in unknowns] == outputs
        for unknown, row in zip(unknowns, rows, strict=True):
            dependencies = [int(i) - 1 for i in unknown.get("dependencies").split()]
            assert dependencies == list(row)
            assert unknown.get("dependenciesKind").split() == ["dependent"] * len(row)


def test_direct_feedthrough_that_a_master_must_know(fmus):
    """What the order of exchange follows from: no measurement depends on a torque, but the control torque on all."""

    def inputs_of(name, output):
        root = root_of(fmus / f"{name}.fmu")
        names = [v.get("name") for v in root.iter("ScalarVariable")]
        unknown = next(
            u for u in root.findall("ModelStructure/Outputs/Unknown") if names[int(u.get("index")) - 1] == output
        )
        return {names[int(i) - 1] for i in unknown.get("dependencies").split()}

    for measured in ("theta_a[1]", "omega_a[3]", "x_E", "closure_error"):
        assert inputs_of("RobotPlant", measured) == set()
    every_torque = {f"tau_{which}[{i}]" for which in "ad" for i in (1, 2, 3)}
    assert inputs_of("RobotPlant", "F_c[1]") == every_torque | {"dm", "dm_rate"}
    assert inputs_of("RobotPlant", "kinetic_energy") == {"dm"}
    # s_1 of (32) needs the errors of joint 1 only, Pi of (89) all measurements
    measured = {f"{v}_a[{i}]" for v in ("theta", "omega") for i in (1, 2, 3)}
    assert inputs_of("RobotController", "tau_a[1]") == measured | {"theta_ref[1]", "omega_ref[1]", "tau_ref[1]"}
    assert inputs_of("RobotController", "psi[1]") == set()


# Fingerprint and bytes


def guid(model, folder):
    return root_of(build_pythonfmu(model, folder)).get("guid")


def with_parameter(model, name, **changes):
    changed = [replace(v, **changes) if v.name == name else v for v in model.parameters.variables]
    return replace(model, parameters=Layout(changed))


#: Of the controller's outputs the last two are states, whose outputs are the states themselves.
DOUBLE_TORQUE = np.array([2.0, 2.0, 2.0, 1.0, 1.0])

CHANGES = {
    "nothing": lambda m: m,
    "start value": lambda m: with_parameter(m, "alpha", start=1.5),
    "start value by one ulp": lambda m: with_parameter(
        m, "alpha", start=math.nextafter(m.parameters.unpack(m.parameters.starts).alpha, 2.0)
    ),
    "description": lambda m: replace(m, description=m.description + "."),
    "description of a variable": lambda m: with_parameter(m, "alpha", description="Another text"),
    "minimum": lambda m: with_parameter(m, "alpha", min=-1.0),
    "unit": lambda m: with_parameter(m, "alpha", unit="s"),
    "output equation": lambda m: replace(
        m, output_values=lambda t, x, u, p: DOUBLE_TORQUE * m.output_values(t, x, u, p)
    ),
    "state equation": lambda m: replace(m, derivatives=lambda t, x, u, p: 2 * m.derivatives(t, x, u, p)),
    "initial state": lambda m: replace(m, initial_state=lambda p: 2 * m.initial_state(p)),
    "name": lambda m: replace(m, name="OtherController"),
    "default experiment": lambda m: replace(m, default_experiment=replace(m.default_experiment, stop_time=1.0)),
}


def test_guid_and_module_names_depend_on_the_content(tmp_path):
    guids, packages = {}, {}
    for i, (what, change) in enumerate(CHANGES.items()):
        fmu = build_pythonfmu(change(CONTROLLER), tmp_path / str(i))
        guids[what] = root_of(fmu).get("guid")
        packages[what] = read(fmu, "resources/slavemodule.txt")
    assert len(set(guids.values())) == len(CHANGES)
    assert len(set(packages.values())) == len(CHANGES)
    assert guid(CONTROLLER, tmp_path / "again") == guids["nothing"]


def test_guid_depends_on_the_code_around_the_equations(tmp_path, monkeypatch):
    """A corrected slave or entry must not run as its older version: both are in the fingerprint."""
    from fmu_export.pythonfmu import backend as pythonfmu_backend
    from fmu_export.trace import straight_line

    before = guid(CONTROLLER, tmp_path / "0")
    monkeypatch.setattr(straight_line, "HEADER", straight_line.HEADER + "\n# a change\n")
    between = guid(CONTROLLER, tmp_path / "1")
    monkeypatch.setattr(pythonfmu_backend, "_ENTRY", pythonfmu_backend._ENTRY + "\n# a change\n")
    after = guid(CONTROLLER, tmp_path / "2")
    assert len({before, between, after}) == 3


BUILD = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from fmu_export.pythonfmu.backend import build_pythonfmu
from controller_fmu.model import MODEL as CONTROLLER
from trajectory_fmu.model import MODEL as TRAJECTORY
from plant_fmu.model import MODEL as PLANT
for model in (PLANT, CONTROLLER, TRAJECTORY):
    build_pythonfmu(model, Path(sys.argv[2]))
"""


def build_elsewhere(folder: Path, checkout: Path, seed: str) -> Path:
    """Build all FMUs in a process of its own, in another folder, with another seed of Python's hashes."""
    work = folder / f"work{seed}"
    work.mkdir(parents=True)
    environment = {**os.environ, "PYTHONHASHSEED": seed, "TZ": f"UTC+{seed}", "PYTHONDONTWRITEBYTECODE": "1"}
    subprocess.run(
        [sys.executable, "-c", BUILD, str(checkout), "fmus"],
        cwd=work,
        env=environment,
        check=True,
        timeout=PATIENCE,
    )
    return work / "fmus"


def test_the_same_sources_give_the_same_bytes(tmp_path):
    builds = [build_elsewhere(tmp_path, CHECKOUT, seed) for seed in ("1", "4")]
    for name, model in MODELS.items():
        here = build_pythonfmu(model, tmp_path / "here").parent
        first, second, third = ((folder / f"{name}.fmu").read_bytes() for folder in (*builds, here))
        assert first == second
        assert first == third


@ALL
def test_archive_holds_no_times_and_no_paths_of_the_building_machine(fmus, tmp_path, name):
    """Also not when it is built from a checkout elsewhere: no member may name the path of either."""
    fmu = fmus / f"{name}.fmu"
    with zipfile.ZipFile(fmu) as archive:
        assert archive.testzip() is None
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert archive.namelist()[0] == "modelDescription.xml"
        assert len(set(archive.namelist())) == len(archive.namelist())
    environment = Path(sys.prefix)
    for forbidden in (str(CHECKOUT), str(fmus), str(environment), "site-packages"):
        for member, data in some(members(fmu).items()):
            assert forbidden.encode() not in data, (forbidden, member)
            assert not member.endswith((".pyc", "~"))


@ALL
def test_archive_holds_what_a_stranger_needs(fmus, name):
    files = set(members(fmus / f"{name}.fmu"))
    assert {f"binaries/linux64/{name}.so", f"binaries/win64/{name}.dll"} <= files
    assert "resources/start_values.txt" in files
    assert "documentation/licenses/pythonfmu.txt" in files
    assert b"MIT" in read(fmus / f"{name}.fmu", "documentation/licenses/pythonfmu.txt")


def test_names_with_special_characters_survive_the_xml(tmp_path):
    """Descriptions are free text: markup, quotes, and more must come back as they were."""
    text = "a < b & \"c\" > 'd' {e} %s\u2264 \u03b8"
    model = with_parameter(replace(CONTROLLER, description=text), "alpha", description=text)
    fmu = build_pythonfmu(model, tmp_path)
    assert validate_fmu(str(fmu)) == []
    assert root_of(fmu).get("description") == text
    assert variables(fmu)["alpha"].get("description") == text
    host = "c = Host(A.fmu); assert c.initialize() == 0; c.run(1); report(c.get('alpha'))"
    assert fresh(tmp_path, host, fmu=fmu) == [CONTROLLER.parameters.starts[0]]
