"""`cosim tank-time`: how long a tank takes to run empty."""

import math


def register(subparsers):
    """Add the parser of the command."""
    parser = subparsers.add_parser("tank-time", help="how long a tank takes to run empty")
    parser.add_argument("level", type=float, help="level at the start in m")
    parser.set_defaults(run=run)


def run(args):
    """Run the command; returns the exit code."""
    print(f"{0.5 / 0.01 * math.sqrt(2.0 * args.level / 9.81):.1f} s")
    return 0
