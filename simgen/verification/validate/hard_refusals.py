"""Hard cases of the input: bad meshes, impossible poses of indenters, and values without meaning."""

import math
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
from scipy.optimize import brentq

from simgen.config.job import job_from_dict
from simgen.errors import InputError
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.geometry.interpolation import TET_EDGES
from simgen.geometry.mesh_quality import mean_ratio
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Status
from simgen.verification.validate.case import Context, Outcome, Row, Table, at_most, case
from simgen.verification.validate.hard import SPHERE, TARGET
from simgen.verification.validate.hard_outcomes import GIVEN_UP, Attempt, attempt, evidence, verdicts
from simgen.verification.validate.hard_scenes import COUNTS, SIZE_MM, above_block, block, down, scene_of
from simgen.verification.validate.meshes import Mesh, box, perturbed

MEAN_RATIOS = (0.1, 0.01, 1e-3, 1e-4)  # worst mean ratios; the quality gates require 0.15
FINE = (6, 3, 6)
USER_SENSOR = """
name: block
gel: {mesh: {file: gel.vtu, unit: mm}}
held: {bottom: {plane: {axis: y, at_mm: 4.0}}}
meshes: {default: as_given}
materials: {solid: {youngs_modulus_pa: 539.0e+3, poisson_ratio: 0.499, friction: 0.78}}
"""
DEEP, COARSE = (3, 2, 3), ((2, 1, 2), (3, 2, 3), (4, 2, 4))


@case("hard-meshes", "Hard: slivers, coarse meshes, bent edges", "quick")
def meshes(context: Context) -> Outcome:
    """Press a block on meshes with slivers, bent edges and few elements."""

    def pressed(name: str, mesh: Mesh) -> Attempt:
        scene = scene_of(block(mesh), context.device)
        name = f"{name}, {scene.unknowns} unknowns, mean ratio >= {least_ratio(mesh):.2g}"
        return attempt(name, scene, SPHERE, above_block(), down(1.0, 5))

    regular = box(FINE, SIZE_MM)
    plain = pressed(f"{cells(FINE)} cells", regular)
    bad = [pressed("a corner moved", sliver(regular, ratio)) for ratio in MEAN_RATIOS]
    bad.append(pressed("edges bent by 0.05 mm", perturbed(regular, 0.0, 0.05, inside_only=True)))
    coarse = [pressed(f"{cells(counts)} cells", box(counts, SIZE_MM)) for counts in COARSE]
    rows = verdicts([plain, *bad, *coarse])
    rows += [Row(f"{a.name}: force at 1 mm", "N", a.force[-1], plain.force[-1], TARGET, "relative",
                 "the regular mesh; the project's target") for a in bad]  # fmt: skip
    error = Table("Error of a coarse mesh, which no certificate shows", ["mesh", f"force over {plain.name}"],
                  [[a.name, float(a.force[-1] / plain.force[-1])] for a in coarse])  # fmt: skip
    table = evidence("Meshes of one block of 10 x 4 x 10 mm, a sphere 1 mm deep", [plain, *bad, *coarse])
    return Outcome(rows, [table, error])


def cells(counts: tuple[int, int, int]) -> str:
    """Format the cells of a box."""
    return " x ".join(map(str, counts))


def least_ratio(mesh: Mesh) -> float:
    """Return the least mean ratio of a mesh."""
    return float(mean_ratio(mesh.nodes, mesh.tetrahedra[:, :4]).min())


def sliver(mesh: Mesh, ratio: float) -> Mesh:
    """Move the inner corner nearest to the middle of the top until the least mean ratio is ``ratio``.

    Edges stay straight.
    """
    inside = np.setdiff1d(np.arange(mesh.n_corners), mesh.faces)
    moved = inside[np.linalg.norm(mesh.nodes[inside], axis=1).argmin()]
    way = np.array([1.0, 0.3, 0.2])

    def at(distance: float) -> Mesh:
        nodes = mesh.nodes.copy()
        nodes[moved] += distance * way
        nodes[mesh.tetrahedra[:, 4:].ravel()] = nodes[mesh.tetrahedra[:, TET_EDGES].reshape(-1, 2)].mean(axis=1)
        return mesh._replace(nodes=nodes)

    far = np.linalg.norm(mesh.nodes[mesh.tetrahedra[0, 0]] - mesh.nodes[mesh.tetrahedra[0, 1]])
    return at(brentq(lambda distance: least_ratio(at(distance)) - ratio, 0.0, far, xtol=1e-12))


@case("hard-refusals", "Hard: bad input and impossible presses, and their messages", "quick")
def refusals(context: Context) -> Outcome:
    """Try presses that must fail, and bad input that must be refused."""
    scene = scene_of(block(), context.device)
    cube, pin = load_indenter("cube_14mm").shape(), rigid_shape(Kind.SPHERE, 0.05)
    attempts = [
        attempt("starts inside", scene, cube, above_block(y_mm=12.0), down(0.4, 2), (Status.STARTS_INSIDE,)),
        attempt("never touches", scene, SPHERE, above_block(x_mm=30.0), down(0.4, 2), (Status.NEVER_TOUCHES,)),
        # This press may converge with inverted elements below the bond. Such a sample is flagged. On the mesh of the
        # other presses it ends at the same depth, with one such sample, but takes four times as long.
        attempt("4.5 mm into a gel of 4 mm", scene_of(block(box(DEEP, SIZE_MM)), context.device), SPHERE, above_block(),
                down(4.5, 9), (*GIVEN_UP, Status.NOT_RESOLVED, Status.INSIDE_OUT)),
    ]
    fine = attempt("a pin of 0.05 mm on faces of 2.5 mm", scene, pin, above_block(), down(0.4, 2),
                   (Status.NOT_RESOLVED, Status.NEVER_TOUCHES))  # fmt: skip
    silent = int((fine.force[: fine.converged] == 0.0).sum())
    refused = bad_input(context.scratch)
    said = [[name, text or "TAKEN"] for name, text in refused.items()]
    one_line = sum(bool(text) and "\n" not in text for text in refused.values())
    rows = [*verdicts([*attempts, fine]),
            at_most(f"{fine.name}: samples that converge without any force", "", silent, 0.0, "a pressed gel resists"),
            Row("bad input that is refused in one line", "", one_line, len(said), 0.0, "absolute",
                "errors.InputError, or ValueError below the job")]  # fmt: skip
    tables = [evidence("Impossible presses", [*attempts, fine]), Table("Bad input", ["input", "message"], said)]
    return Outcome(rows, tables)


def bad_input(scratch: Path) -> dict[str, str]:
    """Try each bad input and return its message; empty if the input is accepted."""
    job = {"name": "hard", "seed": 1, "sensors": {"digit": {"model": "digit", "mesh": "coarse"}},
           "indenters": ["sphere_7mm"], "trajectories": {"count": 1},
           "depths_mm": {"first": 0.1, "last": 1.0, "count": 10}}  # fmt: skip

    def material(**values) -> Callable:
        return lambda: job_from_dict({**job, "sensors": {"digit": {"model": "digit", "material": values}}})

    def depths(**values) -> Callable:
        return lambda: job_from_dict({**job, "depths_mm": {**job["depths_mm"], **values}})

    regular = box(COUNTS, SIZE_MM)
    slivers, inverted = sliver(regular, MEAN_RATIOS[0]), perturbed(regular, 4.0, 0.0, inside_only=True)
    inputs = {
        "nu = 0.5 in a job": material(poisson_ratio=0.5),
        "nu = 0.5 in the material law": lambda: NeoHookean.from_engineering(1.0, 0.5, 3.0),
        "nu = 0": material(poisson_ratio=0.0),
        "E = 0": material(youngs_modulus_pa=0.0),
        "E = NaN": material(youngs_modulus_pa=math.nan),
        "friction = -0.1": material(friction=-0.1),
        "friction = 3": material(friction=3.0),
        "a first depth of 0": depths(first=0.0),
        "a last depth of NaN": depths(last=math.nan),
        "no depth": depths(count=0),
        "a sensor's mesh with slivers": lambda: load_sensor(user_sensor(scratch, "slivers", slivers)),
        "a sensor's mesh with inverted elements": lambda: load_sensor(user_sensor(scratch, "inverted", inverted)),
        "inverted elements in the solver": lambda: scene_of(block(inverted), "cpu"),
    }
    return {name: words(call).replace(f"{scratch}/", "") for name, call in inputs.items()}


def words(call: Callable) -> str:
    """Return the message with which a call is refused; empty if it is not."""
    try:
        call()
    except (InputError, ValueError) as error:
        return str(error) or type(error).__name__
    return ""


def user_sensor(scratch: Path, name: str, mesh: Mesh) -> Path:
    """Write the folder of a user's own sensor, with the corners of a mesh of the block."""
    folder = scratch / name
    folder.mkdir()
    (folder / "sensor.yaml").write_text(USER_SENSOR)
    meshio.Mesh(mesh.nodes[: mesh.n_corners], [("tetra", mesh.tetrahedra[:, :4])]).write(folder / "gel.vtu")
    return folder
