"""The errors that a user can mend: each message is one line that names what was wrong, where, and the remedy.

Every error that the packages `cosim` and `parallel_robot` raise on purpose is a `CosimError`. Models and the exporter,
which know no master, have a root of their own: `fmu_export.errors.ModelError`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from numbers import Integral

#: So many known names, and so many characters of a wrong one, are compared: all of a large model would take minutes.
_MOST_NAMES, _LONGEST_NAME = 2000, 200


class CosimError(Exception):
    """Base of all errors that a user can mend."""


class SetupError(CosimError):
    """A system can't be simulated as described; found before anything runs."""


class ArgumentError(CosimError, ValueError):
    """An argument has a value that the function can't take."""


class ResultsError(CosimError):
    """A result file can't be read, or has no variable of a name."""


class MissingExtra(CosimError, ImportError):
    """A package is not installed that only some tasks need; the message has the command that installs it."""

    def __init__(self, extra: str, package: str) -> None:
        super().__init__(f'{package} is not installed; install it with: pip install "closed-chain-cosim[{extra}]"')
        self.extra = extra
        self.name = package

    def __reduce__(self) -> tuple[type[MissingExtra], tuple[str, str]]:
        return MissingExtra, (self.extra, str(self.name))


@contextmanager
def needs(extra: str) -> Iterator[None]:
    """Context for imports of packages that an extra of this distribution installs.

    Parameters
    ----------
    extra : str
        Name of the extra in pyproject.toml.

    Raises
    ------
    MissingExtra
        A package is not installed.

    Examples
    --------
    >>> with needs("plot"):
    ...     import no_such_package
    Traceback (most recent call last):
    ...
    cosim.errors.MissingExtra: no_such_package is not installed; install it with: pip install "closed-chain-cosim[plot]"
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtra(extra, (error.name or "a package").partition(".")[0]) from error


def positive_whole(number: object) -> int | None:
    """A positive whole number, NumPy's included, as Python's own; None for all else, Booleans included."""
    if isinstance(number, bool) or not isinstance(number, Integral) or number < 1:
        return None
    return int(number)


def nearest(name: str, known: Iterable[str]) -> str:
    """Hint for a wrong name: the nearest known one, or all of them when none is near."""
    names = list(islice(known, _MOST_NAMES))
    close = difflib.get_close_matches(name[:_LONGEST_NAME], names, n=1, cutoff=0.5)
    if close:
        return f"did you mean '{close[0]}'?"
    if not names:
        return "there are none"
    shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
    return f"known are {shown}"
