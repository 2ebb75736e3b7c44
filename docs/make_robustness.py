"""Put the results of `cosim robustness` into the page docs/robustness.md, figures included.

cosim robustness && python docs/make_robustness.py results/robustness
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from parallel_robot.paper.robustness.content import FIGURES, TEXT, load

PAGE = Path(__file__).with_name("robustness.md")
PICTURES = Path(__file__).with_name("robustness")

#: The page ends with what is generated, from this line on.
MARK = "<!-- from here on written by docs/make_robustness.py -->"


def main(folder: Path) -> None:
    """Replace the results in the page by those of a study."""
    study = load(folder)
    title, _, results = (folder / TEXT).read_text(encoding="utf-8").partition("\n")
    assert title.startswith("# ")
    own, mark, _ = PAGE.read_text(encoding="utf-8").partition(MARK)
    assert mark
    PICTURES.mkdir(exist_ok=True)
    for figure in study.figures:
        shutil.copy(folder / FIGURES / f"{figure.name}.png", PICTURES)
    PAGE.write_text(f"{own}{MARK}\n{results.replace(f'({FIGURES}/', f'({PICTURES.name}/')}", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
