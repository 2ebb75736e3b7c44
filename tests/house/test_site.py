"""The documentation site builds without a warning, and every link in it leads somewhere.

The whole site is slow; built always is one of the pages whose sources stand in other folders, with what they show.
"""

from __future__ import annotations

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).resolve().parents[2]


class Page(HTMLParser):
    """Links, images and link targets of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.targets: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.targets.add(found.get("id") or "")
        for name in ("href", "src"):
            if tag in ("a", "img", "link", "script", "source", "object", "iframe") and found.get(name):
                self.links.append(found[name] or "")


def broken_links(site: Path) -> list[str]:
    """Links that lead nowhere, `page: link`; external ones are only looked at, since tests need no network."""
    pages = {path.resolve(): Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    broken = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme == "tcp":  # the address of a scheduler in a help text, taken for a link
                continue
            if parts.scheme or parts.netloc:
                if parts.scheme != "https" or "." not in parts.netloc or " " in link:
                    broken.append(f"{path.name}: {link}")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            fragment = unquote(parts.fragment)
            known = pages[target].targets if target in pages else {""}
            if not target.is_file() or (fragment and fragment not in known):
                broken.append(f"{path.name}: {link}")
    return broken


MODEL_PAGES = ("model_plant", "model_controller", "model_trajectory")


def built(source: Path, folder: Path) -> Path:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E", "-d", folder / "cache"]
    done = subprocess.run([*command, source, folder / "html"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr  # a new page must stand in a toctree of docs/index.md
    return folder / "html"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(ROOT / "docs", tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site of the model pages alone."""
    root = tmp_path_factory.mktemp("models")
    (root / "docs").mkdir()
    for name in ("conf.py", "errors_tree.py", "static", *(f"{page}.md" for page in MODEL_PAGES)):
        (root / "docs" / name).symlink_to(ROOT / "docs" / name)
    for package in ("plant_fmu", "controller_fmu", "trajectory_fmu"):
        (root / package).symlink_to(ROOT / package)
    pages = "\n".join(MODEL_PAGES)
    (root / "docs/index.md").write_text(f"# Models\n\n```{{toctree}}\n{pages}\n```\n", encoding="utf-8")
    return built(root / "docs", root)


@pytest.mark.slow
def test_every_link_leads_somewhere(site: Path) -> None:
    assert broken_links(site) == []


def test_the_link_checker_finds_what_is_broken(tmp_path: Path) -> None:
    (tmp_path / "b.html").write_text('<h1 id="here">b</h1>')
    links = ["b.html", "b.html#here", "b.html#there", "c.html", "#here", "https://a.org/x", "http://a.org", "https://a"]
    (tmp_path / "a.html").write_text("".join(f'<a href="{link}">x</a>' for link in links) + '<img src="no.png">')
    found = {line.removeprefix("a.html: ") for line in broken_links(tmp_path)}
    assert found == {"b.html#there", "c.html", "#here", "http://a.org", "https://a", "no.png"}


@pytest.mark.slow
def test_pages_have_what_they_promise(site: Path) -> None:
    """What comes from elsewhere is there: examples, docstrings, model pages, the changelog."""
    for page, text in {
        "replace_controller": "PID control of each active joint",
        "api/cosim": "cosim.Simulation.run",
        "api/fmu_export": "fmu_export.build_native",
        "model_plant": "F_c",
        "model_controller": "psi_start",
        "model_trajectory": "RobotTrajectory",
        "changelog": "Changelog",
        "benchmarks": "libcosim",
    }.items():
        assert text in (site / f"{page}.html").read_text(encoding="utf-8"), page


@pytest.mark.slow
def test_every_link_of_the_model_pages_leads_somewhere(models: Path) -> None:
    assert broken_links(models) == []


@pytest.mark.parametrize("page", MODEL_PAGES)
@pytest.mark.slow
def test_equations_are_typeset(models: Path, page: str) -> None:
    html = (models / f"{page}.html").read_text(encoding="utf-8")
    assert html.count("<math ") > 10
    text = re.sub(r"<[^>]*>", "", html[html.index("<article") : html.index("</article>")])
    assert "$" not in text
    assert "\\" not in text, "a command that the converter does not know"


@pytest.mark.parametrize("which", ["models", pytest.param("site", marks=pytest.mark.slow)])
def test_pages_load_nothing_from_elsewhere(request: pytest.FixtureRequest, which: str) -> None:
    """They are read offline too."""
    pages = list(request.getfixturevalue(which).rglob("*.html"))
    assert len(pages) > len(MODEL_PAGES)
    for path in pages:
        for tag in ('<script src="http', '<link rel="stylesheet" href="http', "@import url(http"):
            assert tag not in path.read_text(encoding="utf-8"), path.name
