"""Kernels against the same sums by torch. Without a GPU, Triton's interpreter runs them, in float32.

Without Triton they are skipped.
"""

import os

import numpy as np
import pytest
import scipy.sparse
import torch

if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # before Triton is imported
kernels = pytest.importorskip("simgen.learning.networks.tf32_kernels", exc_type=ImportError)

from simgen.geometry.tetrahedra import sizing_grid  # noqa: E402
from simgen.learning.networks import chebyshev, sparse  # noqa: E402
from simgen.learning.networks.hierarchy import build_hierarchy  # noqa: E402
from simgen.learning.networks.mesh_vae import MeshVAE  # noqa: E402
from simgen.learning.networks.sparse_blocks import tf32  # noqa: E402

DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")
TOLERANCE = 1e-3 if torch.cuda.is_available() else 2e-6  # relative to the largest value
COUNT = 6


def random(*shape: int) -> torch.Tensor:
    """Normal numbers that TF32 holds."""
    return torch.from_numpy(tf32(np.random.default_rng(sum(shape)).normal(size=shape))).to(DEVICE)


def assert_near(found: torch.Tensor, expected: torch.Tensor) -> None:
    assert found.shape == expected.shape
    assert float((found - expected).abs().max()) <= TOLERANCE * float(expected.abs().max())


@pytest.fixture
def plain(monkeypatch):
    """Let `chebyshev` do without the kernels, on a GPU too."""
    monkeypatch.setattr(chebyshev, "tf32_kernels", lambda x: None)


@pytest.mark.parametrize("shape", [(70, 50), (40, 90)])
@pytest.mark.parametrize("samples", [5, 300])
@pytest.mark.parametrize("add", [False, True])
def test_a_product_writes_rows_of_a_larger_tensor(shape, samples, add):
    rng = np.random.default_rng(0)
    matrix = scipy.sparse.random_array(shape, density=0.1, rng=rng, format="csr", dtype=np.float32)
    matrix.data = tf32(matrix.data)
    module = sparse.SparseMatrix(*shape, matrix.nnz).to(DEVICE)
    module.fill(matrix)
    dense = random(shape[1], 2, samples)[:, 1]
    before = torch.full((shape[0], 3, samples), 1.0 if add else torch.nan, device=DEVICE)
    whole = before.clone()
    kernels.multiply_blocks(module.blocks, shape[0], dense, whole[:, 1], add)
    assert_near(whole[:, 1], torch.from_numpy(matrix.toarray()).to(DEVICE) @ dense + float(add))
    torch.testing.assert_close(whole[:, ::2], before[:, ::2], rtol=0, atol=0, equal_nan=True)


@pytest.mark.parametrize("widths", [(3, 16), (16, 16), (16, 32), (32, 48)])
@pytest.mark.parametrize("samples", [7, 130])
@pytest.mark.parametrize("activation", [(False, False), (True, True)])
def test_a_filter_is_a_sum_of_products(plain, widths, samples, activation):
    x, powers = random(9, widths[0], samples), random(9, COUNT - 1, widths[0], samples)
    weight = random(COUNT, widths[0], widths[1]).transpose(1, 2)  # not contiguous, as in the backward pass
    bias = random(widths[1]) if activation[0] else None
    found = kernels.filtered(x, powers, weight, 5, bias, activation[1])
    assert_near(found, chebyshev.filtered(x, powers, weight, 5, bias, activation[1]))


def test_a_filter_rounds_to_the_nearest_value_of_tf32(plain):
    rng = np.random.default_rng(0)
    shapes = (9, 16, 7), (9, COUNT - 1, 16, 7), (COUNT, 16, 16)
    values = [rng.normal(size=shape).astype(np.float32) for shape in shapes]
    x, powers, weight = (torch.from_numpy(each).to(DEVICE) for each in values)
    rounded = (torch.from_numpy(tf32(each)).to(DEVICE) for each in values)
    assert_near(kernels.filtered(x, powers, weight, 5), chebyshev.filtered(*rounded, 5))


def test_a_filter_without_powers_is_one_product():
    x, weight = random(9, 16, 7), random(1, 40, 16)
    assert_near(kernels.filtered(x, x.new_empty(9, 0, 16, 7), weight, 9), weight[0] @ x)


@pytest.mark.parametrize("widths", [(3, 16), (16, 16), (32, 20)])
@pytest.mark.parametrize("samples", [7, 100])
def test_correlations_are_sums_over_vertices_and_samples(plain, monkeypatch, widths, samples):
    monkeypatch.setattr(kernels, "PARTS", 4)
    x, powers = random(9, widths[0], samples), random(9, COUNT - 1, widths[0], samples)
    for rows in (9, 5):
        other = random(rows, widths[1], samples)
        products, sums = kernels.correlated(x[:rows], powers[:rows], other)
        expected = chebyshev.correlated(x[:rows], powers[:rows], other)
        assert_near(products, expected[0])
        assert_near(sums, expected[1])


def test_values_are_rounded_to_the_nearest():
    values = np.random.default_rng(0).normal(size=(40, 7))
    identity = sparse.SparseMatrix(40, 40, 40).to(DEVICE)
    identity.fill(scipy.sparse.eye_array(40, format="csr"))
    out = torch.empty(40, 7, device=DEVICE)
    kernels.multiply_blocks(identity.blocks, 40, torch.from_numpy(values.astype(np.float32)).to(DEVICE), out)
    np.testing.assert_array_equal(out.cpu(), tf32(values))


def test_a_network_has_the_same_loss_and_gradients(monkeypatch):
    monkeypatch.setattr(kernels, "PARTS", 4)
    if DEVICE.type == "cpu":
        monkeypatch.setattr(kernels, "_rounded", lambda x: x)
    points, tetrahedra = sizing_grid(np.zeros(3), np.array([5e-3, 3e-3, 2e-3]), 1e-3)
    torch.manual_seed(0)
    shape = (len(points), 3)
    network = MeshVAE.of_mesh(build_hierarchy(points, tetrahedra), np.zeros(shape), np.ones(shape), latent=16)
    network.to(DEVICE).eval()
    for matrix in (*network.laplacians, *network.up, *network.up_transposed):
        matrix.values.copy_(torch.from_numpy(tf32(matrix.values.cpu().numpy())))
    found = []
    for own in (None, kernels):
        for module in (sparse, chebyshev):
            monkeypatch.setattr(module, "tf32_kernels", lambda x, own=own: own)
        network.zero_grad()
        loss = network.terms(random(5, *shape), 0.005)["loss"]
        loss.backward()
        found.append([loss.detach(), *(each.grad.clone() for each in network.parameters())])
    for theirs, ours in zip(*found, strict=True):
        # Powers of L amplify rounding by up to 41 (sum of |coefficients| of T_5).
        assert float((ours - theirs).abs().max()) <= 41 * TOLERANCE * float(theirs.abs().max())
