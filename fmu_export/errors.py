"""The errors of models and their export: each message is one line that names what was wrong, where, and the remedy.

They have a root of their own, since neither models nor exporter know the master, whose root is `cosim.CosimError`. The
code inside an FMU that runs Python, which has the standard library only, raises `SlaveError` or `ScriptError`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class ModelError(Exception):
    """Base of all errors of models, of their export and of the tools beside them that a user can mend."""


class ArgumentError(ModelError, ValueError):
    """An argument has a value that the function can't take."""


class TraceError(ModelError, ValueError):
    """A model can't be traced; the message says in which function, and what to write instead."""


class DocumentationError(ModelError):
    """The documentation of an FMU can't be written."""


class MissingExtra(ModelError, ImportError):
    """A package is not installed that only some tasks need; the message has the command that installs it."""

    def __init__(self, extra: str, package: str) -> None:
        super().__init__(f'{package} is not installed; install it with: pip install "closed-chain-cosim[{extra}]"')
        self.extra = extra
        self.name = package

    def __reduce__(self) -> tuple[type[MissingExtra], tuple[str, str]]:
        return MissingExtra, (self.extra, str(self.name))


@contextmanager
def needs(extra: str) -> Iterator[None]:
    """Context for imports of packages that an extra of this distribution installs; `cosim.errors` has the same.

    Raises
    ------
    MissingExtra
        A package is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtra(extra, (error.name or "a package").partition(".")[0]) from error
