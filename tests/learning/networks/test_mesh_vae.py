"""The mesh VAE: its size, what it learns, and that a file holds all of it."""

import numpy as np
import pytest
import safetensors.torch
import torch

from simgen.geometry.tetrahedra import sizing_grid
from simgen.learning.networks.hierarchy import build_hierarchy
from simgen.learning.networks.mesh_vae import LEAST_DEVIATION, MeshVAE

SAMPLES = 6
BETA = 0.005


@pytest.fixture
def displacement() -> torch.Tensor:
    """Smooth fields on a block whose lowest layer is held, some 0.1 mm large."""
    points = block()[0]
    rng = np.random.default_rng(0)
    waves = np.sin(points @ rng.normal(size=(3, SAMPLES)) * 800.0 + rng.normal(size=SAMPLES))
    fields = 1e-4 * waves.T[:, :, None] * rng.normal(size=(SAMPLES, 1, 3))
    return torch.as_tensor(fields * (points[:, 2] > 0.0)[:, None], dtype=torch.float32)


@pytest.fixture
def network(displacement) -> MeshVAE:
    torch.manual_seed(0)
    return MeshVAE.of_mesh(build_hierarchy(*block()), displacement.mean(0), displacement.std(0), latent=16)


def block() -> tuple[np.ndarray, np.ndarray]:
    return sizing_grid(np.zeros(3), np.array([6e-3, 4e-3, 3e-3]), 1e-3)


def test_parameters_are_those_of_the_paper():
    vertices, coarsest, hidden, latent = 6198, 388, 512, 128
    network = MeshVAE((vertices, 3099, 1550, 775, coarsest), [0] * 4, [0] * 4)
    convolutions = [(3, 16), (16, 16), (16, 16), (16, 32), (32, 32), (32, 16), (16, 16), (16, 16)]
    linear = [(32 * coarsest, hidden), (hidden, latent), (hidden, latent), (latent, hidden), (hidden, 32 * coarsest)]
    expected = sum(6 * a * b + b for a, b in convolutions) + 6 * 16 * 3 + sum(a * b + b for a, b in linear)
    assert network.count_parameters() == expected


def test_shapes_and_units(network, displacement):
    mean, log_variance = network.encode(displacement)
    assert mean.shape == log_variance.shape == (SAMPLES, 16)
    assert network.decode(mean).shape == network(displacement).shape == displacement.shape


def test_loss_is_that_of_the_parts_in_metres(network, displacement):
    """The decoder's metres, normalised again, give the error that the loss took without leaving its own order."""
    network.eval()
    loss, error, divergence = network.terms(displacement, BETA).values()
    normalised = (network(displacement) - displacement) / network.deviation
    mean, log_variance = network.encode(displacement)
    normal = torch.distributions.Normal(0.0, 1.0)
    own = torch.distributions.Normal(mean, torch.exp(0.5 * log_variance))
    torch.testing.assert_close(error, normalised.square().mean(), rtol=1e-4, atol=0.0)  # metres, 1e-4 of them, and back
    torch.testing.assert_close(divergence, torch.distributions.kl_divergence(own, normal).mean())
    torch.testing.assert_close(loss, error + BETA * divergence)


def test_it_learns_a_few_samples(network, displacement):
    optimizer = torch.optim.Adam(network.parameters(), 1e-3)
    for _ in range(200):
        optimizer.zero_grad()
        network.terms(displacement, 0.0)["loss"].backward()
        optimizer.step()
    network.eval()
    without_latents = ((displacement - network.mean) / network.deviation).square().mean()
    assert float(network.terms(displacement, 0.0)["mse"].detach()) < 0.5 * without_latents


def test_evaluation_draws_nothing_and_training_does(network, displacement):
    network.eval()
    assert torch.equal(network(displacement), network(displacement))
    network.train()
    assert not torch.equal(network(displacement), network(displacement))


def test_what_hardly_moves_is_not_blown_up(network, displacement):
    held = displacement.std(0) == 0.0
    assert held.any()
    assert bool((network.deviation[held] == LEAST_DEVIATION).all())
    assert bool((network.deviation[~held] == displacement.std(0)[~held]).all())


def test_an_empty_network_and_a_file_make_the_same_one(tmp_path, network, displacement):
    network.eval()
    safetensors.torch.save_file(network.state_dict(), tmp_path / "network.safetensors")
    again = MeshVAE.empty(network.settings()).eval()
    again.load_state_dict(safetensors.torch.load_file(tmp_path / "network.safetensors"))
    assert torch.equal(again(displacement), network(displacement))
