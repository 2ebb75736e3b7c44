"""`cosim tune`: the gains alpha and beta that minimise the paper's performance index, section 5."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.errors import ArgumentError, needs

if TYPE_CHECKING:
    from controller_fmu.optimal_gains import OptimalGains, PerformanceIndex

TABLE_1_WEIGHTS = ((1.0, 1.0), (5.0, 1.0), (10.0, 1.0), (1.0, 10.0), (1.0, 5.0))

_EXAMPLES = """\
examples:
  cosim tune --mu 2 --nu 1
  cosim tune --table --from-plant
  cosim tune --membership triangle:0,0.2,0.5 --write fmus/fmi2/RobotController.fmu
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim tune`."""
    parser = subparsers.add_parser(
        "tune",
        help="find the optimal controller gains",
        epilog=_EXAMPLES,
        description="Find alpha and beta that minimise the performance index J (paper, section 5).",
    )
    parser.add_argument("--mu", type=float, metavar="M", help="weight of the steady error (default 1)")
    parser.add_argument("--nu", type=float, metavar="N", help="weight of the control cost (default 1)")
    parser.add_argument("--k", type=float, default=12.0, help="adaptation constant (default %(default)s)")
    parser.add_argument(
        "--S",
        type=float,
        nargs="+",
        default=[2.0],
        metavar="S_ii",
        help="diagonal of S: one number or three (default 2)",
    )
    parser.add_argument("--s-a", type=float, help="constant part of V0 = s_a + s_b beta (default: the paper's)")
    parser.add_argument("--s-b", type=float, help="part of V0 that grows with beta (default: the paper's)")
    parser.add_argument(
        "--from-plant", action="store_true", help="compute s_a and s_b from the robot and its start state"
    )
    parser.add_argument(
        "--membership",
        default="sine",
        metavar="TEXT",
        help="fuzzy number psi: sine[:lower,upper], triangle:lower,peak,upper, "
        "trapezoid:lower,left,right,upper, gaussian:mean,sigma[,lower,upper] "
        "or points:v0=w0,v1=w1,... (default: the paper's sine on [0, 0.5])",
    )
    parser.add_argument(
        "--independent",
        action="store_true",
        help="let the two components of psi vary independently of one another",
    )
    parser.add_argument("--table", action="store_true", help="all (mu, nu) of the paper's Table 1")
    parser.add_argument("--json", action="store_true", help="machine-readable output, floats that round-trip")
    parser.add_argument("--write", type=Path, metavar="FMU", help="write alpha and beta into this controller FMU")
    parser.set_defaults(run=run)


@needs("robot")
def run(args: argparse.Namespace) -> int:
    """Run `cosim tune`; returns the exit code, raises ValueError or OSError with one line on bad input."""
    # SciPy takes a while to import, and other commands don't need it
    from controller_fmu.membership import membership_from_text, psi_moments
    from controller_fmu.optimal_gains import PerformanceIndex, optimal_gains

    if args.table and not (args.mu is args.nu is args.write is None):
        raise ArgumentError("--table takes mu and nu from the paper: leave out --mu, --nu and --write, or --table")
    S = _diagonal(args.S)
    s_a, s_b = _lyapunov_constants(args, S)
    D2, D4 = psi_moments(membership_from_text(args.membership), shared=not args.independent)
    given = (1.0 if args.mu is None else args.mu, 1.0 if args.nu is None else args.nu)
    results = []
    for mu, nu in TABLE_1_WEIGHTS if args.table else (given,):
        index = PerformanceIndex(mu, nu, args.k, min(*S.tolist(), 1.0), s_a, s_b, D2, D4)
        results.append((index, optimal_gains(index)))
    if args.write:
        from fmu_export.package.start_values import write_start_values

        _, gains = results[0]
        write_start_values(args.write, {"alpha": gains.alpha, "beta": gains.beta})
    if args.json:
        records = [_record(index, gains, S, args) for index, gains in results]
        print(json.dumps(records if args.table else records[0], indent=2))
    elif args.table:
        print(_table(results, S))
    else:
        print(_block(*results[0], S))
        if args.write:
            print(f"wrote alpha and beta into {args.write}")
    return 0


def _diagonal(numbers: list[float]) -> np.ndarray:
    """S_ii (3,) in 1/s from one number or three."""
    if len(numbers) not in (1, 3):
        raise ArgumentError(f"--S has {len(numbers)} numbers; give one for all joints, or three")
    if not all(np.isfinite(number) and number > 0 for number in numbers):
        raise ArgumentError(f"--S {' '.join(map(repr, numbers))}: every S_ii must be a finite number greater than 0")
    return np.array(numbers * 3 if len(numbers) == 1 else numbers)


def _lyapunov_constants(args: argparse.Namespace, S: np.ndarray) -> tuple[float, float]:
    """s_a and s_b from the plant, from the options, or else the paper's."""
    if args.from_plant:
        if not (args.s_a is args.s_b is None):
            raise ArgumentError("--from-plant computes s_a and s_b: leave out --s-a and --s-b, or --from-plant")
        from parallel_robot.start import lyapunov_start_constants

        return lyapunov_start_constants(S)
    from controller_fmu.optimal_gains import PerformanceIndex

    return (
        PerformanceIndex.s_a if args.s_a is None else args.s_a,
        PerformanceIndex.s_b if args.s_b is None else args.s_b,
    )


def _proof_bound(gains: OptimalGains, S: np.ndarray) -> float:
    """Least k that the proof of Theorem 1 covers, 2 beta max(S_ii), before (59)."""
    return float(2 * gains.beta * S.max())


def _uncovered(index: PerformanceIndex, gains: OptimalGains, S: np.ndarray) -> str:
    """Note for a result outside Theorem 1, empty inside it."""
    bound = _proof_bound(gains, S)
    if index.k >= bound:
        return ""
    return (
        f"\nnote: for mu = {index.mu:g}, nu = {index.nu:g}, k = {index.k:g} is below "
        f"2 beta max(S_ii) = {bound:.6g}: the proof of Theorem 1 does not cover these gains; raise k or nu"
    )


def _table(results: list[tuple[PerformanceIndex, OptimalGains]], S: np.ndarray) -> str:
    rows = ["      mu       nu      alpha       beta          J"]
    rows += [f"{i.mu:8g} {i.nu:8g} {g.alpha:10.5f} {g.beta:10.5f} {g.J:10.5f}" for i, g in results]
    return "\n".join(rows) + "".join(_uncovered(index, gains, S) for index, gains in results)


def _block(index: PerformanceIndex, gains: OptimalGains, S: np.ndarray) -> str:
    low, high = gains.hessian_eigenvalues
    return (
        f"alpha        {gains.alpha:.10g}\n"
        f"beta         {gains.beta:.10g} N.m.s/rad\n"
        f"J_min        {gains.J:.10g}\n"
        f"gradient     norm {np.hypot(*gains.gradient):.1e}, "
        f"relative to its terms {gains.relative_gradient:.1e}\n"
        f"Hessian      eigenvalues {low:.6g} and {high:.6g}\n"
        f"unique       over all alpha, beta > 0 (convexity margin {gains.convexity_margin:.3g} > 0)\n"
        f"V0           s_a + s_b beta, s_a = {index.s_a:.6g}, s_b = {index.s_b:.6g}\n"
        f"psi          D2 = {index.D2:.6g}, D4 = {index.D4:.6g}" + _uncovered(index, gains, S)
    )


def _record(index: PerformanceIndex, gains: OptimalGains, S: np.ndarray, args: argparse.Namespace) -> dict[str, Any]:
    return {
        "alpha": gains.alpha,
        "beta": gains.beta,
        "J": gains.J,
        "gradient": gains.gradient,
        "relative_gradient": gains.relative_gradient,
        "hessian_eigenvalues": gains.hessian_eigenvalues,
        "convexity_margin": gains.convexity_margin,
        "unique_minimum": gains.is_unique_minimum,
        "mu": index.mu,
        "nu": index.nu,
        "k": index.k,
        "S": S.tolist(),
        "lambda_3": index.lambda_3,
        "s_a": index.s_a,
        "s_b": index.s_b,
        "D2": index.D2,
        "D4": index.D4,
        "membership": args.membership,
        "independent": args.independent,
        "k_required": _proof_bound(gains, S),
        "covered_by_theorem_1": index.k >= _proof_bound(gains, S),
        "written": str(args.write) if args.write else None,
    }
