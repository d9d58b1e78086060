"""Data made of plain arrays: meshes of a few vertices, and the stand-in dataset as tensors."""

import numpy as np
import torch

from simgen.learning.data.samples import MeshSamples

STEP_M = 1e-7


def meshes(steps: np.ndarray, sensor: str = "digit") -> MeshSamples:
    """Displacements (sample, vertex, 3) in steps of 0.1 um, of vertices at the origin."""
    steps = np.asarray(steps, np.int16)
    rest = torch.zeros(steps.shape[1], 3)
    none = np.zeros((0, 3), np.int32)
    return MeshSamples(sensor, rest, none, none, torch.from_numpy(steps.reshape(len(steps), -1)), STEP_M)


def random_meshes(samples: int, vertices: int = 12, directions: int = 5, seed: int = 0) -> MeshSamples:
    """Displacements of some 0.1 mm that a few directions span, but for the rounding and a little noise."""
    random = np.random.default_rng(seed)
    modes = random.normal(size=(directions, vertices * 3))
    values = random.normal(size=(samples, directions)) @ modes * 1e3 + random.normal(size=(samples, vertices * 3)) * 10
    return meshes(np.rint(values).reshape(samples, vertices, 3))
