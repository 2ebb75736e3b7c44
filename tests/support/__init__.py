"""Helpers of the tests, and C sources of their FMUs and hosts."""

from pathlib import Path

#: This folder, and the checkout.
SUPPORT = Path(__file__).resolve().parent
CHECKOUT = SUPPORT.parents[1]
