"""Compare simgen with Newton's VBD solver: a sphere pressed 1 mm into a bonded layer, many presses at once.

    pip install newton
    python benchmarks/peers_gpu.py --device cuda --edges 0.9 0.6 --batches 1 64 512 --output peers_gpu.json

The layer is that of the reference solutions (R = 10 mm, 4 mm high, E = 0.539 MPa), the sphere has R = 3.5 mm, and
nothing rubs. simgen takes quadratic elements of the mesh, VBD linear ones of the same corners. The time of VBD is that
of the frames after which twice as many change the force by less than 0.5 % and no surface node by more than 1 um.
Errors are those against simgen on edges of 0.15 mm, whose force for nu = 0.499 is 0.1 % above NGSolve's. Settings of
VBD that were needed: velocities are zeroed after each frame, 20 iterations a frame, contact stiffness 3e5 N/m. Newton's
solver is Chen et al., ACM Trans. Graph. 43, 2024.
"""

import json
import time

import numpy as np
import warp as wp
from record import arguments, write

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensors.sensor import Material
from simgen.simulation.press import Scene, press
from simgen.units import MM_PER_M, UM_PER_M
from simgen.verification.validate.layer_meshes import fixed_symmetric, graded, make_sensor, round_layer
from simgen.verification.validate.layer_press import LayerMeshSize, layer_gel, quarter_layer
from simgen.verification.validate.layer_reference import HEIGHT_MM, MODULUS_MPA, RADIUS_MM
from simgen.verification.validate.meshes import Mesh, on_plane, top

SPHERE_MM, DEPTH_MM, NEAR_MM = 3.5, 1.0, 6.0  # errors of the surface count within NEAR_MM of the axis
FORCE_CHANGE, SURFACE_CHANGE_UM = 5e-3, 1.0
REFERENCE = LayerMeshSize(0.15, until=2.5, growth=0.1, top=0.15)
RADII_MM = np.linspace(0.0, NEAR_MM, 121)
FRAME_S, ITERATIONS, CONTACT_STIFFNESS, DENSITY = 1e-2, 20, 3e5, 1000.0  # of VBD; N/m, kg/m3
APPROACH_FRAMES = 2


@wp.kernel(enable_backward=False)
def approach_kernel(step: float, end: float, pose_out: wp.array(dtype=wp.transform)):
    i = wp.tid()
    at = wp.transform_get_translation(pose_out[i])
    pose_out[i] = wp.transform(wp.vec3(at[0], wp.min(at[1] + step, end), at[2]), wp.quat_identity())


def layer(edge: float) -> Mesh:
    """Whole layer, its top at y = 0 facing -y, with edges of nearly equal length, mm."""
    levels = graded(HEIGHT_MM, edge, HEIGHT_MM, 0.0)
    return round_layer(graded(RADIUS_MM, edge, RADIUS_MM, 0.0), levels, segments=64, quarters=4)


def gel(nu: float) -> Material:
    """The reference's material without friction, with another Poisson's ratio."""
    return layer_gel(0.0).model_copy(update={"poisson_ratio": nu})


def solve(scene: Scene, batch: int) -> tuple[list, float]:
    """Press the sphere in one step; returns the results and the seconds."""
    shapes, poses = [rigid_shape(Kind.SPHERE, SPHERE_MM)] * batch, np.tile(np.eye(4), (batch, 1, 1))
    begin = time.perf_counter()
    results = press(scene, shapes, poses, np.array([DEPTH_MM / MM_PER_M]))
    return results, time.perf_counter() - begin


class Reference:
    """Force (N) and surface of simgen on a fine quarter of the layer."""

    def __init__(self, nu: float, device: str):
        [result], _ = solve(Scene(quarter_layer(REFERENCE, RADII_MM), gel(nu), device=device), 1)
        self.force = 4.0 * abs(float(result.force[-1, 1]))  # on a quarter, other components balance the symmetry
        along_x = result.displacement[-1].reshape(-1, len(RADII_MM), 3)[0] * MM_PER_M
        self._outwards, self._inwards = along_x[:, 0], along_x[:, 1]

    def error_um(self, points: np.ndarray, moved: np.ndarray) -> float:
        """Root mean square of the distance of surface points (p, 3) mm, moved by (p, 3) mm, from the reference."""
        r = np.hypot(points[:, 0], points[:, 2])
        near = r < NEAR_MM
        direction = points[:, [0, 2]] / np.maximum(r, 1e-9)[:, None]
        expected = np.interp(r, RADII_MM, self._outwards)[:, None] * direction
        expected = np.column_stack([expected[:, 0], np.interp(r, RADII_MM, self._inwards), expected[:, 1]])
        return float(np.sqrt(((moved - expected)[near] ** 2).sum(axis=1).mean()) * UM_PER_M / MM_PER_M)


class VbdLayers:
    """Layers with their spheres in Newton's model: ``batch`` worlds."""

    def __init__(self, mesh: Mesh, nu: float, batch: int, device: str):
        import newton

        self.rest, self.batch, self.device = mesh.nodes[: mesh.n_corners], batch, device
        self._fixed = on_plane(self.rest, 1, HEIGHT_MM)
        modulus = 1e6 * MODULUS_MPA
        one = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        one.add_soft_mesh(
            pos=(0.0, 0.0, 0.0), rot=wp.quat_identity(), scale=1.0, vel=(0.0, 0.0, 0.0),
            vertices=[tuple(p) for p in self.rest / MM_PER_M], indices=mesh.tetrahedra[:, :4].ravel().tolist(),
            density=DENSITY, k_mu=modulus / (2.0 * (1.0 + nu)), k_lambda=modulus * nu / (1.0 + nu) / (1.0 - 2.0 * nu),
            k_damp=0.0, particle_radius=0.0, add_surface_mesh_edges=False,
        )  # fmt: skip
        for i in np.flatnonzero(self._fixed):
            one.particle_mass[i] = 0.0
            one.particle_flags[i] = int(one.particle_flags[i]) & ~int(newton.ParticleFlags.ACTIVE)
        contact = newton.ModelBuilder.ShapeConfig(ke=CONTACT_STIFFNESS, kd=0.0, mu=0.0)
        radius = SPHERE_MM / MM_PER_M
        start = wp.transform(wp.vec3(0.0, -radius, 0.0), wp.quat_identity())
        one.add_shape_sphere(-1, xform=start, radius=radius, cfg=contact)
        one.color(balance_colors=False)
        whole = one
        if batch > 1:
            whole = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
            whole.replicate(one, batch, spacing=(0.0, 0.0, 0.0))
        self.model = whole.finalize(device=device)
        self.model.soft_contact_ke, self.model.soft_contact_kd, self.model.soft_contact_mu = CONTACT_STIFFNESS, 0.0, 0.0
        most = int(0.6 * batch * len(self.rest))
        self._collisions = newton.CollisionPipeline(self.model, soft_contact_gap=3e-4, soft_contact_max=most)
        self._contacts, self._control = self._collisions.contacts(), self.model.control()
        self._solver = newton.solvers.SolverVBD(
            self.model, iterations=ITERATIONS, particle_enable_self_contact=False, particle_enable_tile_solve=True
        )
        self._states, self._graph = (self.model.state(), self.model.state()), None
        self._prepare()

    def _prepare(self):
        """Load the kernels, record two frames as a graph, and return to rest."""
        positions, poses = wp.clone(self._states[0].particle_q), wp.clone(self.model.shape_transform)
        self._two_frames()
        if wp.get_device(self.device).is_cuda:
            with wp.ScopedCapture(device=self.device) as recorded:
                self._two_frames()
            self._graph = recorded.graph
        wp.copy(self._states[0].particle_q, positions)
        self._states[0].particle_qd.zero_()
        wp.copy(self.model.shape_transform, poses)
        wp.synchronize()

    def _two_frames(self):
        end = (DEPTH_MM - SPHERE_MM) / MM_PER_M
        for before, after in (self._states, self._states[::-1]):
            inputs, poses = [DEPTH_MM / MM_PER_M / APPROACH_FRAMES, end], self.model.shape_transform
            wp.launch(approach_kernel, dim=len(poses), inputs=inputs, outputs=[poses], device=self.device)
            self._collisions.collide(before, self._contacts)
            self._solver.step(before, after, self._control, self._contacts, FRAME_S)
            after.particle_qd.zero_()

    def advance(self, frames: int):
        """Advance by an even number of frames."""
        for _ in range(frames // 2):
            if self._graph is None:
                self._two_frames()
            else:
                wp.capture_launch(self._graph)
        wp.synchronize()

    def measure(self) -> tuple[float, np.ndarray]:
        """Force (N) on the first sphere, and displacements (corners, 3) mm of the first layer."""
        at = self._states[0].particle_q.numpy()[: len(self.rest)].astype(float)
        away = at - self.model.shape_transform.numpy()[0, :3]
        distance = np.linalg.norm(away, axis=1)
        overlap = np.maximum(SPHERE_MM / MM_PER_M - distance, 0.0) * ~self._fixed
        force = CONTACT_STIFFNESS * (overlap[:, None] * away / distance[:, None]).sum(axis=0)
        return float(np.linalg.norm(force)), at * MM_PER_M - self.rest


def settle(layers: VbdLayers, surface: np.ndarray, limit_s: float) -> tuple[float, np.ndarray, float, int] | None:
    """Double the frames until nothing changes; returns force, displacements, seconds and frames, or None."""
    frames, spent, last = 2, 0.0, None
    done = 0
    while spent < limit_s:
        begin = time.perf_counter()
        layers.advance(frames - done)
        spent, done = spent + time.perf_counter() - begin, frames
        force, moved = layers.measure()
        if not np.isfinite(moved).all():
            return None
        if last is not None and last[0] > 0.0:
            change = np.abs(moved - last[1])[surface].max() * UM_PER_M / MM_PER_M
            if abs(force / last[0] - 1.0) < FORCE_CHANGE and change < SURFACE_CHANGE_UM:
                return last
        last, frames = (force, moved, spent, done), 2 * frames
    return None


def compare(edge: float, nu: float, batch: int, asked, reference: Reference) -> list[dict]:
    """Measure both engines on one mesh with one batch."""
    mesh, device = layer(edge), asked.device
    surface = on_plane(mesh.nodes[: mesh.n_corners], 1, 0.0)
    points = mesh.nodes[: mesh.n_corners][surface]
    common = {"edge_mm": edge, "nu": nu, "batch": batch}

    def row(engine: str, unknowns: int, force: float, moved: np.ndarray, seconds: float, **more) -> dict:
        return {"engine": engine, **common, "unknowns": unknowns, **more,
                "force_error_percent": round(100.0 * (force / reference.force - 1.0), 3),
                "surface_error_um": round(reference.error_um(points, moved), 2),
                "seconds": round(seconds, 4), "equilibria_per_second": round(batch / seconds, 2)}  # fmt: skip

    sensor = make_sensor(mesh, fixed_symmetric(mesh, (), HEIGHT_MM), top(mesh.nodes, mesh.faces), points)
    scene = Scene(sensor, gel(nu), device=device, batch=batch)
    solve(scene, min(batch, 2))  # loads the kernels
    results, seconds = solve(scene, batch)
    failed = sum(int(result.status[-1] != 0) for result in results)
    force, moved = abs(float(results[0].force[-1, 1])), results[0].displacement[-1] * MM_PER_M
    rows = [row("simgen", scene.unknowns, force, moved, seconds, failed=failed)]
    del scene
    layers = VbdLayers(mesh, nu, batch, device)
    found = settle(layers, surface, asked.limit)
    if found is None:
        rows.append({"engine": "Newton VBD", **common, "unknowns": 3 * len(layers.rest),
                     "result": f"no equilibrium within {asked.limit:g} s"})  # fmt: skip
    else:
        force, moved, seconds, frames = found
        rows.append(row("Newton VBD", 3 * len(layers.rest), force, moved[surface], seconds, frames=frames))
    return rows


def main():
    parser = arguments(__doc__, "peers_gpu.json")
    parser.add_argument("--edges", nargs="+", type=float, default=[0.9], help="mm")
    parser.add_argument("--batches", nargs="+", type=int, default=[1])
    parser.add_argument("--nu", nargs="+", type=float, default=[0.45, 0.499])
    parser.add_argument("--limit", type=float, default=60.0, help="seconds after which VBD gives up")
    asked = parser.parse_args()
    import newton

    rows = []
    for nu in asked.nu:
        reference = Reference(nu, asked.device)
        print(f"nu = {nu:g}: reference force {reference.force:.4f} N", flush=True)
        for edge in asked.edges:
            for batch in asked.batches:
                for each in compare(edge, nu, batch, asked, reference):
                    rows.append(each)
                    print(json.dumps(each), flush=True)
    write(asked, rows, newton=newton.__version__)


if __name__ == "__main__":
    main()
