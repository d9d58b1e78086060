"""The projections: their size by hand, what dropout does, what they minimise."""

import pytest
import torch
from torch import nn

from simgen.learning.data.schema import ProjectionSettings, SignalProjectionSettings
from simgen.learning.networks.projection import Projection


@pytest.mark.parametrize(
    ("settings", "inputs", "layers"),
    [
        (SignalProjectionSettings(), 8, [(8, 512), (512, 128), (128, 256), (256, 256), (256, 128)]),
        (ProjectionSettings(), 128, [(128, 512), (512, 1024), (1024, 1024), (1024, 256), (256, 128)]),
    ],
)
def test_parameters_are_those_of_the_paper(settings, inputs, layers):
    """Four hidden layers of the widths that the paper states, and one more into the 128 latents."""
    network = Projection(inputs, 128, settings.widths, settings.dropout)
    assert network.count_parameters() == sum((a + 1) * b for a, b in layers)
    assert [layer.p for layer in network.layers if isinstance(layer, nn.Dropout)] == list(settings.dropout)


def test_it_is_what_its_layers_make_of_the_input():
    network = Projection(3, 2, (5, 4), (0.5, 0.5)).eval()
    first, second, last = (layer for layer in network.layers if isinstance(layer, nn.Linear))
    x = hidden = torch.randn(7, 3)
    for layer in (first, second):
        hidden = hidden @ layer.weight.T + layer.bias
        hidden = torch.where(hidden > 0.0, hidden, torch.expm1(hidden))  # ELU
    torch.testing.assert_close(network(x), hidden @ last.weight.T + last.bias)


def test_the_loss_is_the_mean_square_in_the_latent_space():
    network = Projection(3, 2, (4,), (0.0,)).eval()
    source, target = torch.randn(7, 3), torch.randn(7, 2)
    expected = ((network(source) - target) ** 2).sum() / 14
    torch.testing.assert_close(network.terms(source, target)["loss"], expected)


def test_dropout_is_of_training_alone():
    network, x = Projection(3, 2, (64,), (0.5,)), torch.randn(7, 3)
    assert not torch.equal(network(x), network(x))
    assert torch.equal(network.eval()(x), network(x))


def test_settings_make_the_same_shapes():
    network = Projection(3, 2, (5, 4), (0.5, 0.1))
    again = Projection.empty(network.settings())
    again.load_state_dict(network.state_dict())
    assert again.settings() == network.settings()
    x = torch.randn(7, 3)
    assert torch.equal(again.eval()(x), network.eval()(x))
