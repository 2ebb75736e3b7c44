"""The report: what is in the page, that it is the same each time, and that it works in a browser."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import re
import runpy
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cosim.master.simulation import Simulation
from parallel_robot.live.page import live_section
from parallel_robot.paper.report import REPORT, write_report
from parallel_robot.paper.report.prose import number, prose
from parallel_robot.paper.report.series import OPEN_LOOP
from parallel_robot.paper.reproduce.content import (
    Claim,
    Condition,
    Controller,
    Erratum,
    PaperFigure,
    Reading,
    Reproduction,
    TableRow,
    TheoremCheck,
)
from parallel_robot.scenario import load_scenario
from tests.support import some
from tests.support.browser import Tabs, accessible, fits, walked
from tests.support.html import Elements
from tests.support.native_fmus import DEFAULT_FLAVOUR

STOP, ONSET, STEADY = 3.0, 1.0, 2.0
GAINS = {"pd": (0.0, 1.662), "10": (2.0655, 2.1671)}
NASTY = "</script><img src=x onerror=alert(1)> & \"quotes\" 'too'"


def claim(number: int, verdict: str, text: str = "The error falls as mu/nu rises.") -> Claim:
    return Claim(
        id=f"claim-{number}",
        where="section 6",
        claim=text,
        runs=("pd, disturbed",),
        metric="" if verdict == "cannot be judged" else "steady_error",
        relation="<",
        threshold=None if verdict == "cannot be judged" else 1e-6,
        unit="m",
        values={"x, mu/nu = 10": 3.1e-3},
        met=0,
        total=1,
        verdict=verdict,
        why="It is 3.1e-3 m.",
    )


@pytest.fixture(scope="module")
def results(robot_fmus: Path):
    """(controller, condition) -> results of short runs, and those in open loop under None."""
    found = {}
    for name, condition in (("tracking", "disturbed"), ("tracking-undisturbed", "nominal")):
        scenario = load_scenario(name)
        with Simulation(scenario.system(robot_fmus, DEFAULT_FLAVOUR), order=scenario.order) as simulation:
            for key, (alpha, beta) in GAINS.items():
                start = {"controller.alpha": alpha, "controller.beta": beta}
                found[key, condition] = simulation.run(STOP, 1e-3, start=start)
    scenario = load_scenario("open-loop")
    with Simulation(scenario.system(robot_fmus, DEFAULT_FLAVOUR), order=scenario.order) as simulation:
        found[None] = simulation.run(STOP, 1e-3)
    return found


def reading(assumption: str, condition: Condition, x: float, y: float) -> Reading:
    """A reading with these steady errors (m) of the end effector, which are also its largest."""
    return Reading(
        *(assumption, condition, "coupled FMUs", {"x": x, "y": y}, {"x": (-x, x), "y": (-y, y)}, 0.07, 0.2, 0.5, 0.1),
        *(("(38)",), "cosim run tracking --stop 60" if "60 s" in assumption else ""),
    )


@pytest.fixture(scope="module")
def content(results, tmp_path_factory: pytest.TempPathFactory) -> Reproduction:
    folder = tmp_path_factory.mktemp("figures")
    figures = []
    for n, size in ((4, 100), (8, 700_000)):  # the second is too large for a vector figure
        svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 5"><!--{"x" * size}--></svg>'
        (folder / f"{n}.svg").write_text(svg)
        png = base64.b64decode(
            "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGNoAAAAggCBd81ytgAAAABJRU5ErkJggg=="
        )
        (folder / f"{n}.png").write_bytes(png)
        alt = f'alternative <{n}> "in words"'
        figures.append(PaperFigure(n, f"Title {n}", "Caption", alt, folder / f"{n}.svg", folder / f"{n}.png"))
    closed = {key: value for key, value in results.items() if key is not None}
    runs = SimpleNamespace(  # the part of `Runs` that the page reads
        controllers=(
            Controller("pd", "PD", 1.0, 1.0, *GAINS["pd"]),
            Controller("10", r"$\mu/\nu$ = 10", 10.0, 1.0, *GAINS["10"]),
        ),
        closed_loop=closed,
        open_loop=results[None],
        accumulated={},
        pd_same_beta={},
        pd_same_effort={},
        disturbed=(),
        least_bound={},
        readings=(
            reading("as printed, for 60 s", "disturbed", 3.75e-3, 4.43e-3),
            reading("nominal feedforward <b>", "nominal", 4.4e-8, 5e-12),
        ),
        steady_after=STEADY,
        disturbed_from=ONSET,
        info={"flavour": DEFAULT_FLAVOUR, "step_size": 1e-3, "extrapolation": {"mode": "auto", "hold": []}},
    )
    check = TheoremCheck(
        *("10", "disturbed", (0.25, 0.25), 1.6, 2.0, 3.0, 0.5, -1.0, 0.1, 1.0, 2.0, 0.5, 3.0, 4.0, 5.0, 0.0, 0.0, 1.0),
        *(1.0, {"time": (0.0, 15.0), "V": (0.02, 0.004), "printed": (0.02, 0.4), "corrected": (0.02, 0.5)}),
    )
    verdicts = ("holds", "holds in part", "does not hold", "cannot be judged", "does not hold")
    return Reproduction(
        runs=runs,
        table1=(TableRow(1.0, 1.0, 1.35976, 1.662, 9.1329, "1.3597", "1.6620", "9.1329", agrees=True),),
        figures=tuple(figures),
        claims=(*(claim(i, v) for i, v in enumerate(verdicts)), claim(9, "holds", NASTY)),
        errata=(Erratum("a1", "section 6, A1", "(0, 0)", NASTY, "Computed.", {"gap (m)": 0.25}, shown=True),),
        theorem1=(check,),
        versions={"closed-chain-cosim": "1.2.3", "python": "3"},
    )


@pytest.fixture(scope="module")
def page(content: Reproduction, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(content, tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="module")
def html(page: Path) -> str:
    return page.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def elements(html: str) -> Elements:
    return Elements(html)


def embedded(html: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.S)[1])


def block(html: str, name: str) -> bytes:
    """A deflated part of the page."""
    return zlib.decompress(
        base64.b64decode(re.search(rf'<script type="text/plain" id="{name}">(.*?)</script>', html)[1])
    )


def columns_of(html: str, run: dict) -> dict[str, np.ndarray]:
    """Columns of a run as the page has them: undoes folding and both differences of the bits, modulo 2^32."""
    n = run["rows"]
    octets = np.frombuffer(block(html, run["block"]), "u1").reshape(-1, 4, n)
    folded = np.ascontiguousarray(octets.transpose(0, 2, 1)).view("<u4")[:, :, 0]
    second = (folded >> 1) ^ (0 - (folded & 1))
    bits = np.cumsum(np.cumsum(second, axis=1, dtype="u4"), axis=1, dtype="u4")
    return dict(zip(run["names"], bits.view("<f4"), strict=True))


# ---- numbers


def test_data_of_the_page_are_those_of_the_runs(html, content, results):
    data = embedded(html)["robot"]
    keys = [run["key"] for run in data["runs"]]
    assert keys == ["pd/disturbed", "10/disturbed", "pd/nominal", "10/nominal", OPEN_LOOP]
    assert [run["onset"] for run in data["runs"]] == [ONSET, ONSET, None, None, None]
    for run in data["runs"]:
        columns = columns_of(html, run)
        key, _, condition = run["key"].partition("/")
        expected = results[(key, condition) if condition else None]
        time = run["start"] + run["step"] * np.arange(run["rows"])
        assert time == pytest.approx(expected.time[::10], abs=1e-9)
        assert columns["E_x"] == pytest.approx(expected["plant.x_E"][::10], rel=1e-6)
        l, x_A, y_A = run["robot"]["l"], run["robot"]["x_A"], run["robot"]["y_A"]
        for i in (1, 2, 3):  # the chains as the script draws them meet at the end effector
            a, b = columns[f"a{i}"], columns[f"b{i}"]
            assert x_A[i - 1] + l * (np.cos(a) + np.cos(b)) == pytest.approx(columns["E_x"], abs=1e-6)
            assert y_A[i - 1] + l * (np.sin(a) + np.sin(b)) == pytest.approx(columns["E_y"], abs=1e-6)
        if condition:
            error = np.abs(expected["plant.y_E"] - expected["trajectory.y_ref"])
            total = np.trapezoid(error, expected.time)
            assert columns["sum_y"][-1] == pytest.approx(total, rel=1e-6)
            assert columns["y"] == pytest.approx(columns["E_y"] - columns["d_y"], abs=1e-7)
        else:
            assert "error" not in columns


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1e-6 m", "10<sup>−6</sup> m"),
        ("-2.5e-13", "−2.5·10<sup>−13</sup>"),
        ("mu/nu <= 0.1, beta", "μ/ν ≤ 0.1, β"),
        ("theta_a[1] and S_ii", "θ<sub>a1</sub> and S<sub>ii</sub>"),
        ("A M^(-1/2), |Z|^2", "A M<sup>−1/2</sup>, |Z|<sup>2</sup>"),
        ("max_step, alphabet, x-y, 0.1-0.3", "max_step, alphabet, x-y, 0.1-0.3"),
        ("V >= lambda_M_min, g = -C theta_e'", "V ≥ λ<sub>M min</sub>, g = −C θ<sub>e</sub>'"),
        ("c in R^n, F(theta', delta)", "c in R<sup>n</sup>, F(θ', δ)"),
        ("<b> & c", "&lt;b&gt; &amp; c"),
    ],
)
def test_plain_notation_is_set_for_the_page(text, expected):
    assert prose(text) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.0, "0"),
        (-0.5, "−0.5"),
        (123.456, "123.5"),
        (-12345.6, "−12346"),
        (3.1e-5, "3.1·10<sup>−5</sup>"),
        (1e-12, "10<sup>−12</sup>"),
    ],
)
def test_numbers_are_set_for_the_page(value, expected):
    assert number(value) == expected


# ---- the page as text


def test_the_same_content_gives_the_same_bytes_however_long_the_runs_took(content, page, tmp_path):
    slow = {}
    for key, run in content.runs.closed_loop.items():
        slow[key] = dataclasses.replace(run, info={**run.info, "loop_time_s": 99.0, "wall_time_s": 99.0})
    runs = SimpleNamespace(**{**vars(content.runs), "closed_loop": slow})
    again = write_report(dataclasses.replace(content, runs=runs), tmp_path)
    assert again.name == REPORT
    assert again.read_bytes() == page.read_bytes()


def test_the_page_needs_nothing_else(html, elements):
    addresses = [a[k] for _, a, _ in elements.all for k in ("src", "href", "action", "data", "poster") if k in a]
    outside = [a for a in addresses if not a.startswith(("#", "data:"))]
    assert outside == ["https://doi.org/10.1007/s11071-021-06739-y"]
    assert "@import" not in html
    assert "url(" not in html
    assert not {"link", "iframe", "object", "embed"} & {tag for tag, _, _ in elements.all}


def test_the_security_policy_is_for_this_script_and_loads_nothing(html, elements):
    (policy,) = [a["content"] for tag, a, _ in elements.all if a.get("http-equiv") == "Content-Security-Policy"]
    for kind in ("style", "script"):
        (text,) = re.findall(rf"<{kind}>(.*?)</{kind}>", html, re.S)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{digest}'" in policy
    assert "unsafe" not in policy
    assert "default-src 'none'" in policy
    assert not any("style" in a for _, a, _ in elements.all)


def test_tags_match_and_names_are_unique(elements):
    assert elements.open == []
    ids = [a["id"] for _, a, _ in elements.all if "id" in a]
    assert len(ids) == len(set(ids))
    for _, a, _ in elements.all:
        assert a.get("aria-labelledby", ids[0]) in ids
        if a.get("href", "").startswith("#"):
            assert a["href"][1:] in ids


def test_everything_has_a_text_alternative(elements):
    for tag, a, above in elements.all:
        if tag == "img" and "dialog" not in above:
            assert a["alt"]
        if tag == "canvas":
            assert a.get("aria-label") or a.get("aria-hidden") == "true"
        if tag in ("select", "input"):
            assert a.get("aria-label") or "label" in above, a
        if tag == "th":
            assert a["scope"] in ("col", "row")
    assert sum(tag == "figure" for tag, _, _ in elements.all) == sum(tag == "figcaption" for tag, _, _ in elements.all)


def test_readings_say_which_reach_what_is_printed(html):
    section = re.search(r'<section id="readings".*?</section>', html, re.S)[0]
    assert "1 of 2 have steady errors as small" in section
    assert "None stays within the main axes" in section
    rows = re.findall(r"<details><summary>.*?</details>", section, re.S)
    assert ["not reached" in row for row in rows] == [True, False]
    assert ["leaves them by" in row for row in rows] == [True, False]
    assert "3.75·10<sup>−3</sup>, 4.43·10<sup>−3</sup>" in rows[0]
    assert "nominal feedforward &lt;b&gt;" in rows[1]
    commands = [re.sub("<[^>]*>", "", "".join(re.findall("<code>.*?</code>", row))) for row in rows]
    assert commands == ["cosim run tracking --stop 60", ""]
    bars = [float(w) for w in re.findall(r'class="bar" y="4" width="([\d.]+)"', section)]
    line = float(re.search(r"M([\d.]+) 0V", section)[1])
    assert bars[0] > line > bars[1] > 0.0


def test_V_is_drawn_below_its_envelopes(html):
    """Four decades for 0.004 to 0.5 J would be one too many; equal values lie at one height."""
    figure = re.search(r'<figure class="envelope">.*?</figure>', html, re.S)[0]
    ends = {}
    for name in ("V", "printed", "corrected"):
        points = re.search(rf'<path class="{name}" d="M([^"]*)"', figure)[1].split("L")
        ends[name] = [tuple(map(float, point.split())) for point in points]
    assert len({first for first, _ in ends.values()}) == 1
    last = {name: y for name, (_, (_, y)) in ends.items()}
    assert last["V"] > last["printed"] > last["corrected"]  # y points downwards
    assert re.findall(r'text-anchor="end">([\d.]+)</text>', figure) == ["0.001", "0.01", "0.1", "1"]
    assert "After 15 s V is 0.004 J, and the envelopes are 0.4 and 0.5 J" in " ".join(figure.split())


def test_texts_stay_texts(html, elements):
    assert "<img src=x" not in html
    assert html.count("</script>") == 2 + 5 + 2  # data and script, runs, figures
    assert not any(name.startswith("on") for _, a, _ in elements.all for name in a)


def test_every_claim_erratum_and_figure_is_there(html, content):
    for c in some(content.claims):
        assert f'id="claim-{c.id}" data-verdict="{c.verdict}"' in html
    assert 'aria-label="Verdicts on 6 claims"' in html
    assert 'id="erratum-a1"' in html
    assert re.findall(r'<figure id="figure-(\d+)">', html) == ["4", "8"]
    assert re.findall(r'data-kind="image/([a-z+]+)"', html) == ["svg+xml", "png"]
    assert block(html, "figure-4-data") == content.figures[0].svg.read_bytes()
    assert block(html, "figure-8-data") == content.figures[1].png.read_bytes()
    assert "9.132900 <small>9.1329</small>" in html


def test_versions_and_hashes_are_there_and_no_paths(html, content):
    for fmu in some(content.runs.open_loop.info["fmus"].values()):
        assert fmu["sha256"] in html
        assert fmu["path"] not in html
    assert "closed-chain-cosim 1.2.3" in html
    assert r"\mu" not in html


def test_a_figure_that_is_not_there_is_an_oserror(content, tmp_path):
    figure = dataclasses.replace(content.figures[0], svg=tmp_path / "none.svg")
    with pytest.raises(OSError, match=r"none\.svg"):
        write_report(dataclasses.replace(content, figures=(figure,)), tmp_path)


def test_the_animation_of_the_readme(robot_fmus, tmp_path):
    scenario = load_scenario("tracking")
    with Simulation(scenario.system(robot_fmus, DEFAULT_FLAVOUR), order=scenario.order) as simulation:
        simulation.run(12.7, 5e-3).to_csv(tmp_path / "results.csv")
    script = runpy.run_path(str(Path(__file__).parents[3] / "docs/make_animation.py"))
    script["main"](str(tmp_path / "results.csv"), str(tmp_path / "robot.svg"))
    text = (tmp_path / "robot.svg").read_text(encoding="utf-8")
    assert len(text) < 200_000
    assert Elements(text).open == []
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "")
    for values in some(re.findall(r'values="([^"]*)"', text)):
        assert len(values.split(";")) == script["FRAMES"] + 1
        assert "nan" not in values


# ---- the page in a browser


@pytest.fixture
def opened(browser, page):
    """Function that opens the page; afterwards nothing may have been logged or loaded."""
    tabs = Tabs(browser)

    def open_page(width=1200, height=1100, motion="reduce", clock=False, **options):
        tab = tabs.open(page, width=width, height=height, reduced_motion=motion, clock=clock, **options)
        tab.wait_for_selector(".player[data-state]")
        tab.wait_for_selector(".errors[data-curves]")
        return tab

    yield open_page
    tabs.close()


def shown(tab, name: str, of: str = ".player") -> str:
    return tab.locator(of).get_attribute(f"data-{name}")


def until(tab, condition, seconds: float = 20.0) -> None:
    """Wait; Playwright's own wait_for_function evaluates strings, which the page's policy forbids."""
    for _ in range(round(20 * seconds)):
        if condition():
            return
        tab.wait_for_timeout(50)
    pytest.fail("it did not come about")


def picture(tab, stage: int) -> str:
    return tab.evaluate("n => document.querySelectorAll('.stage canvas')[n].toDataURL()", stage)


@pytest.mark.slow
def test_play_and_pause(opened):
    tab = opened()
    assert (shown(tab, "state"), float(shown(tab, "time"))) == ("paused", 0.0)
    before = picture(tab, 0)
    tab.click(".play")
    until(tab, lambda: float(shown(tab, "time")) > 0.5)
    assert shown(tab, "state") == "playing"
    assert tab.inner_text(".play") == "Pause"
    tab.click(".play")
    time = shown(tab, "time")
    tab.wait_for_timeout(200)
    assert (shown(tab, "state"), shown(tab, "time"), tab.inner_text(".play")) == ("paused", time, "Play")
    assert float(tab.input_value(".timeline input")) == pytest.approx(float(time), abs=0.006)
    assert picture(tab, 0) != before
    assert picture(tab, 0) != picture(tab, 1)
    assert "Paused at" in tab.inner_text(".player [role=status]")


@pytest.mark.slow
def test_it_ends_and_starts_again(opened):
    tab = opened()
    tab.select_option(".speed", "4")
    tab.click(".play")
    until(tab, lambda: shown(tab, "state") == "paused")
    assert float(shown(tab, "time")) == STOP
    tab.select_option(".speed", "0.1")
    tab.click(".play")
    until(tab, lambda: float(shown(tab, "time")) < STOP)
    tab.click(".restart")
    assert float(shown(tab, "time")) < 1.0


@pytest.mark.slow
def test_speed_and_smoothness(opened):
    """Seconds of the robot in a second of a clock that the test moves, and frames: one for each that is asked for."""
    tab = opened(clock=True)
    tab.clock.pause_at(tab.evaluate("Date.now()") + 1000)
    for speed in ("0.25", "1"):
        tab.select_option(".speed", speed)
        assert shown(tab, "speed") == speed
        tab.click(".restart")
        tab.click(".play")
        tab.clock.run_for(100)
        time, frames = float(shown(tab, "time")), int(shown(tab, "frames"))
        tab.clock.run_for(800)
        tab.click(".play")
        assert float(shown(tab, "time")) - time == pytest.approx(0.8 * float(speed), abs=0.02)
        assert 40 <= int(shown(tab, "frames")) - frames <= 60


def test_scrub_by_slider_and_by_keys(opened):
    tab = opened()
    tab.locator(".timeline input").fill("1.5")
    assert float(shown(tab, "time")) == 1.5
    tab.focus(".player")
    for key, expected in (("ArrowRight", 1.6), ("Shift+ArrowLeft", 0.6), ("End", STOP), ("Home", 0.0)):
        tab.keyboard.press(key)
        assert float(shown(tab, "time")) == pytest.approx(expected)
    tab.keyboard.press(" ")
    assert shown(tab, "state") == "playing"
    tab.keyboard.press(" ")
    assert shown(tab, "state") == "paused"
    tab.focus(".play")  # there, space is the button's own: once, not twice
    tab.keyboard.press(" ")
    assert shown(tab, "state") == "playing"
    tab.focus(".timeline input")
    tab.keyboard.press(" ")
    assert shown(tab, "state") == "paused"
    tab.focus(".trail")
    tab.keyboard.press(" ")
    assert not tab.is_checked(".trail")
    assert shown(tab, "state") == "paused"
    assert "of 3 seconds" in tab.get_attribute(".timeline input", "aria-valuetext")


def test_choice_of_the_runs(opened):
    tab = opened()
    assert (shown(tab, "left"), shown(tab, "right")) == ("pd/disturbed", "10/disturbed")
    tab.locator(".timeline input").fill("2")
    readings = {}
    for key in ("10/nominal", OPEN_LOOP, "pd/disturbed"):
        tab.locator(".stage select").first.select_option(key)
        assert shown(tab, "left") == key
        readings[key] = (tab.locator(".readout").first.inner_text(), picture(tab, 0))
    assert len({picture_ for _, picture_ in readings.values()}) == 3
    assert "error – mm" in readings[OPEN_LOOP][0]
    assert re.search(r"error \d\.\d\d mm", readings["pd/disturbed"][0])
    tab.locator(".stage select").nth(1).select_option("pd/disturbed")
    assert picture(tab, 0) == picture(tab, 1)  # one clock, the same run
    tab.uncheck(".two")
    assert shown(tab, "right") == ""
    assert not tab.locator(".stage").nth(1).is_visible()


@pytest.mark.slow
def test_what_is_drawn_can_be_chosen(opened):
    tab = opened()
    tab.locator(".timeline input").fill("2")
    seen = {picture(tab, 0)}
    for box, on in ((".forces", False), (".torques", True), (".trail", False)):
        tab.set_checked(f".controls {box}", on)
        seen.add(picture(tab, 0))
    tab.check("input[value=path]", force=True)
    seen.add(picture(tab, 0))
    assert len(seen) == 5
    tab.emulate_media(color_scheme="dark")
    until(tab, lambda: picture(tab, 0) not in seen)


@pytest.mark.slow
def test_the_links_move(opened):
    tab = opened()
    tab.locator(".stage select").first.select_option(OPEN_LOOP)
    for box in (".forces", ".trail"):
        tab.uncheck(f".controls {box}")
    pictures = set()
    for time in ("0.5", "1.5", "2.5"):
        tab.locator(".timeline input").fill(time)
        pictures.add(picture(tab, 0))
    assert len(pictures) == 3


@pytest.mark.slow
def test_it_starts_in_view_unless_stillness_is_preferred(opened):
    still, moving = opened(), opened(motion="no-preference")
    for tab in (still, moving):
        tab.locator(".stage canvas").first.scroll_into_view_if_needed()
        tab.evaluate("document.querySelector('.stages').scrollIntoView()")
    moving.wait_for_selector(".player[data-state=playing]")
    assert shown(still, "state") == "paused"


def test_claims_are_filtered(opened):
    tab = opened()
    rows, status = tab.locator(".claim:visible"), tab.locator(".claims [role=status]")
    assert (rows.count(), status.inner_text()) == (6, "all 6 claims")
    tab.click('[data-filter="does not hold"]')
    assert (rows.count(), status.inner_text()) == (2, "2 of 6 claims")
    assert set(rows.evaluate_all("rows => rows.map((r) => r.dataset.verdict)")) == {"does not hold"}
    tab.click('[data-filter="all"]')
    tab.fill(".claims input", "CLAIM-3")
    assert rows.count() == 1
    tab.keyboard.press("Tab")
    tab.keyboard.press("Enter")
    assert "It is" in rows.first.inner_text()


def test_plot_zooms_by_drag_and_shows_values(opened):
    tab = opened()
    tab.locator(".errors .u-over").scroll_into_view_if_needed()
    box = tab.locator(".errors .u-over").bounding_box()
    middle = box["y"] + box["height"] / 2

    def at(share):
        return box["x"] + share * box["width"]

    tab.mouse.move(at(0.5), middle)
    assert float(shown(tab, "cursor", ".errors")) == pytest.approx(1.5, abs=0.02)
    assert re.search(r"at 1\.[45]\d s", tab.inner_text(".errors thead"))
    values = tab.locator(".errors tbody tr:visible output").all_inner_texts()
    assert len(values) == 6
    assert all(float(v) > 0.0 for v in values)
    tab.mouse.move(at(1 / 3), middle)
    tab.mouse.down()
    tab.mouse.move(at(2 / 3), middle + 5, steps=4)
    tab.mouse.up()
    assert float(shown(tab, "from", ".errors")) == pytest.approx(1.0, abs=0.02)
    assert float(shown(tab, "to", ".errors")) == pytest.approx(2.0, abs=0.02)
    tab.mouse.dblclick(at(0.5), middle)
    assert (shown(tab, "from", ".errors"), shown(tab, "to", ".errors")) == ("0.000", "3.000")
    tab.click(".steady")
    assert float(shown(tab, "from", ".errors")) == STEADY
    tab.click(".reset")
    assert tab.is_disabled(".reset")


def test_plot_of_other_quantities_conditions_and_curves(opened):
    tab = opened()
    assert shown(tab, "curves", ".errors") == "2"
    tab.check("input[name=condition][value=nominal]")
    assert shown(tab, "curves", ".errors") == "4"
    tab.locator(".errors tbody input").first.uncheck()
    assert shown(tab, "curves", ".errors") == "3"
    peaks = set()
    for quantity in ("x", "sum_q3", "tau1", "closure"):
        tab.select_option(".quantity", quantity)
        assert shown(tab, "quantity", ".errors") == quantity
        peaks.add(tab.locator(".errors tbody tr:visible output").nth(4).inner_text())
    assert len(peaks) == 4
    tab.select_option(".quantity", "x")
    plain = tab.evaluate("document.querySelector('.errors canvas').toDataURL()")
    tab.check(".log")
    assert tab.evaluate("document.querySelector('.errors canvas').toDataURL()") != plain


@pytest.mark.slow
def test_plot_by_keys(opened):
    tab = opened()
    tab.focus(".errors .plot-area")
    tab.keyboard.press("ArrowRight")
    assert float(shown(tab, "cursor", ".errors")) == pytest.approx(1.515)
    assert "at 1.515 s: PD" in tab.locator(".errors [role=status]").inner_text()
    tab.keyboard.press("+")
    assert float(shown(tab, "from", ".errors")) > 0.5
    tab.keyboard.press("Escape")
    assert shown(tab, "from", ".errors") == "0.000"


@pytest.mark.slow
def test_figures_open_large(opened):
    tab = opened()
    tab.locator("figure .enlarge").first.click()
    assert tab.locator("dialog").is_visible()
    assert "Title 4" in tab.inner_text("dialog p")
    tab.keyboard.press("Escape")
    assert not tab.locator("dialog").is_visible()


@pytest.mark.slow
def test_it_fits_a_phone_and_small_type_is_legible(opened):
    tab = opened(width=390, height=844, is_mobile=True, has_touch=True, device_scale_factor=2)
    fits(tab)
    robot = tab.locator(".stage canvas").first.bounding_box()
    assert robot["y"] + robot["height"] < 844  # in the first screen
    assert tab.locator(".claim").first.bounding_box()["height"] < 50  # a line
    tab.click("#readings .folded > summary")
    assert {row.bounding_box()["height"] < 50 for row in some(tab.locator(".readings > details").all())} == {True}
    tab.evaluate("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    fits(tab)
    sizes = tab.evaluate(
        "[...document.querySelectorAll('p, td, label, button')].filter((e) => e.offsetWidth > 2)"
        ".map((e) => parseFloat(getComputedStyle(e).fontSize))"
    )
    assert min(sizes) >= 12.0
    tab.tap(".play")
    tab.wait_for_selector(".player[data-state=playing]")


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_everybody_can_use_it(opened, width, scheme):
    tab = opened(width=width, color_scheme=scheme)
    tab.evaluate("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    accessible(tab)
    fits(tab)
    walked(tab)


@pytest.mark.slow
def test_links_lead_into_folded_parts(opened):
    tab = opened(width=390)
    assert not tab.locator("#erratum-a1").is_visible()
    tab.evaluate("location.hash = 'erratum-a1'")
    until(tab, lambda: tab.locator("#erratum-a1").is_visible())


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_contrast_is_enough(opened, scheme):
    """WCAG AA: 4.5 for text, 3 for lines, against what is behind them."""
    tab = opened(color_scheme=scheme)
    pairs = {
        ("ink", "page"): 4.5,
        ("ink", "card"): 4.5,
        ("muted", "page"): 4.5,
        ("muted", "stage"): 4.5,
        ("accent", "card"): 4.5,
        ("on-accent", "accent"): 4.5,
        **{(name, f"{name}-soft"): 4.5 for name in ("good", "part", "bad", "open")},
        **{(f"chain-{i}", "stage"): 3.0 for i in (1, 2, 3)},
        ("second", "card"): 3.0,
        ("actual", "desired-band"): 3.0,
    }
    colour = "name => getComputedStyle(document.documentElement).getPropertyValue('--' + name).trim()"

    def luminance(name):
        text = tab.evaluate(colour, name).lstrip("#")
        digits = text if len(text) == 6 else "".join(2 * c for c in text)
        rgb = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
        r, g, b = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgb)
        return 0.2126 * r + 0.7152 * g + 0.0722 * b

    for pair, least in pairs.items():
        dark, light = sorted(map(luminance, pair))
        assert (light + 0.05) / (dark + 0.05) >= least, pair


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_gains_can_be_turned_in_it(browser, content, tmp_path, robot_fmus, width):
    pytest.importorskip("ziglang", reason="nothing here compiles WebAssembly: pip install ziglang")
    page = write_report(content, tmp_path, live=live_section(robot_fmus))
    tabs = Tabs(browser)
    tab = tabs.open(page, width=width)
    until(tab, lambda: int(tab.get_attribute(".live", "data-runs") or 0) >= 1)
    assert shown(tab, "left") == "pd/disturbed"
    tab.evaluate("document.querySelectorAll('details').forEach((d) => (d.open = true))")
    accessible(tab)
    fits(tab)
    tabs.close()
