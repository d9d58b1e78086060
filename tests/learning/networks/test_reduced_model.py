"""The reduced model: it starts as PCA, keeps its latents, and learns what PCA leaves out."""

import numpy as np
import pytest
import safetensors.torch
import torch

from simgen.geometry.tetrahedra import sizing_grid
from simgen.learning.evaluation.pca import PCA
from simgen.learning.networks.mesh_vae import MeshVAE
from simgen.learning.networks.reduced_model import ReducedModel

LATENT = 8
FLOAT = 1e-5  # relative: some hundred roundings of float32, that sums over all coordinates add up


def block() -> tuple[np.ndarray, np.ndarray]:
    return sizing_grid(np.zeros(3), np.array([12e-3, 8e-3, 2e-3]), 1e-3)


def bumps(count: int, seed: int) -> torch.Tensor:
    """(count, vertex, 3) m: dents of one width and many depths anywhere on the block, too narrow for 8 components."""
    points = block()[0]
    rng = np.random.default_rng(seed)
    centres = rng.uniform([0.0, 0.0], [12e-3, 8e-3], (count, 2))
    distance = np.linalg.norm(points[None, :, :2] - centres[:, None], axis=2)
    dent = -np.exp(-((distance / 2e-3) ** 2)) * rng.uniform(1e-4, 1e-3, (count, 1))
    fields = dent[:, :, None] * (points[:, 2:] / 2e-3) * [0.0, 0.0, 1.0]
    return torch.as_tensor(fields, dtype=torch.float32)


@pytest.fixture(scope="module")
def displacement() -> torch.Tensor:
    return bumps(200, seed=0)


@pytest.fixture
def network(displacement) -> ReducedModel:
    torch.manual_seed(0)
    return new(displacement)


def new(displacement: torch.Tensor, latent: int = LATENT) -> ReducedModel:
    vertices, tetrahedra = block()
    rows = torch.arange(len(displacement))
    rest = torch.from_numpy(vertices).float()
    return ReducedModel.of_samples(lambda some: displacement[some], rows, rest, tetrahedra, latent)


def bent(network: ReducedModel) -> ReducedModel:
    """With a correction that is not zero."""
    torch.nn.init.normal_(network.last.weight)
    return network


def root_mean_square(error: torch.Tensor) -> torch.Tensor:
    return error.square().mean().sqrt()


def test_it_starts_as_pca(network, displacement):
    pca = PCA.fit(lambda rows: displacement[rows], torch.arange(len(displacement)), LATENT)
    expected = pca.decode(pca.encode(displacement)).view_as(displacement)
    error = (network(displacement) - expected).abs().max()
    assert error < FLOAT * displacement.abs().max()
    terms = network.terms(displacement)
    samples = (expected - displacement).square().mean(dim=(1, 2)).sqrt()
    assert terms["rmse_m"].item() == pytest.approx(samples.mean().item(), rel=1e-3)  # which the rounding adds to
    torch.testing.assert_close(network.left_out.double(), root_mean_square(expected - displacement).double())


def test_an_error_of_latents_is_one_of_the_mesh(network):
    a, b = torch.randn(2, 5, LATENT)
    of_mesh = (network.coarse(a) - network.coarse(b)).norm(dim=1)
    torch.testing.assert_close(of_mesh, (a - b).norm(dim=1) * network.unit, rtol=1e-4, atol=0.0)


def test_a_decoded_mesh_is_encoded_to_what_it_was_decoded_from(network, displacement):
    latent, log_variance = bent(network).encode(displacement)
    decoded = network.decode(latent)
    assert root_mean_square(decoded - network.coarse(latent).view_as(decoded)) > 0.1 * network.left_out
    torch.testing.assert_close(network.encode(decoded)[0], latent, rtol=0.0, atol=FLOAT * latent.abs().max())
    assert (log_variance == -torch.inf).all()


def test_a_press_half_as_deep_is_corrected_by_about_half(network, displacement):
    """Exactly, but for what the network makes of the logarithm of the size, which is set to nothing here."""
    with torch.no_grad():
        bent(network).first.weight[:, :, -1] = 0.0
    coarse = network.coarse(network.encode(displacement)[0])
    torch.testing.assert_close(network._fine(coarse / 2), network._fine(coarse) / 2, rtol=1e-2, atol=1e-9)


def test_it_learns_what_components_leave_out(network, displacement):
    """Of contacts that it has not seen: the same dents, elsewhere."""
    unseen = bumps(50, seed=1)
    of_pca = network.terms(unseen)["rmse_m"].item()
    optimizer = torch.optim.Adam(network.parameters(), 5e-3)
    for _ in range(30):
        for rows in torch.randperm(len(displacement)).split(25):
            optimizer.zero_grad()
            network.terms(displacement[rows])["loss"].backward()
            optimizer.step()
    assert network.terms(unseen)["rmse_m"].item() < 0.7 * of_pca


def test_a_file_holds_all_of_it(network, displacement, tmp_path):
    safetensors.torch.save_file(bent(network).state_dict(), tmp_path / "network.safetensors")
    loaded = ReducedModel.empty(network.settings())
    loaded.load_state_dict(safetensors.torch.load_file(tmp_path / "network.safetensors"))
    assert torch.equal(loaded(displacement), network(displacement))


def test_fewer_samples_than_latents(displacement):
    few = displacement[:4]
    network = new(few, latent=16)
    assert (network(few) - few).abs().max() < FLOAT * few.abs().max()
    assert network.settings()["latent"] == 16


@pytest.mark.parametrize("vertices", [6198, 4245])
def test_it_is_far_smaller_than_the_papers(vertices):
    sizes = [-(-vertices // 2**level) for level in range(5)]
    paper = MeshVAE(sizes, [0] * 4, [0] * 4)
    assert ReducedModel(vertices, 0).count_parameters() < paper.count_parameters() / 3
