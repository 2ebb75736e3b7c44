"""Table 1 and the six controllers of the figures."""

from __future__ import annotations

from controller_fmu.optimal_gains import PerformanceIndex, optimal_gains
from parallel_robot.paper.reproduce.content import Controller, TableRow

#: mu, nu and alpha, beta, J_min as Table 1 prints them, in its order.
PRINTED = (
    (1.0, 1.0, "1.3597", "1.6620", "9.1329"),
    (5.0, 1.0, "1.7839", "1.9337", "18.9766"),
    (10.0, 1.0, "2.0655", "2.1671", "29.3006"),
    (1.0, 10.0, "0.9419", "1.1195", "34.1584"),
    (1.0, 5.0, "1.0503", "1.2535", "22.3282"),
)


def agrees(value: float, printed: str) -> bool:
    """Whether a value comes to the printed digits by rounding or, as alpha of the first row does, by cutting."""
    decimals = len(printed.partition(".")[2])
    return 0.0 <= value - float(printed) < 10.0**-decimals or f"{value:.{decimals}f}" == printed


def table1() -> tuple[TableRow, ...]:
    """Table 1, computed from (78)-(82) and compared with the printed digits."""
    rows = []
    for mu, nu, alpha, beta, J in PRINTED:
        gains = optimal_gains(PerformanceIndex(mu, nu))
        found, printed = (gains.alpha, gains.beta, gains.J), (alpha, beta, J)
        same = all(agrees(value, text) for value, text in zip(found, printed, strict=True))
        rows.append(TableRow(mu, nu, *found, *printed, agrees=same))
    return tuple(rows)


def controllers() -> tuple[Controller, ...]:
    """PD, then the five optima by rising mu/nu.

    The paper prints no gains for its PD control; ours is alpha = 0 with the beta of (mu, nu) = (1, 1).
    """
    rows = {row.mu / row.nu: row for row in table1()}
    one = rows[1.0]
    optima = [
        Controller(
            f"{ratio:g}",
            f"$\\mu/\\nu$ = {ratio:g}",
            rows[ratio].mu,
            rows[ratio].nu,
            rows[ratio].alpha,
            rows[ratio].beta,
        )
        for ratio in sorted(rows)
    ]
    return Controller("pd", "PD", one.mu, one.nu, 0.0, one.beta), *optima
