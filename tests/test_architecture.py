"""The arrows between the parts of the project run one way; found by reading the sources, importing nothing."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("plant_fmu", "controller_fmu", "fmu_export", "cosim")

#: Offline tools beside the controller's model; they are no models and may use scipy.
TOOLS = ("controller_fmu.membership", "controller_fmu.optimal_gains", "controller_fmu.uniqueness")

#: What holds the parts together, and so may know all.
KNOW_ALL = ("cosim.robot", "cosim.commands", "cosim.__main__")


def module_name(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def sources(root: Path = ROOT) -> dict[str, Path]:
    """Module name -> file, of all packages."""
    return {module_name(p, root): p for package in PACKAGES for p in sorted((root / package).rglob("*.py"))}


class NoTypeChecking(ast.NodeTransformer):
    """Drop what only a type checker reads."""

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.AST]:
        self.generic_visit(node)
        return list(node.orelse) if ast.unparse(node.test).endswith("TYPE_CHECKING") else node


def imports(path: Path, module: str, known: set[str], *, for_types: bool = True) -> set[str]:
    """Modules that a file imports anywhere, functions included; `from package import module` counts as the module."""
    found = set()
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree if for_types else NoTypeChecking().visit(tree)):
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
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in (
            "__import__",
            "importlib.import_module",
        ):
            found |= {a.value for a in node.args[:1] if isinstance(a, ast.Constant)}
    return found


def inside(name: str, *packages: str) -> bool:
    return any(name == p or name.startswith(p + ".") for p in packages)


def is_model(module: str) -> bool:
    own = inside(module, "plant_fmu", "controller_fmu") and not inside(module, *TOOLS)
    return own or module == "cosim.robot.trajectory"


def allowed(module: str, imported: str) -> bool:
    """Whether one module may import another; the standard library always."""
    if imported.partition(".")[0] in sys.stdlib_module_names:
        return True
    if is_model(module):
        return (
            imported in ("numpy", "fmu_export.model", "fmu_export.norm", "fmu_export.saturation")
            or is_model(imported)
            or inside(imported, "numpy")
        )
    if inside(module, "controller_fmu"):
        return inside(imported, "numpy", "scipy", "controller_fmu", "fmu_export.model")
    if inside(module, "fmu_export"):
        return not inside(imported, "plant_fmu", "controller_fmu", "cosim")
    if inside(module, *KNOW_ALL):
        return True
    return not inside(imported, *KNOW_ALL, "plant_fmu", "controller_fmu", "fmu_export")


def violations(root: Path = ROOT) -> list[str]:
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


def part(module: str) -> str:
    """The part of the project that a module belongs to."""
    if inside(module, "cosim"):
        return next((p for p in KNOW_ALL if inside(module, p)), "cosim")
    return module.partition(".")[0]


def module_graph(root: Path = ROOT) -> dict[str, set[str]]:
    """What runs when a module is imported or used; imports for a type checker do not."""
    modules = sources(root)
    return {m: (imports(p, m, set(modules), for_types=False) & set(modules)) - {m} for m, p in modules.items()}


def test_the_sources_are_found():
    modules = sources()
    assert {"plant_fmu.model", "controller_fmu.model", "fmu_export.trace", "cosim.master", "cosim"} <= set(modules)
    graph = module_graph()
    assert "fmu_export.model" in graph["plant_fmu.model"]
    assert {"plant_fmu.model", "plant_fmu.kinematics"} <= graph["cosim.robot.trajectory"]


def test_arrows_run_one_way():
    assert violations() == []


def test_no_module_imports_itself_in_a_circle():
    assert cycles(module_graph()) == []


def test_no_circle_between_parts():
    """A model outside its package is part of the models: the trajectory uses the plant's kinematics."""
    parts: dict[str, set[str]] = {}
    for module, imported in module_graph().items():
        if not inside(module, *KNOW_ALL):
            parts.setdefault(part(module), set()).update(part(i) for i in imported if part(i) != part(module))
    assert cycles(parts) == []
    assert "fmu_export" in parts["plant_fmu"]
    assert not any(inside(p, *KNOW_ALL) for targets in parts.values() for p in targets)


def test_the_slave_in_the_archive_needs_the_standard_library_only():
    path = sources()["fmu_export.pythonfmu_slave"]
    found = {name.partition(".")[0] for name in imports(path, "fmu_export.pythonfmu_slave", set())}
    assert found <= sys.stdlib_module_names


@pytest.mark.parametrize(
    ("file", "line", "expected"),
    [
        ("plant_fmu/model.py", "import casadi", "plant_fmu.model imports casadi"),
        (
            "plant_fmu/model.py",
            "from fmu_export.trace import trace",
            "plant_fmu.model imports fmu_export.trace",
        ),
        ("plant_fmu/model.py", "from fmu_export import trace", "plant_fmu.model imports fmu_export.trace"),
        ("controller_fmu/model.py", "import scipy.optimize", "controller_fmu.model imports scipy.optimize"),
        ("controller_fmu/model.py", "def f():\n    import fmpy", "controller_fmu.model imports fmpy"),
        ("controller_fmu/optimal_gains.py", "import cosim", "controller_fmu.optimal_gains imports cosim"),
        ("cosim/robot/trajectory.py", "import pythonfmu", "cosim.robot.trajectory imports pythonfmu"),
        (
            "fmu_export/trace.py",
            "from plant_fmu.model import MODEL",
            "fmu_export.trace imports plant_fmu.model",
        ),
        (
            "cosim/master.py",
            "from cosim.robot import trajectory",
            "cosim.master imports cosim.robot.trajectory",
        ),
        ("cosim/master.py", "from .robot import trajectory", "cosim.master imports cosim.robot.trajectory"),
        ("cosim/master.py", "from . import robot", "cosim.master imports cosim.robot"),
        ("cosim/__init__.py", "from .robot.trajectory import x", "cosim imports cosim.robot.trajectory"),
        ("cosim/master.py", "import fmu_export.model", "cosim.master imports fmu_export.model"),
        (
            "cosim/master.py",
            "import importlib\nimportlib.import_module('plant_fmu')",
            "cosim.master imports plant_fmu",
        ),
    ],
)
def test_the_checker_finds_a_planted_violation(tmp_path, file, line, expected):
    for other in (
        "cosim/robot/trajectory.py",
        "cosim/robot/__init__.py",
        "fmu_export/trace.py",
        "fmu_export/model.py",
        file,
    ):
        (tmp_path / other).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / other).write_text("import numpy\n")
    assert violations(tmp_path) == []
    (tmp_path / file).write_text(f"import math\n{line}\n")
    assert violations(tmp_path) == [expected]


def test_the_cycle_finder_finds_cycles():
    assert cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
    assert cycles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
