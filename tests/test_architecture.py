"""The arrows of the house: who may import whom. Data walks one way, and so do imports."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import simgen

PACKAGE = Path(simgen.__file__).parent

# From left to right, as the data walk. A module may import from its own room and from rooms before it.
HOUSE = {
    "words": ["errors", "parsing", "yaml_files", "resources", "provenance", "quiet"],
    "job": ["section", "job", "job_schema", "indenter_path"],
    "shapes": ["distance", "shape"],
    "sensor": ["sensor", "sensor_schema", "sensor_meshes", "geometry", "tetrahedra", "surface", "curved",
               "interpolation", "mesh_files", "mesh_quality", "region_edges", "support", "sweep"],
    "indenter": ["indenter"],
    "pairing": ["pairing", "skin", "least_thickness", "gel_columns"],
    "fem": ["fem"],
    "press": ["press", "pool", "march", "press_queue", "tries", "samples", "surface_outputs", "scene", "first_touch",
              "capacity"],
    "dataset": ["dataset", "dataset_layout", "dataset_writer", "dataset_growth", "chunk_files", "whole_files",
                "folder_lock", "finding", "audit", "touch_audit", "touchable", "contact_patch", "run_status", "splits",
                "card", "loading", "torch_samples", "exchange", "hdf5_files", "electrode_files", "electrodes",
                "electrode_gaps", "electrode_model"],
    "run": ["image_resolution", "plan", "shard_writer", "shard", "workers", "run"],
    "views": ["drawing", "pictures", "page", "preview", "report", "console", "reference_page",
              "job_reference"],
    "optics": ["optics"],
    "validate": ["validate"],
    "bench": ["bench"],
    "training": ["training"],
    "translate": ["translate"],
    "cli": ["cli", "cli_exchange", "cli_images"],
}  # fmt: skip
ROOM = {module: number for number, modules in enumerate(HOUSE.values()) for module in modules}


def module_files() -> dict[str, list[Path]]:
    """Top-level module of the package -> its files; a folder is one module."""
    files = {path.stem: [path] for path in PACKAGE.glob("*.py") if path.stem != "__init__"}
    folders = {path.parent.name: sorted(path.parent.rglob("*.py")) for path in PACKAGE.glob("*/__init__.py")}
    return files | folders


class _WithoutTypeChecking(ast.NodeTransformer):
    def visit_If(self, node):
        return None if ast.unparse(node.test).endswith("TYPE_CHECKING") else self.generic_visit(node)


def imports(path: Path) -> set[str]:
    """Dotted names that a file imports, anywhere but for type checkers; of simgen as ``simgen.module``."""
    inside = path.relative_to(PACKAGE).with_suffix("").parts
    found = set()
    tree = _WithoutTypeChecking().visit(ast.parse(path.read_text(encoding="utf-8")))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ["simgen", *inside[: len(inside) - node.level]] if node.level else []
            base += node.module.split(".") if node.module else []
            found |= {".".join([*base, alias.name]) for alias in node.names}
    return found


def own_imports(module: str) -> set[str]:
    names = {name for file in module_files()[module] for name in imports(file)}
    return {name.split(".")[1] for name in names if name.startswith("simgen.")} & set(module_files()) - {module}


def third_party(module: str) -> set[str]:
    return {name.split(".")[0] for file in module_files()[module] for name in imports(file)}


def test_every_module_has_its_room():
    assert sorted(module_files()) == sorted(ROOM)


@pytest.mark.parametrize("module", sorted(module_files()))
def test_imports_follow_the_arrows(module):
    backwards = {other for other in own_imports(module) if ROOM[other] > ROOM[module]}
    assert not backwards, f"{module} imports {backwards} from a later room"


def test_no_module_imports_itself_in_a_circle():
    graph = {module: own_imports(module) for module in module_files()}
    while free := [module for module, needs in graph.items() if not needs & graph.keys()]:
        for module in free:
            del graph[module]
    assert not graph, f"circle among {sorted(graph)}"


def test_only_workers_import_dask():
    assert [module for module in module_files() if {"dask", "distributed"} & third_party(module)] == ["workers"]


def test_only_the_command_line_imports_views():
    views = set(HOUSE["views"])
    may = {"validate", "training", "optics", "translate", *HOUSE["cli"]}
    for module in set(module_files()) - views - may:
        assert not own_imports(module) & views, module


def test_only_the_command_line_imports_the_validation():
    assert {module for module in module_files() if "validate" in own_imports(module)} <= {"bench", "cli"}
    assert {module for module in module_files() if "bench" in own_imports(module)} <= {"cli"}


def test_nothing_but_training_imports_torch():
    assert {module for module in module_files() if "torch" in third_party(module)} == {"torch_samples", "training"}


def loaded_after(statement: str) -> set[str]:
    code = f"{statement}; import sys; print(*{{name.split('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_help_needs_none_of_the_heavy_packages():
    heavy = {
        "numpy",
        "scipy",
        "warp",
        "pyvista",
        "zarr",
        "dask",
        "trimesh",
        "matplotlib",
        "plotly",
        "pydantic",
        "torch",
    }
    assert not heavy & loaded_after("import simgen.cli")


def test_a_run_draws_nothing_and_learns_nothing():
    assert not {"torch", "matplotlib", "plotly"} & loaded_after("import simgen.run")
