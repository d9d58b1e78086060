"""Layers with spheres in libuipc, for `peers_gpu`; see Li et al., incremental potential contact, SIGGRAPH 2020.

All layers lie side by side in one scene. The sphere is a stiff affine body that a strong constraint moves. Its radius
is less by the distance that contacts keep. Settings that were needed: contacts within 10 um with a resistance of 3e12
Pa, Newton's method to 0.1 um, linear systems to 1e-4.

libuipc documents its law as the stable neo-Hookean one of Smith et al. (ACM Trans. Graph. 37, 2018), whose energy has a
term with log(I + 1). Its own conversion of moduli suits that law. Inner forces of its results do not balance by that
law, but do without the term (``imbalance_percent``). So its moduli are set here for the law without the term.
"""

import tempfile

import numpy as np
from pressed_layer import DEPTH_MM, SPHERE_MM

from simgen.units import MM_PER_M
from simgen.verification.validate.layer_reference import HEIGHT_MM, MODULUS_MPA
from simgen.verification.validate.meshes import Mesh, on_plane

FRAME_S, DENSITY, APPROACH_FRAMES = 1e-2, 1000.0, 10
SPACING_M = 25e-3  # between the axes of layers
CONTACT_M, RESISTANCE = 1e-5, 3e12  # distance, and stiffness in Pa
NEWTON_M, NEWTON_MOST, LINEAR = 1e-7, 200, 1e-4  # tolerance and most iterations of Newton; of linear systems
FINENESS = 4  # subdivisions of an icosahedron, which is the sphere
STIFFNESS, SPHERE_DENSITY, STRENGTH = 1e8, 1e7, 1e4  # of the sphere in Pa and kg/m3, and of what moves it


def settings() -> dict:
    """Settings of libuipc that differ from its defaults."""
    return {
        "dt": FRAME_S,
        "gravity": [[0.0], [0.0], [0.0]],
        "contact": {"d_hat": CONTACT_M, "friction": {"enable": 0}},
        "newton": {
            "velocity_tol": NEWTON_M / FRAME_S, "transrate_tol": 10.0, "max_iter": NEWTON_MOST,
            "semi_implicit": {"enable": 0},
        },
        "linear_system": {"tol_rate": LINEAR},
        "line_search": {"max_iter": 16},
        "sanity_check": {"enable": 0},
    }  # fmt: skip


def merged(config: dict, changes: dict) -> dict:
    """Replace values of nested dictionaries. Raises KeyError for a key that ``config`` lacks."""
    for key, value in changes.items():
        config[key] = merged(config[key], value) if isinstance(value, dict) else type(config[key])(value)
    return config


class LibuipcLayers:
    """Layers with their spheres in one scene of libuipc: ``batch`` of them. The device is the first GPU."""

    first_frames = APPROACH_FRAMES

    def __init__(self, mesh: Mesh, nu: float, batch: int, device: str):
        from uipc import Engine, Logger, Scene, World, builtin, view
        from uipc.constitution import ElasticModuli, StableNeoHookean
        from uipc.geometry import label_surface, tetmesh

        Logger.set_level(Logger.Level.Error)
        self._view, self.rest, self._tetrahedra = view, mesh.nodes[: mesh.n_corners], mesh.tetrahedra[:, :4]
        self._fixed = on_plane(self.rest, 1, HEIGHT_MM)
        side = int(np.ceil(np.sqrt(batch)))
        self._origins = SPACING_M * np.array([[i % side, 0.0, i // side] for i in range(batch)])
        scene = Scene(merged(Scene.default_config(), settings()))
        scene.contact_tabular().default_model(0.0, RESISTANCE)
        corners = (self.rest / MM_PER_M + self._origins[:, None]).reshape(-1, 3)
        numbers = self._tetrahedra + len(self.rest) * np.arange(batch)[:, None, None]
        gel = tetmesh(corners, numbers.reshape(-1, 4).astype(np.int32))
        label_surface(gel)
        StableNeoHookean().apply_to(gel, ElasticModuli.youngs_poisson(1e6 * MODULUS_MPA, nu), DENSITY)
        mu, lame = 0.5e6 * MODULUS_MPA / (1.0 + nu), 1e6 * MODULUS_MPA * nu / (1.0 + nu) / (1.0 - 2.0 * nu)
        self._moduli = mu, lame + mu
        for name, value in zip(("mu", "lambda"), self._moduli, strict=True):
            view(gel.tetrahedra().find(name))[:] = value
        view(gel.vertices().find(builtin.is_fixed))[:] = np.tile(self._fixed, batch).astype(np.int32)
        self._gel, _ = scene.objects().create("gel").geometries().create(gel)
        self._height, self._frame = -SPHERE_MM / MM_PER_M, 0
        self._add_spheres(scene)
        self._folder = tempfile.TemporaryDirectory()
        self._engine = Engine("cuda" if device.startswith("cuda") else "none", self._folder.name)
        self._world = World(self._engine)
        self._world.init(scene)
        if not self._world.is_valid():
            raise RuntimeError("libuipc refuses the scene")

    def _add_spheres(self, scene):
        """Add a sphere below each layer. An animation moves it to ``_height``."""
        import trimesh
        from uipc import builtin
        from uipc.constitution import AffineBodyConstitution, SoftTransformConstraint
        from uipc.geometry import label_surface
        from uipc.geometry import trimesh as surface_mesh

        view = self._view
        ball = trimesh.creation.icosphere(FINENESS)
        outside = np.linalg.norm(ball.triangles_center, axis=1).mean()
        mean = (2.0 * outside + 1.0) / 3.0  # distance of the facets' points, on average, if vertices are at 1
        corners = ball.vertices * (SPHERE_MM / MM_PER_M - CONTACT_M) / mean
        sphere = surface_mesh(corners, ball.faces.astype(np.int32))
        label_surface(sphere)
        AffineBodyConstitution().apply_to(sphere, STIFFNESS, SPHERE_DENSITY)
        SoftTransformConstraint().apply_to(sphere, np.array([STRENGTH, STRENGTH]))
        sphere.instances().resize(len(self._origins))
        view(sphere.transforms())[:] = self._poses()
        body = scene.objects().create("sphere")
        body.geometries().create(sphere)

        def move(info):
            moved = info.geo_slots()[0].geometry()
            view(moved.instances().find(builtin.is_constrained))[:] = 1
            view(moved.instances().find(builtin.aim_transform))[:] = self._poses()

        scene.animator().insert(body, move)

    def _poses(self) -> np.ndarray:
        poses = np.tile(np.eye(4), (len(self._origins), 1, 1))
        poses[:, :3, 3] = self._origins
        poses[:, 1, 3] = self._height
        return poses

    def advance(self, frames: int):
        """Advance by some frames. The first ones push the sphere in."""
        for _ in range(frames):
            self._frame += 1
            depth = DEPTH_MM / MM_PER_M * min(1.0, self._frame / APPROACH_FRAMES)
            self._height = depth - SPHERE_MM / MM_PER_M
            self._world.advance()
        self._world.sync()

    def measure(self) -> tuple[float, np.ndarray]:
        """Force (N) on the fixed nodes of the first layer, and displacements (corners, 3) mm of this layer."""
        at = self._positions()
        force = self._nodal_forces(at, logarithm=False)[self._fixed, 1].sum()
        return float(np.abs(force)), at * MM_PER_M - self.rest

    def imbalance_percent(self) -> dict[str, float]:
        """Norm of the forces on inner nodes over the force of the indenter, by both laws."""
        at, inner = self._positions(), ~self._fixed & ~on_plane(self.rest, 1, 0.0)
        found = {}
        for name, logarithm in (("without the logarithm", False), ("with it", True)):
            forces = self._nodal_forces(at, logarithm)
            found[name] = round(100.0 * np.linalg.norm(forces[inner]) / abs(forces[self._fixed, 1].sum()), 3)
        return found

    def _positions(self) -> np.ndarray:
        """Positions (corners, 3) m of the first layer."""
        self._world.retrieve()
        return self._view(self._gel.geometry().positions())[: len(self.rest)].reshape(-1, 3).copy()

    def _nodal_forces(self, at: np.ndarray, logarithm: bool) -> np.ndarray:
        """Internal forces (corners, 3) N at corners (corners, 3) m.

        The energy is mu/2 (I - 3) + lambda/2 (J - 1 - mu / lambda)^2, or with the logarithm
        mu/2 (I - 3 - log(I + 1)) + lambda/2 (J - 1 - 3 mu / (4 lambda))^2.
        """
        mu, lame = self._moduli
        rest = self.rest[self._tetrahedra] / MM_PER_M
        edges, moved = (np.moveaxis(p[:, 1:] - p[:, :1], 1, 2) for p in (rest, at[self._tetrahedra]))
        gradient = moved @ np.linalg.inv(edges)
        volume, jacobian = np.linalg.det(edges) / 6.0, np.linalg.det(gradient)
        cofactor = jacobian[:, None, None] * np.linalg.inv(gradient).transpose(0, 2, 1)
        share = 1.0 / ((gradient**2).sum(axis=(1, 2)) + 1.0) if logarithm else np.zeros(len(volume))
        pressure = lame * (jacobian - 1.0) - (0.75 if logarithm else 1.0) * mu
        stress = (mu * (1.0 - share))[:, None, None] * gradient + pressure[:, None, None] * cofactor
        of_others = volume[:, None, None] * stress @ np.linalg.inv(edges).transpose(0, 2, 1)  # (t, 3, corner)
        forces = np.zeros_like(at)
        for corner in range(3):
            np.add.at(forces, self._tetrahedra[:, corner + 1], of_others[..., corner])
            np.add.at(forces, self._tetrahedra[:, 0], -of_others[..., corner])
        return forces
