"""`cosim scenarios`: the scenarios that come with installed packages, and a copy of one to start from."""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path
from typing import Any

from cosim.errors import CosimError, nearest
from cosim.files.whole import write_whole
from cosim.scenario.family import families, family_name, named

_EXAMPLES = """\
examples:
  cosim scenarios
  cosim scenarios --copy tracking --to mine.toml
  cosim run mine.toml
"""


def register(subparsers: Any) -> None:
    """Add the parser of `cosim scenarios`."""
    parser = subparsers.add_parser(
        "scenarios",
        help="list the available scenarios, or copy one to start from",
        epilog=_EXAMPLES,
        description="List the scenarios that come with installed packages, with what each is; or copy the TOML file of "
        "one, to change it and run it by its path.",
    )
    parser.add_argument("--copy", metavar="NAME", help="copy the file of this scenario")
    parser.add_argument("--to", type=Path, metavar="FILE", help="where to (default <NAME>.toml in this folder)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `cosim scenarios`; returns 0.

    Raises
    ------
    CosimError
        There is no such scenario, or there is a file where the copy would go.
    """
    if args.copy is not None:
        print(f"written: {_copied(args.copy, args.to or Path(f'{args.copy}.toml'))}")
        return 0
    if args.to is not None:
        raise CosimError("--to needs --copy NAME, the scenario to copy")
    for name, family in families().items():
        titles = {scenario: _title(family.folder / f"{scenario}.toml") for scenario in family.scenario_names()}  # type: ignore[operator]
        width = max(map(len, titles), default=0)
        print(f"{name}: {family.system}")
        for scenario, title in titles.items():
            mark = " (default)" if scenario == family.default else ""
            print(f"  {scenario:<{width}}  {title}{mark}")
    if not families():
        print("no installed package brings scenarios; cosim run takes the path of a TOML file")
    return 0


def _title(path: Path) -> str:
    return str(tomllib.loads(path.read_text(encoding="utf-8")).get("title", ""))


def _copied(name: str, target: Path) -> Path:
    found = named(name)
    if found is None:
        known = [scenario for family in families().values() for scenario in family.scenario_names()]
        raise CosimError(f"there is no scenario '{name}'; {nearest(name, known)}")
    if target.exists():
        raise CosimError(f"{target} already exists; give another name by --to, or remove it")
    family, path = found
    content = _naming_its_system(path.read_bytes(), family_name(family))
    write_whole(target, lambda part: part.write_bytes(content))
    return target


def _naming_its_system(content: bytes, system: str) -> bytes:
    """A scenario file with a line `system`, without which it runs only where no other family is installed."""
    if "system" in tomllib.loads(content.decode("utf-8")):
        return content
    lines = content.splitlines(keepends=True)
    first = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith(b"#")), len(lines))
    return b"".join([*lines[:first], f'system = "{system}"\n'.encode(), *lines[first:]])
