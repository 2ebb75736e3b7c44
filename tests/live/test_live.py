"""The live view: rows reach the page, commands reach the run, and nobody else is let in."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest

from cosim import Results, Simulation, System
from cosim.live.feed import LiveView
from cosim.live.page import live_page
from tests.support.browser import accessible, chromium, fits, until
from tests.support.patience import PATIENCE, wait_for
from tests.support.small_fmus import build
from tests.support.tiny_models import GAIN, INTEGRATOR

pytest.importorskip("tornado", reason="the live view is not tried: pip install tornado")


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("live"), "fmi2", GAIN, INTEGRATOR)


def tank(fmus: Path) -> System:
    system = System()
    system.add("tank", fmus / "Integrator.fmu", start={"u": 1.0})
    system.add("gain", fmus / "Gain.fmu", start={"u[2]": 0.5})
    system.connect("tank.x", "gain.u[1]")
    return system


def test_what_can_be_set_is_known(fmus: Path) -> None:
    settable = Simulation(tank(fmus)).settable
    assert list(settable) == ["tank.u", "gain.u[2]"]
    assert settable["gain.u[2]"]["value"] == 0.5
    assert settable["tank.u"]["unit"] == "1"


class Going:
    """A run in real time with a live view, in a thread."""

    def __init__(self, fmus: Path, realtime: float = 1.0, stop_time: float = 1000.0) -> None:
        self.results: Results | None = None
        self.view: LiveView | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._go, args=(fmus, realtime, stop_time))
        self._thread.start()
        assert self._ready.wait(PATIENCE)

    def _go(self, fmus: Path, realtime: float, stop_time: float) -> None:
        with (
            Simulation(tank(fmus)) as s,
            LiveView("A tank", s.names, s.types, s.units, s.settable, 0.0, stop_time) as self.view,
        ):
            self._ready.set()
            self.results = s.run(
                stop_time, 0.01, realtime=realtime, observe=self.view.observe, steering=self.view.steering
            )

    def end(self) -> Results:
        assert self.view is not None
        self.view.steering.stop()
        self._thread.join()
        assert self.results is not None
        return self.results


@pytest.fixture
def going(fmus: Path) -> Iterator[Going]:
    run = Going(fmus)
    yield run
    run.end()


def post(address: str, body: Any, origin: str | None) -> int:
    headers = {} if origin is None else {"Origin": origin}
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    try:
        with urlopen(Request(f"{address}command", data, headers), timeout=PATIENCE) as answer:
            return int(answer.status)
    except HTTPError as error:
        return error.code


def test_commands_of_the_page_reach_the_run_and_those_of_others_do_not(going: Going) -> None:
    assert going.view is not None
    address = going.view.address
    own = address.rpartition("/")[0].rpartition("/")[0]
    assert address.startswith("http://127.0.0.1:")
    assert post(address, {"set": {"tank.u": -3.0}}, own) == 200
    assert post(address, {"set": {"tank.u": 5.0}}, "https://elsewhere.example") == 403
    assert post(address, {"set": {"tank.u": 5.0}}, None) == 403
    assert post(address, b"no JSON", own) == 400
    assert post(address, {"other": 1}, own) == 400
    assert post(address, {"set": {"tank.u": "5"}}, own) == 400
    assert post(address, {"set": [1]}, own) == 400
    assert post(own + "/guess/", {"stop": True}, own) == 404
    with pytest.raises(HTTPError, match="421"):
        urlopen(Request(address, headers={"Host": "evil.example"}), timeout=PATIENCE)
    results = going.end()
    assert [c["set"] for c in results.info["commands"] if "set" in c] == [{"tank.u": -3.0}]
    assert results.info["status"] == "stopped"


def test_rows_come_as_a_stream_also_to_who_comes_late(going: Going) -> None:
    assert going.view is not None
    with urlopen(f"{going.view.address}rows", timeout=PATIENCE) as stream:
        assert stream.headers["Content-Type"] == "text/event-stream"
        lines = (line for line in stream if line.startswith(b"data: "))
        messages = (json.loads(line[6:]) for line in lines)
        assert any("rows" in message for message in messages)


def test_a_page_that_nobody_reads_does_not_hold_up_a_fast_run(fmus: Path) -> None:
    with Simulation(tank(fmus)) as s:
        plain = s.run(200.0, 1e-3)
        with LiveView("A tank", s.names, s.types, s.units, s.settable, 0.0, 200.0) as view:
            results = s.run(200.0, 1e-3, observe=view.observe, steering=view.steering)
    assert results.values.tobytes() == plain.values.tobytes()
    assert view.process.returncode == 0


@pytest.mark.slow
def test_the_page_in_a_browser(going: Going) -> None:
    assert going.view is not None
    with chromium() as browser:
        troubles: list[str] = []
        for width in (1280, 390):
            tab = browser.new_page(viewport={"width": width, "height": 900})
            tab.on("console", lambda message: troubles.append(message.text))
            tab.on("pageerror", lambda error: troubles.append(str(error)))
            tab.goto(going.view.address)
            until(tab, "document.querySelectorAll('.panel canvas').length > 0")
            until(tab, "document.getElementById('state').textContent === 'running'")
            tab.locator("summary").click()
            accessible(tab)
            fits(tab)
        tab.get_by_role("spinbutton", name="tank.u").fill("-4")
        tab.get_by_role("spinbutton", name="tank.u").press("Enter")
        until(tab, "document.getElementById('done').textContent.includes('tank.u = -4')")
        tab.get_by_role("button", name="Pause").click()
        until(tab, "document.getElementById('state').textContent === 'paused'")
        wait_for(lambda: going.view.steering.is_paused)
        tab.get_by_role("button", name="Resume").click()
        until(tab, "document.getElementById('state').textContent === 'running'")
        tab.get_by_role("button", name="Stop").click()
        until(tab, "document.getElementById('state').textContent === 'stopped'")
        assert troubles == []
    commands = going.end().info["commands"]
    assert {"tank.u": -4.0} in [c.get("set") for c in commands]


def test_the_page_shows_texts_of_others_as_texts() -> None:
    page = live_page("<script>", ["a.<b>"], {"a.<b>": '"<'}, {'a."x"<y>': {"value": 1.0, "unit": "<u>"}}, 0.0, 1.0)
    assert "&lt;script&gt;" in page
    assert "<y>" not in page
    assert "<u>" not in page
