"""SVB: its size by hand, its range of signals, its loss from its parts, and that it learns."""

import pytest
import torch

from simgen.learning.data.schema import SignalVAESettings
from simgen.learning.networks.signal_vae import SignalVAE
from simgen.learning.networks.variational import divergence

LOW, HIGH = torch.tensor([1.0, -2.0, 0.5]), torch.tensor([3.0, 2.0, 0.5])  # the last channel never varies


@pytest.fixture
def network() -> SignalVAE:
    torch.manual_seed(0)
    return SignalVAE(LOW, HIGH, widths=(16, 8), latent=2)


def signals(count: int) -> torch.Tensor:
    """(count, 3) within the range, on a line."""
    return LOW + torch.rand(count, 1) * (HIGH - LOW)


def test_parameters_are_those_of_the_paper():
    """19 -> 256, 128, 64 -> 8 and back; no bias where a layer is the last."""
    settings = SignalVAESettings()
    network = SignalVAE(torch.zeros(19), torch.ones(19), settings.widths, settings.latent)
    with_bias = [(19, 256), (256, 128), (128, 64), (8, 64), (64, 128), (128, 256)]
    without = [(64, 8), (64, 8), (256, 19)]
    assert network.count_parameters() == sum((a + 1) * b for a, b in with_bias) + sum(a * b for a, b in without)


def test_the_range_of_training_is_minus_one_to_one(network):
    found = network.normalised(torch.stack([LOW, HIGH, (LOW + HIGH) / 2]))
    torch.testing.assert_close(found, torch.tensor([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]]))


def test_a_signal_outside_of_it_is_not_cut_off(network):
    assert network.normalised(torch.tensor([[5.0, 4.0, 0.7]]))[0].tolist() == [3.0, 2.0, 0.0]


def test_measured_is_the_inverse(network):
    some = signals(20)
    torch.testing.assert_close(network.measured(network.normalised(some)), some)
    assert (network.measured(torch.randn(4, 3))[:, 2] == 0.5).all()


def test_the_loss_is_that_of_its_parts(network):
    network.eval()
    some, beta = signals(20), 0.3
    mean, log_variance = network.encode(some)
    error = network.normalised(network.decode(mean)) - network.normalised(some)
    found = network.terms(some, beta)
    varying = error[:, :2].square().sum() / error.numel()  # `decode` gives a channel that never varies exactly
    constant = network.decoder(mean)[:, 2].square().sum() / error.numel()
    torch.testing.assert_close(found["mse"], varying + constant)
    torch.testing.assert_close(found["kl"], divergence(mean, log_variance))
    torch.testing.assert_close(found["loss"], found["mse"] + beta * found["kl"])
    assert next(iter(found)) == "loss"  # which is minimised


def test_latents_are_drawn_in_training_alone(network):
    some = signals(20)
    assert network.train().terms(some, 0.0)["mse"] != network.terms(some, 0.0)["mse"]
    assert network.eval().terms(some, 0.0)["mse"] == network.terms(some, 0.0)["mse"]


def test_it_learns_a_line(network):
    optimizer = torch.optim.Adam(network.parameters(), 1e-2)
    for _ in range(200):
        optimizer.zero_grad()
        network.terms(signals(64), 1e-4)["loss"].backward()
        optimizer.step()
    unseen = signals(50)
    variance = network.normalised(unseen).var(dim=0).mean()
    assert network.eval().terms(unseen, 0.0)["mse"] < 0.1 * variance  # a tenth of what a mean alone leaves


def test_settings_make_the_same_shapes(network):
    again = SignalVAE.empty(network.settings())
    again.load_state_dict(network.state_dict())
    some = signals(5)
    assert torch.equal(again.eval().encode(some)[0], network.eval().encode(some)[0])
