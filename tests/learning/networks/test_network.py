"""Requirements on every network of the table: weights from the seed, a loss first, all state in one file."""

import pytest
import torch

from simgen.learning.data.registry import NETWORKS
from simgen.learning.networks.network import Network, network_class, network_kinds
from simgen.learning.networks.network_data import NetworkData


@pytest.fixture(scope="module", params=NETWORKS)
def made(request, trained):
    """A network before training, its terms, and its data."""
    spec = NETWORKS[request.param]
    data = NetworkData(spec, trained.inputs)
    torch.manual_seed(1)
    return *network_class(spec).for_training(data), data


def test_the_seed_decides_the_weights(request, made, trained):
    network, _, data = made
    states = [network.state_dict()]
    for seed in (1, 2):
        torch.manual_seed(seed)
        states.append(type(network).for_training(data)[0].state_dict())
    first, same, other = (
        torch.cat([value.flatten().double() for value in state.values()]).nan_to_num()  # what training has yet to find
        for state in states
    )
    assert torch.equal(first, same) and not torch.equal(first, other)


def test_the_loss_comes_first_and_has_gradients(made):
    network, terms, data = made
    found = terms(data.train[:4])
    assert next(iter(found)) == "loss" and all(value.shape == () for value in found.values())
    found["loss"].backward()
    assert any(parameter.grad.abs().sum() > 0.0 for parameter in network.parameters() if parameter.grad is not None)


def test_it_predicts_outputs_from_inputs(made):
    network, _, data = made
    rows = data.validation[:3]
    with torch.no_grad():
        assert network.eval()(data.inputs(rows)).shape == data.outputs(rows).shape


def test_a_state_and_settings_are_all_of_it(made):
    network, _, data = made
    again = type(network).empty(network.settings())
    again.load_state_dict(network.state_dict())
    rows = data.validation[:3]
    with torch.no_grad():
        assert torch.equal(again.eval()(data.inputs(rows)), network.eval()(data.inputs(rows)))
    assert again.settings() == network.settings() and again.count_parameters() == network.count_parameters()


def test_only_some_networks_round_products():
    """Mesh VAEs draw their latents, and the point translator learns its features in bfloat16."""
    assert {name for name, spec in NETWORKS.items() if network_class(spec).tf32} == {"mvb", "mvd", "pt"}


def test_each_kind_is_a_class_of_its_own():
    classes = {network_class(spec) for spec in NETWORKS.values()}
    assert set(network_kinds().values()) == classes and all(issubclass(each, Network) for each in classes)
