"""What the command line and scenarios let choose from; apart from what does it, which takes a while to import."""

from __future__ import annotations

#: Orders of the value exchange, and what the field calls them.
ORDERS = {"sequential": "Gauss-Seidel", "parallel": "Jacobi"}

#: What inputs do between communication points, and what the field calls it.
EXTRAPOLATIONS = {
    "auto": "linear where the FMU can, else held",
    "hold": "zero-order hold",
    "linear": "first-order hold, linear extrapolation",
}
