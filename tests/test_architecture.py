"""The house: its folders in the order in which data walk, imports that follow it, and tests that mirror it."""

import ast
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

import simgen

PACKAGE = Path(simgen.__file__).parent
TESTS = Path(__file__).parent

# In the order in which data walk. A folder imports from those before it. Everything may import `errors` and `units`.
FOLDERS = ["config", "geometry", "sensors", "fem", "simulation", "dataset", "pipeline", "sensing",
           "calibration", "plotting", "learning", "report", "verification", "view", "cli"]  # fmt: skip
LEARNING = ["data", "evaluation", "networks", "training", "translation"]  # the same within `learning`
FLOOR = {folder: number for number, folder in enumerate(["errors", "units", *FOLDERS])}
FILES = {".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"): path
         for path in PACKAGE.rglob("*.py") if path.parent != PACKAGE or path.stem != "__init__"}  # fmt: skip

# Modules without a file of tests, and why.
UNTESTED = {
    "config.solver_settings": "fields of one section; tests/docs/test_reference_page.py checks their meanings",
    "fem.precision": "names of number types",
    "units": "three numbers",
}


def imported_names(module: str) -> set[str]:
    """Dotted names that a module imports anywhere, for type checkers and inside functions too."""
    path, found = FILES[module], set()
    package = ["simgen", *path.relative_to(PACKAGE).parent.parts]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            base = base + (node.module.split(".") if node.module else [])
            found |= {".".join([*base, alias.name]) for alias in node.names}
    return found


def own_imports(module: str) -> set[str]:
    """Modules of simgen that a module imports."""
    names = {name.removeprefix("simgen.") for name in imported_names(module) if name.startswith("simgen.")}
    return {name if name in FILES else name.rpartition(".")[0] for name in names} & FILES.keys() - {module}


def modules_with(*packages: str) -> set[str]:
    """Modules that import one of these packages."""
    return {module for module in FILES if {name.split(".")[0] for name in imported_names(module)} & set(packages)}


def test_the_root_holds_the_folders_alone():
    entries = {path.name for path in PACKAGE.iterdir() if path.name != "__pycache__"}
    assert entries == {*FOLDERS, "__init__.py", "errors.py", "units.py"}
    assert {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()} == set(FOLDERS)


@pytest.mark.parametrize("module", sorted(FILES))
def test_imports_follow_the_order_of_the_folders(module):
    floor = FLOOR[module.split(".")[0]]
    later = {other for other in own_imports(module) if FLOOR[other.split(".")[0]] > floor}
    assert not later, f"{module} imports {later}"


@pytest.mark.parametrize("module", sorted(name for name in FILES if name.startswith("learning.")))
def test_imports_within_learning_follow_the_order_of_its_folders(module):
    """Test what holds for all folders, for those of `learning`, too."""
    floor = {folder: number for number, folder in enumerate(LEARNING)}
    later = {name for name in own_imports(module) if name.startswith("learning.")
             and floor[name.split(".")[1]] > floor[module.split(".")[1]]}  # fmt: skip
    assert not later, f"{module} imports {later}"


def test_no_module_imports_itself_in_a_circle():
    graph = {module: own_imports(module) for module in FILES}
    while free := [module for module, needs in graph.items() if not needs & graph.keys()]:
        for module in free:
            del graph[module]
    assert not graph, f"circle among {sorted(graph)}"


def test_each_heavy_package_has_its_place():
    assert modules_with("dask", "distributed") == {"pipeline.workers", "pipeline.local_cluster"}
    assert {module.split(".")[0] for module in modules_with("typer")} == {"cli"}
    assert {module.split(".")[0] for module in modules_with("nicegui", "fastapi", "starlette")} <= {"view"}
    torch = modules_with("torch", "safetensors")
    assert {module.split(".")[0] for module in torch} - {"cli"} == {"learning", "dataset"}
    assert {module for module in torch if module.startswith("dataset")} == {"dataset.loading"}


def test_no_public_class_has_the_name_of_another():
    names = Counter(
        node.name
        for path in FILES.values()
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert {name for name, count in names.items() if count > 1} == set()


def test_tests_mirror_the_modules():
    """Every module has its file of tests, and every file of tests beside them has its module or package."""
    modules = {module for module, path in FILES.items() if path.stem not in ("__init__", "__main__")}
    tested = {".".join([*path.relative_to(TESTS).parent.parts, path.stem.removeprefix("test_")])
              for path in TESTS.rglob("test_*.py")}  # fmt: skip
    assert modules - tested == UNTESTED.keys()


def loaded_after(statement: str) -> set[str]:
    code = f"{statement}; import sys; print(*{{name.split('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_help_needs_none_of_the_heavy_packages():
    heavy = {"numpy", "scipy", "warp", "zarr", "dask", "trimesh", "pydantic", "torch"}
    drawing = {"pyvista", "matplotlib", "plotly"}
    assert not (heavy | drawing) & loaded_after("import simgen.cli.app")


def test_a_run_draws_nothing_and_learns_nothing():
    assert not {"torch", "matplotlib", "plotly"} & loaded_after("import simgen.pipeline.run")
