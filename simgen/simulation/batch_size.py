"""Batch size: the number of presses that run at once on a device, and the memory of one press."""

import warp as wp

from simgen.config.solver_settings import SolverSettings
from simgen.config.warp_device import name_of
from simgen.errors import InputError
from simgen.fem.elements.element import ELEMENTS
from simgen.fem.groups import FEWEST_ACTIVE, WIDTH
from simgen.fem.linear_solver.aggregation import SMALL
from simgen.fem.linear_solver.dense_inverse import SIDE, WIDE
from simgen.fem.linear_solver.krylov_kernels import WINDOW
from simgen.sensors.sensor import Sensor
from simgen.sensors.support import faces_in_reach

AT_ONCE = 512  # presses on a GPU
# On meshes with at most so many unknowns, more presses run at once, because the host limits a round. 4,096 presses on
# the coarse DIGIT and BioTac take 26.6 and 26.9 s with 512 at once, 18.1 and 20.9 s with 2,048 (248ee6f, one H200).
SMALL_MESH, MOST_AT_ONCE = 20_000, 2048
USABLE = 0.8  # of the free memory; the rest is for meshes and kernels


def bytes_per_press(sensor: Sensor, settings: SolverSettings | None = None) -> int:
    """Bytes of device memory that one running press takes: states, Krylov vectors, blocks, contact points.

    A fluid (some percent), partly filled tiles of blocks (see ``fem.blocks``) and the sparse factors of linear
    tetrahedra, which are in host memory, are left out.
    """
    mesh, settings = sensor.simulation_mesh, settings or SolverSettings()
    kind = ELEMENTS[settings.element]
    corners, nodes, unknowns = mesh.n_corners, _nodes(sensor, settings), _unknowns(sensor, settings)
    edges = len(mesh.nodes) - corners
    faces = [mesh.touchable] + ([mesh.facing_core] if sensor.core is not None else [])
    faces += [faces_in_reach(sensor.support, mesh)] if sensor.support is not None else []
    points = kind.face_points * sum(map(len, faces))
    double = 8 * unknowns  # x, trial, step, two parts of the forces and their sum, two earlier states
    vectors = settings.krylov_size + WINDOW + 5  # directions, images; four of the solver; the linearisation point
    blocks = edges * 2 + corners
    coarse = 0
    if kind.pressures:
        vectors += 4
        blocks = 1.5 * (nodes + blocks) + 0.5 * corners  # rounded copies and inverses take half as much
        coarse = 4 * SMALL * (SMALL + 2 * SIDE * WIDE)  # a dense inverse
    single = vectors * unknowns + 12 * corners
    in_contact = points * (3 * 24 + 36) + sum(44 * len(f) + 132 * len(set(f[:, :3].ravel())) for f in faces)
    output = 24 * len(sensor.output_mesh.vertices)
    products = 8 * settings.krylov_size * (settings.krylov_size + 2)
    weights = 4 * len(mesh.tetrahedra)
    return int(8 * double + 4 * single + 36 * blocks + coarse + weights + products + in_contact + output)


def _nodes(sensor: Sensor, settings: SolverSettings) -> int:
    mesh = sensor.simulation_mesh
    return len(mesh.nodes) if ELEMENTS[settings.element].nodes == 10 else mesh.n_corners


def _unknowns(sensor: Sensor, settings: SolverSettings) -> int:
    pressures = sensor.simulation_mesh.n_corners if ELEMENTS[settings.element].pressures else 0
    return 3 * _nodes(sensor, settings) + pressures


def at_once(sensor: Sensor, device: str, settings: SolverSettings, presses: int) -> int:
    """Number of presses on a sensor that run at once on a device with enough memory, if a task has ``presses``.

    A core computes `WIDTH` presses side by side. Linear tetrahedra gain nothing from that, and their sparse factors
    take much memory.
    """
    if device == "cpu":
        side_by_side = presses >= FEWEST_ACTIVE and ELEMENTS[settings.element].pressures
        return WIDTH if side_by_side else 1
    return MOST_AT_ONCE if _unknowns(sensor, settings) <= SMALL_MESH else AT_ONCE


def presses_at_once(sensor: Sensor, device: str, settings: SolverSettings, presses: int) -> int:
    """Number of presses that run at once on a device: :func:`at_once`, or fewer if a GPU's free memory is too small.

    Raises InputError if not even one fits.
    """
    most = at_once(sensor, device, settings, presses)
    if device == "cpu":
        return most
    each, free = bytes_per_press(sensor, settings), wp.get_device(device).free_memory
    fit = int(USABLE * free / each)
    if fit < 1:
        raise InputError(
            f"{name_of(device)}: {free / 1e9:.2g} GB of memory are free, one press on sensor {sensor.name} takes "
            f"{each / 1e9:.2g} GB; allowed: GPUs with more free memory in CUDA_VISIBLE_DEVICES, a coarser mesh, or a "
            "smaller krylov_size"
        )
    return min(most, fit)


def has_room_for_another(sensor: Sensor, device: str, settings: SolverSettings, presses: int) -> bool:
    """True if half of a GPU's free memory is enough for so many more presses; the rest is for other sensors."""
    return presses * bytes_per_press(sensor, settings) <= 0.5 * wp.get_device(device).free_memory
