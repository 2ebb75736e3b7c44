"""Results of `cosim reproduce` as plain data: made by this package, read by the report and written to JSON files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cosim.results.results import Results

#: Verdicts on a claim of the paper.
Verdict = Literal["holds", "holds in part", "does not hold", "cannot be judged"]

#: What acts on the robot: "disturbed" is the paper's section 6, with the mass change dm and the disturbance torque
#: from 4 s on; "mass change" is without that torque, "disturbance" without that change; "nominal" is without either.
Condition = Literal["disturbed", "mass change", "disturbance", "nominal"]

#: Largest steady errors (m, rad) that the axes of the insets of Figs. 8-12 can show.
PRINTED_STEADY = {"x": 6e-6, "y": 12e-6, "theta_a[1]": 4e-5, "theta_a[2]": 6e-5, "theta_a[3]": 8e-5}

#: The main axes of Figs. 8-12 (m, rad): what the errors stay within over the whole run.
PRINTED_SPAN = {
    "x": (-5e-3, 3e-3),
    "y": (-4e-3, 5e-3),
    "theta_a[1]": (-0.015, 0.035),
    "theta_a[2]": (-0.08, 0.04),
    "theta_a[3]": (-0.03, 0.015),
}

#: A curve that leaves its axis by less than this share of it, the width of a line, is within it.
LINE_WIDTH = 0.01

#: The printed axes of Fig. 4 (m): they alone say how long the paper's run may have been.
PRINTED_X, PRINTED_Y = (0.21, 0.224), (0.275, 0.30)

#: The inset of Fig. 7 where the disturbance sets in (m): the path is to be seen in it.
PRINTED_INSET_X, PRINTED_INSET_Y = (0.166, 0.174), (0.372, 0.378)

#: The axes of Fig. 7 (m).
PRINTED_PATH_X, PRINTED_PATH_Y = (0.10, 0.30), (0.26, 0.42)

#: Start angles of active and passive joints as printed in section 6 (rad).
PRINTED_START = (1.3137, 2.9036, -1.4326, -0.8667, 1.4593, 2.972)

#: Those under which all six controllers run.
CONDITIONS: tuple[Condition, ...] = ("disturbed", "mass change", "nominal")


@dataclass(frozen=True)
class Controller:
    """One of the six controllers of Figs. 7-17.

    Attributes
    ----------
    key : str
        "pd", or mu/nu as printed in the legends: "0.1", "0.2", "1", "5", "10".
    label : str
        For legends.
    mu, nu : float
        Weights of (78); of PD those whose beta it takes.
    alpha : float
        Gain of the robust part, 0 for PD.
    beta : float
        Gain of the PD part (N m s/rad).
    """

    key: str
    label: str
    mu: float
    nu: float
    alpha: float
    beta: float


def beyond_axes(span: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """How far errors leave the main axes of Figs. 8-12, as shares of the axes; 0 within them.

    Parameters
    ----------
    span : mapping
        Name of an error -> its least and largest value in a run (m, rad).
    """
    beyond = {}
    for name, (least, largest) in span.items():
        low, high = PRINTED_SPAN[name]
        beyond[name] = max(low - least, largest - high, 0.0) / (high - low)
    return beyond


@dataclass(frozen=True)
class Reading:
    """Results of one run under an assumption that differs from the printed law.

    Attributes
    ----------
    assumption : str
        In words.
    condition : Condition
    method : str
        What computed it: coupled FMUs, or one FMU by an implicit method.
    steady : mapping
        Name of an error -> its largest steady size (m, rad).
    span : mapping
        Name of an error -> its least and largest value in the whole run (m, rad).
    torque_rms, torque_steady : float
        Root mean square and largest torque of all motors once steady (N m).
    torque_max : float
        Largest torque of all motors in the whole run (N m).
    psi_max : float
        Largest component of the estimate in the whole run.
    breaks : tuple of str
        Conditions and equations of the paper that the assumption does not keep to.
    command : str
        The command that runs the same law with coupled FMUs, empty where no command alone does.
    """

    assumption: str
    condition: Condition
    method: str
    steady: Mapping[str, float]
    span: Mapping[str, tuple[float, float]]
    torque_rms: float
    torque_steady: float
    torque_max: float
    psi_max: float = 0.0
    breaks: tuple[str, ...] = ()
    command: str = ""

    @property
    def over_insets(self) -> float:
        """The largest of the steady errors over what the inset of its figure can show."""
        return max(error / PRINTED_STEADY[name] for name, error in self.steady.items())

    @property
    def misfit(self) -> float:
        """How far the steady errors are from the sizes in the insets: the largest factor, either way."""
        ratios = [error / PRINTED_STEADY[name] for name, error in self.steady.items()]
        return max(max(r, 1.0 / r) if r > 0.0 else math.inf for r in ratios)

    @property
    def beyond_axes(self) -> float:
        """By how much the run leaves the main axes of Figs. 8-12, as a share of the axis it leaves most."""
        return max(beyond_axes(self.span).values())

    @property
    def reaches_printed(self) -> bool:
        """Whether all steady errors are at most those of the paper's insets."""
        return self.over_insets <= 1.0

    @property
    def within_axes(self) -> bool:
        """Whether the run stays within the main axes of Figs. 8-12, up to the width of a line."""
        return self.beyond_axes <= LINE_WIDTH


@dataclass(frozen=True)
class Disturbed:
    """What a disturbance torque does to one controller, against the run without it; mass change in both.

    Attributes
    ----------
    controller : str
        Key of the controller.
    shape : str
        Of the torque.
    level : float
        Root mean square of a multisine, size of a pulse (N m).
    steady_rms : mapping
        Name of an error -> its steady root mean square over that without the torque.
    peak : float
        Largest distance (m) of the end effector from where it is without the torque.
    back_after : float or None
        How long (s) after the end of the torque that distance falls below a tenth of the peak for good; None for a
        torque that does not end.
    """

    controller: str
    shape: str
    level: float
    steady_rms: Mapping[str, float]
    peak: float
    back_after: float | None


@dataclass(frozen=True)
class Runs:
    """All runs behind figures and claims.

    Attributes
    ----------
    controllers : tuple of Controller
        PD first, then by rising mu/nu: the order of all tables and legends.
    closed_loop : mapping
        (controller key, condition) -> `Results` over the whole run, with all inputs and outputs of the three FMUs.
    open_loop : Results
        The robot alone under the torque of Fig. 4.
    accumulated : mapping
        (controller key, seed, rms in N m) -> accumulated errors {"x", "y", "theta_a[1]", ...} (m s, rad s) under other
        disturbance torques than that of `closed_loop`, with the mass change; rms 0 is none.
    pd_same_beta : mapping
        Key of a proposed controller -> `metrics` of the tracking errors under PD control with its beta, "disturbed".
    pd_same_effort : mapping
        Key of a proposed controller -> beta, and `metrics` of the tracking errors, of the PD control with as large an
        integral of the squared torque, "disturbed".
    disturbed : tuple of Disturbed
        PD and the control of row (1, 1) under torques of other shapes and sizes.
    least_bound : mapping
        beta -> the least parameter of the bound (35) over a run with it, and the same after the first 20 ms.
    readings : tuple of Reading
        What other assumptions than the printed law give.
    steady_after : float
        From this time (s) on errors count as steady.
    disturbed_from : float
        When the disturbance torque sets in (s).
    info : mapping
        Flavour of the FMUs, communication step (s), stop time (s), seed, coupling.
    """

    controllers: tuple[Controller, ...]
    closed_loop: Mapping[tuple[str, Condition], Results]
    open_loop: Results
    accumulated: Mapping[tuple[str, int, float], Mapping[str, float]]
    pd_same_beta: Mapping[str, Mapping[str, Mapping[str, float]]]
    pd_same_effort: Mapping[str, tuple[float, Mapping[str, Mapping[str, float]]]]
    disturbed: tuple[Disturbed, ...]
    least_bound: Mapping[float, tuple[float, float]]
    readings: tuple[Reading, ...]
    steady_after: float
    disturbed_from: float
    info: Mapping[str, Any]

    def controller(self, key: str) -> Controller:
        """The controller of that key."""
        return next(c for c in self.controllers if c.key == key)

    @property
    def proposed(self) -> tuple[Controller, ...]:
        """The five controllers with optimal gains, by rising mu/nu."""
        return tuple(c for c in self.controllers if c.key != "pd")


@dataclass(frozen=True)
class TableRow:
    """A row of Table 1, computed and as printed; beta in N m s/rad."""

    mu: float
    nu: float
    alpha: float
    beta: float
    J: float
    printed_alpha: str
    printed_beta: str
    printed_J: str
    agrees: bool


@dataclass(frozen=True)
class PaperFigure:
    """A figure as files.

    Attributes
    ----------
    number : int
        As in the paper.
    title, caption : str
        Plain text; the caption says what is seen, and where it differs from the paper's.
    alt : str
        Text alternative for those who can't see it.
    svg, png : Path
    """

    number: int
    title: str
    caption: str
    alt: str
    svg: Path
    png: Path


@dataclass(frozen=True)
class Measured:
    """Values of a measure.

    Attributes
    ----------
    values : mapping
        Number by what it is of, for instance "x, mu/nu = 1"; a claim is judged by comparing each with the threshold.
    unit : str
        Of the values and the threshold; "1" for ratios.
    note : str
        What a reader has to know beside the numbers, else empty.
    """

    values: Mapping[str, float]
    unit: str = "1"
    note: str = ""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper in our words, with its verdict.

    Attributes
    ----------
    id, where, claim : str
        Identifier; place in the paper; what it says.
    runs : tuple of str
        The runs it needs, empty for claims on formulas.
    metric : str
        Name of the measure, empty for a claim that can't be judged.
    relation : str
        "<", "<=", ">" or ">=": how a value has to compare with the threshold.
    threshold : float or None
        In `unit`.
    unit : str
    values : mapping
        What was measured.
    met, total : int
        How many of the values meet the threshold, and how many there are.
    verdict : Verdict
        "holds" when all meet it, "does not hold" when none does, "holds in part" in between.
    why : str
        The finding in words, with its numbers.
    """

    id: str
    where: str
    claim: str
    runs: tuple[str, ...]
    metric: str
    relation: str
    threshold: float | None
    unit: str
    values: Mapping[str, float]
    met: int
    total: int
    verdict: Verdict
    why: str


@dataclass(frozen=True)
class Erratum:
    """An error or gap of the paper, with the computation that shows it.

    Attributes
    ----------
    id, where, printed, correct : str
        Identifier; place in the paper; what it prints; what holds.
    evidence : str
        What was computed, in words.
    numbers : mapping
        What came out, by name with unit.
    shown : bool
        Whether the numbers show it.
    """

    id: str
    where: str
    printed: str
    correct: str
    evidence: str
    numbers: Mapping[str, float]
    shown: bool


@dataclass(frozen=True)
class TheoremCheck:
    """Theorem 1 along one run, with the printed constants and with those that its proof supports.

    Z stacks theta_e (rad), theta_e' (rad/s) and psi - psi_bar; unlike units are added, as the paper does.

    Attributes
    ----------
    controller : str
        Key of the controller.
    condition : Condition
    psi_bar : tuple of float
        The bound's parameter (2,), the least of the form (p, p) that meets Assumption 4 along this run.
    lambda_hat : float
        beta lambda_3, (59) (N m s/rad).
    h_printed, h_corrected : float
        h of (59) as printed, and with k^2/(4 (k - beta lambda_3)) in place of beta lambda_3 before |psi_bar|^2.
    excess_printed, excess_corrected : float
        Largest V' + lambda |Z|^2 - h along the run; positive: the inequality is violated.
    share_violated : float
        Share of the run's time at which the printed inequality is violated.
    Z_start, Z_max, Z_steady : float
        |Z| at the start, its largest value, and its largest from `steady_after` on.
    Gamma, chi_min : float
        Radii (62), (63), as printed.
    d_chi : float
        Bound of |Z| at all times for this start, max(|Z(0)|, Gamma) sqrt(lambda_2/lambda_1).
    T_chi : float
        Time (s) by (64) after which |Z| stays below twice chi_min.
    below_from : float
        Time (s) from which it does.
    envelope_printed, envelope_corrected : float
        Largest V over its envelope (74) along the run, with either h.
    V_curves : mapping
        "time" (s), "V" (J), and both envelopes (J) by time, "printed" and "corrected": some points of each.
    """

    controller: str
    condition: Condition
    psi_bar: tuple[float, float]
    lambda_hat: float
    h_printed: float
    h_corrected: float
    excess_printed: float
    excess_corrected: float
    share_violated: float
    Z_start: float
    Z_max: float
    Z_steady: float
    Gamma: float
    chi_min: float
    d_chi: float
    T_chi: float
    below_from: float
    envelope_printed: float
    envelope_corrected: float
    V_curves: Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class Reproduction:
    """Everything that `cosim reproduce` found.

    Attributes
    ----------
    runs : Runs
    table1 : tuple of TableRow
    figures : tuple of PaperFigure
        By number.
    claims : tuple of Claim
        In the order of `claims.toml`.
    errata : tuple of Erratum
    theorem1 : tuple of TheoremCheck
    versions : mapping
        Of the software that computed it.
    """

    runs: Runs
    table1: tuple[TableRow, ...]
    figures: tuple[PaperFigure, ...]
    claims: tuple[Claim, ...]
    errata: tuple[Erratum, ...]
    theorem1: tuple[TheoremCheck, ...]
    versions: Mapping[str, str]
