"""The point translator: mirror images, any points, its loss, and that it learns."""

import pytest
import torch
import torch.nn.functional as F

from simgen.learning.training.network_data import NetworkData
from simgen.learning.training.networks import NETWORKS
from simgen.learning.training.point_translator import LEAST_SIZE, NEAR, ROUNDING, TOUCH, PointTranslator


@pytest.fixture
def made(trained):
    """A network whose outputs are not small, and its data."""
    torch.manual_seed(0)
    data = NetworkData(NETWORKS["pt"], trained.inputs)
    network, terms = PointTranslator.for_training(data)
    return network, terms, data


@torch.no_grad()
def test_any_points_are_translated(made):
    """The vertices in another order, and points between them."""
    network, _, data = made
    u, rest = data.inputs(data.train[:3]), network.target_rest.numpy()
    order = torch.randperm(len(rest), generator=torch.Generator().manual_seed(1))
    found, logits = network.at(u, network.places(rest[order.numpy()]))
    assert logits.shape == found.shape[:2]
    torch.testing.assert_close(found, network(u)[:, order], rtol=1e-4, atol=1e-9)
    between = network.at(u, network.places(0.5 * (rest[:5] + rest[1:6])))[0]
    assert between.shape == (3, 5, 3) and between.isfinite().all()


@torch.no_grad()
def test_a_prediction_is_the_mean_of_both_mirror_images(made):
    network, _, data = made
    u = data.inputs(data.train[:4])
    places = network.place, network.offset, network.frames
    ways = [network._one_way(u, places, torch.full((4,), sign))[0] for sign in (1.0, -1.0)]
    torch.testing.assert_close(network(u), 0.5 * (ways[0] + ways[1]))
    assert not torch.allclose(ways[0], ways[1], rtol=1e-2, atol=0.0)
    mixed = network._one_way(u, places, torch.tensor([1.0, -1.0, 1.0, -1.0]))[0]
    torch.testing.assert_close(mixed, torch.stack([ways[0][0], ways[1][1], ways[0][2], ways[1][3]]))


@torch.no_grad()
def test_the_loss_weighs_root_mean_squares(made):
    network, _, data = made
    network.eval()
    network.power = 0.0
    source, target = data.inputs(data.train[:5]), data.outputs(data.train[:5])
    found = network._one_way(source, (network.place, network.offset, network.frames), torch.ones(5))[0]
    error = (found - target).square().mean(dim=(1, 2)).add(ROUNDING**2).sqrt()
    terms = network.terms(source, target)
    torch.testing.assert_close(terms["rmse_m"], error.mean())
    torch.testing.assert_close(terms["loss"], error.mean() / network.target_size)
    touching = torch.zeros(target.shape[:2], dtype=torch.bool)
    touching[:, :20] = True
    logits = network._one_way(source, (network.place, network.offset, network.frames), torch.ones(5))[1]
    near = (found - target)[:, :20].square().mean(dim=(1, 2)).add(ROUNDING**2).sqrt().mean() / network.target_size
    wrong = F.softplus(torch.where(touching, -logits, logits)).mean()  # the cross entropy
    torch.testing.assert_close(
        network.terms(source, target, touching)["loss"], terms["loss"] + NEAR * near + TOUCH * wrong
    )


@torch.no_grad()
def test_errors_count_in_proportion_to_the_press(made):
    network, _, data = made
    network.eval()
    network.power = 1.0
    source, target = data.inputs(data.train[:5]), data.outputs(data.train[:5])
    size = target.square().mean(dim=(1, 2)).sqrt()
    error = network._one_way(source, (network.place, network.offset, network.frames), torch.ones(5))[0] - target
    relative = error.square().mean(dim=(1, 2)).add(ROUNDING**2).sqrt() / size.clamp_min(
        LEAST_SIZE * network.target_size
    )
    torch.testing.assert_close(network.terms(source, target)["loss"], relative.mean())


def test_sizes_are_root_mean_squares_of_training(made):
    network, _, data = made
    with torch.no_grad():
        target = data.outputs(data.train).square().mean().sqrt()
        known = network.weights.sum(dim=1) > 0.5
        skin = network.skin(data.inputs(data.train))[:, known].square().mean().sqrt()
    torch.testing.assert_close(network.target_size, target, rtol=1e-4, atol=0.0)
    torch.testing.assert_close(network.source_size, skin, rtol=1e-4, atol=0.0)


def test_it_learns(made):
    network, terms, data = made
    network.train()
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    first = terms(data.train)["rmse_m"].item()
    for _ in range(40):
        optimizer.zero_grad()
        terms(data.train)["loss"].backward()
        optimizer.step()
    assert network.eval() and terms(data.train)["rmse_m"].item() < 0.5 * first
