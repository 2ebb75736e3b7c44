"""The fixture `fmu_regression`, for tests of one's own."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import get_args

import pytest

from cosim.errors import ArgumentError, CosimError, nearest
from cosim.fmi.fmu_file import read_fmu
from cosim.regression.items import check_signature, judged, near, no_case, reference_folder
from cosim.regression.run import interfaces_of
from cosim.regression.session import folder_for_shipped
from cosim.regression.shipped import all_cases
from cosim.regression.tolerances import Interface


class FmuRegression:
    """Runs FMUs in a test and fails it where they leave their references.

    Examples
    --------
    >>> def test_my_fmu(fmu_regression):
    ...     fmu_regression("build/my.fmu", reference="reference")
    """

    def __init__(self, request: pytest.FixtureRequest) -> None:
        self._item: pytest.Item = request.node

    def __call__(
        self,
        fmu: str | PathLike[str],
        reference: str | PathLike[str] | None = None,
        interface: Interface | None = None,
    ) -> None:
        """Run all cases of an FMU.

        Parameters
        ----------
        fmu : path
        reference : path, optional
            Folder of cases, or of one; by default as for the option `--fmu-reference`.
        interface : {"co_simulation", "model_exchange"}, optional
            All that the FMU has by default.
        """
        __tracebackhide__ = True
        if interface is not None and interface not in get_args(Interface):
            raise ArgumentError(f"interface = {interface!r}: {nearest(interface, get_args(Interface))}")
        path = Path(fmu)
        folder = Path(reference) if reference is not None else reference_folder(self._item.config)
        try:
            check_signature(self._item.config, path)
            interfaces = [interface] if interface else interfaces_of(read_fmu(path, str(near(path))))
            cases = all_cases(path, folder, folder_for_shipped(self._item.config)).cases
        except CosimError as error:
            pytest.fail(str(error), pytrace=False)
        if not cases:
            pytest.fail(no_case(path, self._item.config), pytrace=False)
        lines = [
            f"{outcome.case} {outcome.interface}: {finding}"
            for case in cases
            for one in interfaces
            for outcome in [judged(self._item, case, path, one)]
            for finding in outcome.findings
        ]
        if lines:
            pytest.fail("\n".join(lines), pytrace=False)
