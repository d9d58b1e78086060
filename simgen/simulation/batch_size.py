"""Batch size: the number of presses that run at once on a device, and the memory of one press."""

import warp as wp

from simgen.config.solver_settings import SolverSettings
from simgen.errors import InputError
from simgen.fem.elements.element import ELEMENTS
from simgen.fem.linear_solver.aggregation import SMALL
from simgen.fem.linear_solver.dense_inverse import SIDE, WIDE
from simgen.fem.linear_solver.krylov_kernels import WINDOW
from simgen.sensors.sensor import Sensor
from simgen.sensors.support import faces_in_reach

AT_ONCE = {"cpu": 1, "cuda": 512}  # presses
USABLE = 0.8  # of the free memory; the rest is for meshes and kernels


def bytes_per_press(sensor: Sensor, settings: SolverSettings | None = None) -> int:
    """Bytes of device memory that one running press takes: states, Krylov vectors, blocks, contact points.

    A fluid (some percent), partly filled tiles of blocks (see ``fem.blocks``) and the sparse factors of linear
    tetrahedra, which are in host memory, are left out.
    """
    mesh, settings = sensor.simulation_mesh, settings or SolverSettings()
    kind = ELEMENTS[settings.element]
    corners = mesh.n_corners
    nodes = len(mesh.nodes) if kind.nodes == 10 else corners
    unknowns = 3 * nodes + (corners if kind.pressures else 0)
    edges = len(mesh.nodes) - corners
    faces = [mesh.touchable] + ([mesh.facing_core] if sensor.core is not None else [])
    faces += [faces_in_reach(sensor.support, mesh)] if sensor.support is not None else []
    points = kind.face_points * sum(map(len, faces))
    double = 8 * unknowns  # x, trial, step, two parts of the forces and their sum, two earlier states
    vectors = settings.krylov_size + WINDOW + 5  # directions, images; four of the solver; the linearisation point
    blocks = edges * 2 + corners
    coarse = 0
    if kind.pressures:
        vectors += 3
        blocks = 2 * nodes + blocks + corners
        coarse = 4 * SMALL * (SMALL + 2 * SIDE * WIDE)  # a dense inverse
    single = vectors * unknowns + 12 * corners
    in_contact = points * (3 * 24 + 36) + sum(44 * len(f) + 132 * len(set(f[:, :3].ravel())) for f in faces)
    output = 24 * len(sensor.output_mesh.vertices)
    products = 8 * settings.krylov_size * (settings.krylov_size + 2)
    weights = 4 * len(mesh.tetrahedra)
    return 8 * double + 4 * single + 36 * blocks + coarse + weights + products + in_contact + output


def at_once(device: str) -> int:
    """Number of presses that run at once on a device with enough memory."""
    return AT_ONCE[device.partition(":")[0]]


def presses_at_once(sensor: Sensor, device: str, settings: SolverSettings) -> int:
    """Number of presses that run at once on a device: `AT_ONCE`, or fewer if the free memory is too small.

    Raises InputError if not even one fits.
    """
    most = at_once(device)
    if most == 1:
        return 1
    each, free = bytes_per_press(sensor, settings), wp.get_device(device).free_memory
    fit = int(USABLE * free / each)
    if fit < 1:
        raise InputError(
            f"{device}: {free / 1e9:.2g} GB of memory are free, one press on sensor {sensor.name} takes "
            f"{each / 1e9:.2g} GB; allowed: a coarser mesh or a smaller krylov_size"
        )
    return min(most, fit)
