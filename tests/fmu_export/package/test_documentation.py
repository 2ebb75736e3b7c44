"""What an FMU says about itself: page, reference result, licence, icons and terminals."""

import os
import re
import struct
import subprocess
import sys
import zlib
from dataclasses import replace
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.util import read_csv
from lxml import etree
from scipy.integrate import solve_ivp

import fmu_export.package.metadata as metadata
from fmu_export.errors import DocumentationError
from fmu_export.modelling.variables import Layout, Variable
from fmu_export.package.description_common import package_version
from fmu_export.package.documentation import reference_run
from fmu_export.package.interface import interface_of
from fmu_export.trace.trace import trace
from tests.support import some
from tests.support.fmu_documentation import MODELS, Page, members_of, page_of, parsed, terminals
from tests.support.stiff_models import robertson
from tests.support.tiny_models import ALL as TINY
from tests.support.tiny_models import GAIN, ROOT

CHECKOUT = Path(__file__).resolve().parents[3]
#: Pictures that the pages show.
FIGURES = {"RobotPlant": ["geometry.svg"], "RobotTrajectory": ["path.svg"]}
ALL = pytest.mark.parametrize("name", MODELS)


@pytest.fixture(scope="module")
def members():
    """Members of the archives by model and flavour."""
    return {
        (name, flavour): members_of(model, page_of(name), flavour)
        for name, model in MODELS.items()
        for flavour in ("pythonfmu", "fmi2", "fmi3")
    }


@ALL
@pytest.mark.parametrize("flavour", ["pythonfmu", "fmi2", "fmi3"])
def test_page_is_well_formed_and_names_its_origin(members, name, flavour):
    page = parsed(members[name, flavour])
    text = page.text["body"]
    assert page.text["title"] == page.text["h1"] == name
    assert MODELS[name].description in text
    assert package_version() in text
    assert f"flavour {flavour}" in text
    assert "FMI 3.0" in text if flavour == "fmi3" else "FMI 2.0" in text


def test_mismatched_tags_are_noticed():
    with pytest.raises(AssertionError):
        Page("<p><b>x</p></b>")


@ALL
def test_every_variable_is_in_the_table(members, name):
    header = ["name", "causality", "variability", "unit", "start", "min", "max", "description"]
    rows = parsed(members[name, "fmi2"]).rows
    table = rows[rows.index(header) + 1 :]
    variables = interface_of(trace(MODELS[name])).variables
    assert [row[0] for row in table] == [v.name for v in variables]
    for row, v in zip(table, variables, strict=True):
        assert row[1:4] == [v.causality, v.variability, v.unit]
        assert row[7] == v.description
        for cell, number in zip(row[4:7], (v.start, v.min, v.max), strict=True):
            assert cell == "" if number is None else float(cell) == pytest.approx(number, rel=1e-11)


@ALL
def test_page_loads_nothing_but_its_figures(members, name):
    html = members[name, "fmi3"]["documentation/index.html"].decode()
    page = parsed(members[name, "fmi3"])
    assert {tag for tag, _ in page.elements}.isdisjoint({"script", "link", "iframe", "object", "embed"})
    shown = FIGURES.get(name, [])
    assert page.attributes("src") == [("img", figure) for figure in shown]
    assert len(page.attributes("alt")) == len(shown)
    for figure in shown:
        picture = etree.fromstring(members[name, "fmi3"][f"documentation/{figure}"])
        assert picture.tag == "{http://www.w3.org/2000/svg}svg"
        assert not picture.xpath("//*[local-name() = 'script' or local-name() = 'image']")
    assert "@import" not in html
    assert all(value.startswith("#") for value in html.split("url(")[1:])
    assert all(value.startswith("#") for _, value in page.attributes("xlink:href"))


@ALL
def test_links_have_targets(members, name):
    files = members[name, "fmi3"]
    page = parsed(files)
    anchors = [value for _, value in page.attributes("id")]
    assert len(anchors) == len(set(anchors))
    for _, value in some(page.attributes("href")):
        if value.startswith("#"):
            assert value[1:] in anchors
        elif not value.startswith("https://"):
            assert f"documentation/{value}" in files


@ALL
def test_markdown_is_converted(members, name):
    page = parsed(members[name, "fmi2"])
    assert page.text["h2"].startswith(page_of(name).partition("\n")[0].removeprefix("# "))
    text = page.text["body"]
    assert "|---" not in text
    assert "```" not in text
    assert "\n- " not in text
    assert "$" not in text
    equations = page_of(name).replace("$$", "$").count("$") // 2
    assert [tag for tag, _ in page.elements].count("math") == equations > 10
    tables = sum(tag == "table" for tag, _ in page.elements)
    assert tables == 1 + page_of(name).count("|---|---|---|---|---|\n") + page_of(name).count("\n|---|---|---|\n")


def test_html_is_escaped_wherever_it_stands():
    evil = "<script>alert('&amp;')</script>"
    u = replace(GAIN.inputs.variables[0], description=evil)
    model = replace(GAIN, description=evil, inputs=Layout([u]))
    page = parsed(
        members_of(model, f"# {evil}\n\n{evil}\n\n<div>{evil}</div>\n\n| a | b |\n|---|---|\n| {evil} | < |\n")
    )
    assert "script" not in {tag for tag, _ in page.elements}
    assert page.text["body"].count(evil.replace("&amp;", "&")) + page.text["body"].count(evil) >= 6


def equations(page):
    """The equations of a page: their displays, and the text of each."""
    html = members_of(GAIN, page)["documentation/index.html"].decode()
    found = [etree.fromstring(m) for m in re.findall(r"<math.*?</math>", html, re.DOTALL)]
    return [m.get("display") for m in found], ["".join(m.itertext()) for m in found]


def test_equations_are_typeset_wherever_they_stand():
    page = "# T $a_1$\n\n$$\n\\frac{a}{b} \\\\ c < d\n$$\n\n- $x_{E}$ and $y_E$\n\n| a |\n|---|\n| $*m*$ |\n"
    assert equations(page) == (
        ["inline", "block", "inline", "inline", "inline"],
        ["a1", "abc<d", "xE", "yE", "*m*"],
    )


def test_a_dollar_is_no_equation_in_code_nor_alone():
    assert equations("`$HOME` costs 5 $ or more, and `$a$`\n") == ([], [])


@pytest.mark.parametrize(("equation", "why"), [(r"a^", "MissingSuper"), (r"\thetta_a", r"\thetta is unknown")])
def test_an_equation_that_can_not_be_typeset_is_an_error(equation, why):
    with pytest.raises(DocumentationError, match=re.escape(f"the equation ${equation}$ can't be typeset: {why}")):
        members_of(GAIN, f"${equation}$")


def test_a_figure_that_is_missing_is_an_error():
    with pytest.raises(DocumentationError, match=r"Gain: the page shows curve.svg, which is not among its figures"):
        members_of(GAIN, "![curve](curve.svg)")


@ALL
@pytest.mark.parametrize("flavour", ["pythonfmu", "fmi2", "fmi3"])
def test_members(members, name, flavour):
    common = {
        *(f"documentation/{figure}" for figure in FIGURES.get(name, [])),
        "documentation/index.html",
        f"documentation/reference/{name}_in.csv",
        f"documentation/reference/{name}_ref.csv",
        "documentation/licenses/license.txt",
    }
    icons = {f"terminalsAndIcons/{n}" for n in ("terminalsAndIcons.xml", "icon.png", "input.png", "output.png")}
    assert set(members[name, flavour]) == common | (icons if flavour == "fmi3" else {"model.png"})


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_process():
    script = (
        "import hashlib\n"
        "from tests.support.fmu_documentation import MODELS, members_of, page_of\n"
        "for name, model in MODELS.items():\n"
        "    for flavour in ('fmi2', 'fmi3'):\n"
        "        for member, data in sorted(members_of(model, page_of(name), flavour).items()):\n"
        "            print(name, flavour, member, hashlib.sha256(data).hexdigest())\n"
    )
    digests = [
        subprocess.run(
            [sys.executable, "-c", script],
            env={**os.environ, "PYTHONHASHSEED": seed, "TZ": zone, "SOURCE_DATE_EPOCH": epoch},
            cwd=CHECKOUT,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed, zone, epoch in (("1", "UTC", "0"), ("2", "Asia/Tokyo", "1000000000"))
    ]
    assert digests[0].count("\n") == len(MODELS) * (5 + 8) + 2 * len(FIGURES)
    assert digests[0] == digests[1]


def png_size(data):
    """Width and height; checks the chunks' sums and that nothing but the picture is in it."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    kinds, position = [], 8
    while position < len(data):
        (length,) = struct.unpack(">I", data[position : position + 4])
        body = data[position + 4 : position + 8 + length]
        assert zlib.crc32(body) == struct.unpack(">I", data[position + 8 + length : position + 12 + length])[0]
        kinds.append(body[:4])
        position += 12 + length
    assert set(kinds) <= {b"IHDR", b"pHYs", b"IDAT", b"IEND"}
    return struct.unpack(">II", data[16:24])


@ALL
def test_icons_are_pictures(members, name):
    assert png_size(members[name, "fmi2"]["model.png"]) == (64, 64)
    assert members[name, "fmi2"]["model.png"] == members[name, "fmi3"]["terminalsAndIcons/icon.png"]
    for icon in ("input", "output"):
        assert png_size(members[name, "fmi3"][f"terminalsAndIcons/{icon}.png"]) == (16, 16)


def test_icons_tell_the_models_apart(members):
    assert len({members[name, "fmi2"]["model.png"] for name in MODELS}) == len(MODELS)


@ALL
def test_terminals_group_the_vectors(members, name):
    model = MODELS[name]
    vectors = {v.name: list(v.names) for v in (*model.inputs.variables, *model.outputs.variables) if v.size}
    assert terminals(model, members[name, "fmi3"]) == vectors


@pytest.mark.parametrize("model", TINY, ids=lambda m: m.name)
def test_every_kind_of_model_has_valid_terminals(model):
    sizes = [v.size for v in (*model.inputs.variables, *model.outputs.variables) if v.size]
    assert [len(t) for t in terminals(model, members_of(model)).values()] == sizes


def written(tmp_path, members, name):
    """The reference files of a model as fmpy reads them."""
    tables = []
    for kind in ("in", "ref"):
        path = tmp_path / f"{name}_{kind}.csv"
        path.write_bytes(members[name, "fmi2"][f"documentation/reference/{path.name}"])
        tables.append(read_csv(path))
    return tables


def array(table, names):
    return np.array([table[n] for n in names]).T.reshape(len(table), len(names))


@ALL
def test_reference_is_what_another_integrator_finds(members, name, tmp_path):
    """DOP853, inputs from the file and held from row to row."""
    model = MODELS[name]
    inputs, reference = written(tmp_path, members, name)
    time, p = inputs["time"], model.parameters.starts
    assert np.array_equal(time, reference["time"])
    np.testing.assert_allclose(time, 0.01 * np.arange(201), rtol=0, atol=1e-12)
    U = array(inputs, model.inputs.names)
    x = model.initial_state(p)
    found = [model.output_values(time[0], x, U[0], p)]
    for t, t_end, u in zip(time, time[1:], U, strict=False):
        if model.states:
            held = lambda t, x, u=u: model.derivatives(t, x, u, p)  # noqa: E731
            x = solve_ivp(held, (t, t_end), x, "DOP853", rtol=1e-10, atol=1e-12, first_step=t_end - t).y[:, -1]
        found.append(model.output_values(t_end, x, u, p))
    np.testing.assert_allclose(array(reference, model.outputs.names), found, rtol=0, atol=1e-8)


def test_the_reference_of_a_stiff_model_is_integrated_as_such():
    """Radau; Runge-Kutta with the steps of the others would not stay finite."""
    model = robertson()
    run = reference_run(model)
    found = solve_ivp(
        lambda t, x: model.derivatives(t, x, [], []),
        (0.0, run.time[-1]),
        model.initial_state([]),
        "Radau",
        rtol=1e-12,
        atol=1e-16,
    )
    np.testing.assert_allclose(run.outputs[-1], found.y[:, -1], rtol=1e-9)


@ALL
def test_inputs_of_the_reference_are_all_different(members, name, tmp_path):
    inputs, _ = written(tmp_path, members, name)
    columns = [tuple(inputs[n]) for n in MODELS[name].inputs.names]
    assert len(set(columns)) == len(columns)
    assert all(np.ptp(c) > 0.09 for c in columns)


@ALL
def test_fmu_gives_the_reference_as_the_page_says(members, name, fmus, tmp_path):
    inputs, reference = written(tmp_path, members, name)
    result = fmpy.simulate_fmu(
        str(fmus / f"{name}.fmu"),
        fmi_type="CoSimulation",
        stop_time=2.0,
        output_interval=0.01,
        input=inputs if len(MODELS[name].inputs) else None,
    )
    names = MODELS[name].outputs.names
    np.testing.assert_allclose(array(result, names), array(reference, names), rtol=0, atol=1e-8)


@ALL
def test_usage_on_the_page_runs(members, name, fmus, tmp_path):
    files = members[name, "pythonfmu"]
    for member, data in files.items():
        (tmp_path / member).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / member).write_bytes(data)
    (tmp_path / f"{name}.fmu").write_bytes((fmus / f"{name}.fmu").read_bytes())
    html = files["documentation/index.html"].decode()
    code = Page(html[html.index("<h2>How to use it</h2>") : html.index("</body>")]).text["code"]
    subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(CHECKOUT), os.environ.get("PYTHONPATH", "")]),
        },
        check=True,
        capture_output=True,
    )
    assert (tmp_path / "results.csv").is_file()


def test_licence_is_the_projects(members):
    expected = (CHECKOUT / "LICENSE").read_text(encoding="utf-8").encode()
    assert members["RobotPlant", "fmi2"]["documentation/licenses/license.txt"] == expected


def test_licence_is_found_without_installation(monkeypatch):
    def missing(distribution):
        raise PackageNotFoundError(distribution)

    monkeypatch.setattr(metadata, "files", missing)
    assert "MIT License" in metadata.project_licence.__wrapped__()


def test_missing_licence_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setattr(metadata, "files", lambda distribution: None)
    monkeypatch.setattr(metadata, "__file__", str(tmp_path / "fmu_export" / "package" / "metadata.py"))
    with pytest.raises(DocumentationError, match="licence"):
        metadata.project_licence.__wrapped__()


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_reference_that_is_not_finite_is_an_error():
    with pytest.raises(DocumentationError, match="Root: the reference run from the start values is not finite"):
        members_of(replace(ROOT, inputs=Layout([Variable("u", "1", "Negative", start=-1.0)])))
