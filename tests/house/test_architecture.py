"""The arrows between the rooms of the project run one way; found by reading the sources, importing nothing."""

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.support import CHECKOUT
from tests.support.sources import sources

#: Offline tools beside the controller's model; they are no models and may use scipy.
TOOLS = ("controller_fmu.membership", "controller_fmu.optimal_gains", "controller_fmu.uniqueness")

#: The rooms of `cosim` and what they stand on, from the lowest to the highest: each may import those before it.
ROOMS = (
    ("cosim.errors", "cosim.cluster", "cosim.versions", "cosim.terminal", "cosim.files", "cosim.signing"),
    ("cosim.loop", "cosim.page"),
    ("cosim.fmi",),
    ("cosim.system",),
    ("cosim.results",),
    ("cosim.master",),
    ("cosim.scenario", "cosim.ssp", "cosim.osp", "cosim.sweep", "cosim.regression", "cosim.analysis", "cosim.live"),
    ("cosim.model_page",),
    ("cosim.pack",),
    ("cosim.commands", "cosim.__main__", "cosim"),
)

#: What the master takes from the exporter without being a command; it needs the standard library only.
EXCEPTIONS = (
    ("cosim.__main__", "fmu_export.errors"),
    ("cosim.fmi.python_fmus", "fmu_export.errors"),
    ("cosim.fmi.python_fmus", "fmu_export.pythonfmu.binary"),  # Python FMUs of others get the same mended binary
    ("cosim.fmi.python_fmus", "fmu_export.pythonfmu.entry"),  # and the same entry as those of our own
    ("cosim.pack.library", "fmu_export.native.toolchain"),  # packed FMUs are compiled and written as exported ones
    ("cosim.pack.packing", "fmu_export.native.toolchain"),
    ("cosim.pack.packing", "fmu_export.package.archive"),
)

#: Modules that stand lower than the rest of their room: the table of FMI types is below the loop, and the loop's
#: build needs no more than where its source is.
LOWER = ("cosim.fmi.types",)


class NoTypeChecking(ast.NodeTransformer):
    """Drop what only a type checker reads."""

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.AST]:
        self.generic_visit(node)
        return list(node.orelse) if ast.unparse(node.test).endswith("TYPE_CHECKING") else node


def is_import(node: ast.AST) -> bool:
    if isinstance(node, ast.Call):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", None)
        return name in ("__import__", "import_module")
    return isinstance(node, ast.Import | ast.ImportFrom)


@cache
def imports_in(source: str, *, for_types: bool) -> list[ast.AST]:
    """Statements and calls of a source that import; finding them takes most of the time of these tests."""
    tree = ast.parse(source)
    return [n for n in ast.walk(tree if for_types else NoTypeChecking().visit(tree)) if is_import(n)]


def imports(path: Path, module: str, known: set[str], *, for_types: bool = True) -> set[str]:
    """Modules that a file imports anywhere, functions included; `from package import module` counts as the module."""
    found = set()
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    for node in imports_in(path.read_text(encoding="utf-8"), for_types=for_types):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*above, *filter(None, [node.module])])
            submodules = {f"{base}.{alias.name}" for alias in node.names} & known
            found |= submodules
            if not submodules or len(submodules) < len(node.names):
                found.add(base)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("__import__", "importlib.import_module"):
            found |= {a.value for a in node.args[:1] if isinstance(a, ast.Constant)}
    return found


def inside(name: str, *packages: str) -> bool:
    return any(name == p or name.startswith(p + ".") for p in packages)


def is_model(module: str) -> bool:
    return inside(module, "plant_fmu", "controller_fmu", "trajectory_fmu") and not inside(module, *TOOLS)


def floor(module: str) -> int:
    """On which floor of `cosim` a module stands; the lowest is 0."""
    if module in LOWER:
        return 0
    return max(
        (level for level, rooms in enumerate(ROOMS) for room in rooms if module == room or inside(module, room)),
        key=lambda level: max(len(room) for room in ROOMS[level] if inside(module, room)),
    )


def allowed(module: str, imported: str) -> bool:
    """Whether one module may import another; the standard library always."""
    if imported.partition(".")[0] in sys.stdlib_module_names:
        return True
    if is_model(module):
        return is_model(imported) or inside(imported, "numpy", "fmu_export.modelling", "fmu_export.errors")
    if inside(module, "controller_fmu"):
        return inside(imported, "numpy", "scipy", "controller_fmu", "fmu_export.modelling", "fmu_export.errors")
    if inside(module, "fmu_export.modelling"):
        if (module, imported) == ("fmu_export.modelling.units", "pint"):  # a table of units, when one is asked for
            return True
        return inside(imported, "numpy", "fmu_export.modelling", "fmu_export.errors")
    if inside(module, "fmu_export"):
        return not inside(imported, "plant_fmu", "controller_fmu", "trajectory_fmu", "cosim", "parallel_robot")
    if inside(module, "parallel_robot"):
        return True
    if inside(imported, "plant_fmu", "controller_fmu", "trajectory_fmu", "parallel_robot"):
        return False
    if inside(imported, "fmu_export"):
        return inside(module, "cosim.commands") or (module, imported) in EXCEPTIONS
    if inside(imported, "cosim"):
        return floor(imported) <= floor(module)
    return True


def violations(root: Path = CHECKOUT) -> list[str]:
    modules = sources(root)
    return [
        f"{module} imports {imported}"
        for module, path in modules.items()
        for imported in sorted(imports(path, module, set(modules)))
        if not allowed(module, imported)
    ]


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of nodes that reach each other (Tarjan 1972)."""
    index, low, stack, found = {}, {}, [], []

    def visit(node):
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in index:
                visit(other)
            if other in stack:
                low[node] = min(low[node], low[other])
        if low[node] == index[node]:
            group = []
            while not group or group[-1] != node:
                group.append(stack.pop())
            if len(group) > 1:
                found.append(sorted(group))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def room(module: str) -> str:
    """The room that a module belongs to: a package, or a package within a package."""
    return ".".join(module.split(".")[:2]) if inside(module, "cosim", "fmu_export") else module.partition(".")[0]


def module_graph(root: Path = CHECKOUT) -> dict[str, set[str]]:
    """What runs when a module is imported or used; imports for a type checker do not."""
    modules = sources(root)
    return {m: (imports(p, m, set(modules), for_types=False) & set(modules)) - {m} for m, p in modules.items()}


def test_the_sources_are_found():
    modules = sources()
    assert {"plant_fmu.model", "controller_fmu.model", "fmu_export.trace.trace", "cosim.master.run", "cosim"} <= set(
        modules
    )
    graph = module_graph()
    assert "fmu_export.modelling.model" in graph["plant_fmu.model"]
    assert {"plant_fmu.model", "plant_fmu.kinematics"} <= graph["trajectory_fmu.model"]


def test_arrows_run_one_way():
    assert violations() == []


def test_no_module_imports_itself_in_a_circle():
    assert cycles(module_graph()) == []


def test_no_circle_between_rooms():
    """The public names of a package are no part of a room: they come from all of them."""
    rooms: dict[str, set[str]] = {}
    for module, imported in module_graph().items():
        if module not in ("cosim", "fmu_export") and module not in LOWER:
            others = {room(i) for i in imported if i not in ("cosim", "fmu_export", *LOWER)}
            rooms.setdefault(room(module), set()).update(others - {room(module)})
    assert cycles(rooms) == []
    assert "fmu_export.modelling" in rooms["plant_fmu"]
    assert "cosim.loop" in rooms["cosim.master"]


def test_every_module_of_cosim_stands_on_a_floor():
    names = [name for rooms in ROOMS for name in rooms]
    assert [m for m in sources() if inside(m, "cosim") and not any(inside(m, n) for n in names if n != "cosim")] == [
        "cosim"
    ]
    assert all(any(inside(m, name) for m in sources()) for name in names)


@pytest.mark.parametrize("module", ["slave", "script_slave", "life_cycle"])
def test_the_slaves_in_the_archives_need_the_standard_library_only(module):
    path, own = sources()[f"fmu_export.pythonfmu.{module}"], "fmu_export.pythonfmu.life_cycle"
    found = {name.partition(".")[0] for name in imports(path, f"fmu_export.pythonfmu.{module}", set()) if name != own}
    assert found <= sys.stdlib_module_names


@pytest.mark.parametrize(
    ("file", "line", "expected"),
    [
        ("plant_fmu/model.py", "import casadi", "plant_fmu.model imports casadi"),
        (
            "plant_fmu/model.py",
            "from fmu_export.trace.trace import f",
            "plant_fmu.model imports fmu_export.trace.trace",
        ),
        ("plant_fmu/model.py", "from fmu_export.trace import trace", "plant_fmu.model imports fmu_export.trace.trace"),
        ("controller_fmu/model.py", "import scipy.optimize", "controller_fmu.model imports scipy.optimize"),
        ("controller_fmu/model.py", "def f():\n    import fmpy", "controller_fmu.model imports fmpy"),
        ("controller_fmu/optimal_gains.py", "import cosim", "controller_fmu.optimal_gains imports cosim"),
        ("trajectory_fmu/model.py", "import pythonfmu", "trajectory_fmu.model imports pythonfmu"),
        (
            "fmu_export/trace/trace.py",
            "from plant_fmu.model import M",
            "fmu_export.trace.trace imports plant_fmu.model",
        ),
        (
            "fmu_export/modelling/x.py",
            "import fmu_export.trace.trace",
            "fmu_export.modelling.x imports fmu_export.trace.trace",
        ),
        ("cosim/master/run.py", "from trajectory_fmu import model", "cosim.master.run imports trajectory_fmu.model"),
        ("cosim/master/run.py", "from ..scenario import x", "cosim.master.run imports cosim.scenario"),
        ("cosim/master/run.py", "from cosim.sweep import x", "cosim.master.run imports cosim.sweep"),
        ("cosim/system/system.py", "import cosim.master.run", "cosim.system.system imports cosim.master.run"),
        ("cosim/loop/binding.py", "import cosim.fmi.instance", "cosim.loop.binding imports cosim.fmi.instance"),
        ("cosim/__init__.py", "from parallel_robot.x import y", "cosim imports parallel_robot.x"),
        ("cosim/commands/run.py", "import parallel_robot", "cosim.commands.run imports parallel_robot"),
        ("cosim/master/run.py", "import fmu_export.x", "cosim.master.run imports fmu_export.x"),
        (
            "cosim/master/run.py",
            "import importlib\nimportlib.import_module('plant_fmu')",
            "cosim.master.run imports plant_fmu",
        ),
    ],
)
def test_the_checker_finds_a_planted_violation(tmp_path, file, line, expected):
    others = (
        "trajectory_fmu/model.py",
        "trajectory_fmu/__init__.py",
        "fmu_export/trace/trace.py",
        "cosim/master/run.py",
    )
    for other in (*others, file):
        (tmp_path / other).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / other).write_text("import numpy\n")
    assert violations(tmp_path) == []
    (tmp_path / file).write_text(f"import math\n{line}\n")
    assert violations(tmp_path) == [expected]


def test_the_cycle_finder_finds_cycles():
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert cycles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
