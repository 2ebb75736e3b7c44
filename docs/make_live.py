"""Write the live page that the site's front page shows: `python docs/make_live.py`, after a change of models or page.

Needs ziglang; the modules are built in `fmus`.
"""

from __future__ import annotations

from pathlib import Path

from parallel_robot.live.page import live_page

DOCS = Path(__file__).parent

if __name__ == "__main__":
    (DOCS / "static/live.html").write_text(live_page(DOCS.parent / "fmus"), encoding="utf-8")
