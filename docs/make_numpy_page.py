"""The page of numpy idioms: `python docs/make_numpy_page.py` writes docs/numpy.md from the table that the tests run."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from tests.support.idioms import IDIOMS  # noqa: E402

_BEGINNING = """# numpy that can be traced

The functions of a `Model` are plain numpy. `fmu_export` runs them with symbols in place of numbers, and writes what
comes out as C and Python. This page lists idioms and what becomes of them: *equal* is built and computes what numpy
computes, *refused* ends the build with a line that names the place in your file and the remedy. The tests run every
row. It is generated: `python docs/make_numpy_page.py`.

Before a build the traced equations are compared with your functions: at the start values, at random points, at zeros,
halves, constants of the equations and equal arguments, and on both sides of the edge of each comparison, to 1e-11 of
the value (and what rounding may cost where terms cancel). A difference is refused with function, element and both
values; so are functions that give another value when they are called again (`np.random`, clocks, counters) or change
their arguments, and outputs that have the name of a state and are something else. A condition that holds at no point
tried is not seen. `build_native(..., unchecked=True)` and `build_pythonfmu(..., unchecked=True)` leave the comparison
out; `generationTool` in the model description then says *equations unchecked*.

Operations are exported as they are written: `(x + y) - y` is no `x`. One thing is left out: a product with the number 0
is 0, so that an output does not seem to depend on what its matrix has a zero for, and steps do not compute it. So
numpy's NaN for `0.0 * np.inf` is 0, and zeros may have another sign where they are multiplied by 0 or added to 0; where
a value depends on that, as in `np.arctan2(0.0 * x, -1.0)`, the comparison finds it and refuses. Values that numpy
computes as NaN or infinity are not compared. Sums of products (`@`, `np.dot`, `np.linalg`) are rounded in another order
than numpy's libraries round them, so that `np.floor` and its like of them can jump at another place, beside it by a
rounding error. Whole numbers are exact up to 2^53.

In the table `x` is an input of four elements, `t` the time, `C` and `M` are constants, a vector and a matrix.
"""


def page() -> str:
    """The page as Markdown."""
    parts = [_BEGINNING]
    for expected, heading in (("equal", "Equal to numpy"), ("refused", "Refused")):
        parts.append(f"\n## {heading}\n")
        rows = [idiom for idiom in IDIOMS if idiom.expected == expected]
        for kind in dict.fromkeys(idiom.kind for idiom in rows):
            lines = [idiom.code for idiom in rows if idiom.kind == kind]
            parts.append(
                f"\n### {kind.capitalize()}\n\n```text\n" + "\n".join(_entry(code) for code in lines) + "\n```\n"
            )
    return "".join(parts)


def _entry(code: str) -> str:
    return code if "\n" not in code else f"\n{code}\n"


if __name__ == "__main__":
    (HERE / "numpy.md").write_text(page(), encoding="utf-8")
