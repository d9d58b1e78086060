"""Layers with spheres in Newton's model, for `peers_gpu`: its VBD solver (Chen et al., ACM Trans. Graph. 43, 2024).

Settings that were needed: velocities are zeroed after each frame, 20 iterations a frame, contact stiffness 3e5 N/m.
"""

import numpy as np
import warp as wp
from pressed_layer import DEPTH_MM, SPHERE_MM

from simgen.units import MM_PER_M
from simgen.verification.validate.layer_reference import HEIGHT_MM, MODULUS_MPA
from simgen.verification.validate.meshes import Mesh, on_plane

FRAME_S, ITERATIONS, CONTACT_STIFFNESS, DENSITY = 1e-2, 20, 3e5, 1000.0  # stiffness in N/m, density in kg/m3
APPROACH_FRAMES = 2


@wp.kernel(enable_backward=False)
def approach_kernel(step: float, end: float, pose_out: wp.array(dtype=wp.transform)):
    i = wp.tid()
    at = wp.transform_get_translation(pose_out[i])
    pose_out[i] = wp.transform(wp.vec3(at[0], wp.min(at[1] + step, end), at[2]), wp.quat_identity())


class VbdLayers:
    """Layers with their spheres in Newton's model: ``batch`` worlds."""

    first_frames = APPROACH_FRAMES

    def __init__(self, mesh: Mesh, nu: float, batch: int, device: str):
        import newton

        self.rest, self.device = mesh.nodes[: mesh.n_corners], device
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
