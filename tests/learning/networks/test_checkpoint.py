"""A network on disk: one line brings it back, bit for bit; what is no network is one line, too."""

import json

import pytest
import torch

import simgen
from simgen.errors import InputError
from simgen.learning.networks.checkpoint import load_network, read_state, save_network, write_state
from simgen.learning.networks.projection import Projection
from simgen.learning.networks.signal_vae import SignalVAE


@pytest.fixture
def network():
    torch.manual_seed(3)
    return SignalVAE(torch.rand(19), 1.0 + torch.rand(19), widths=(32, 16), latent=4)


@pytest.fixture
def file(network, tmp_path):
    save_network(tmp_path / "network.safetensors", network, {"name": "svb"})
    return tmp_path / "network.safetensors"


def test_one_line_brings_a_network_back(network, file):
    found = simgen.load_network(file)
    assert not found.training
    signals = 1.0 + torch.rand(7, 19)
    with torch.no_grad():
        assert torch.equal(found.encode(signals)[0], network.eval().encode(signals)[0])
        assert torch.equal(found.decode(torch.ones(2, 4)), network.decode(torch.ones(2, 4)))


def test_the_folder_of_a_network_will_do(file):
    assert load_network(file.parent).settings() == load_network(file).settings()


def test_the_sidecar_counts_what_was_trained(network, file):
    about = json.loads(file.with_suffix(".json").read_text())
    layers = [(19, 32), (32, 16), (4, 16), (16, 32)]
    assert about["parameters"] == sum((a + 1) * b for a, b in layers) + 2 * 16 * 4 + 32 * 19
    assert about["name"] == "svb" and about["kind"] == "signal_vae"


def test_every_kind_comes_back(tmp_path):
    projection = Projection(8, 128, (16, 24), (0.1, 0.0))
    save_network(tmp_path / "p.safetensors", projection, {})
    latent = torch.randn(5, 8)
    assert torch.equal(load_network(tmp_path / "p.safetensors")(latent), projection.eval()(latent))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda file: file.unlink(), "network.safetensors: cannot be read: No such file"),
        (lambda file: file.with_suffix(".json").unlink(), "network.json: cannot be read: No such file"),
        (lambda file: file.write_bytes(file.read_bytes()[:-1]), "not the weights that .*network.json describes"),
        (lambda file: file.with_suffix(".json").write_text("{}"), "network.json: not what `simgen train` wrote"),
        (lambda file: file.with_suffix(".json").write_text("[" * 9999), "network.json: not what `simgen train` wrote"),
        (lambda file: replace(file, '"signal_vae"', '"mesh"'), "not a network of this version"),
        (lambda file: replace(file, '"latent": 4', '"latent": 5'), "not a network of this version"),
        (lambda file: replace(file, '"latent": 4', '"latent": "4"'), "not a network of this version"),
    ],
)
def test_what_is_no_network_is_one_line(file, change, complaint):
    change(file)
    with pytest.raises(InputError, match=complaint) as raised:
        load_network(file)
    assert "\n" not in str(raised.value)


def replace(file, old, new):
    sidecar = file.with_suffix(".json")
    text = sidecar.read_text()
    assert old in text
    sidecar.write_text(text.replace(old, new))


def test_a_mesh_without_levels_is_one_line(file):
    about = json.loads(file.with_suffix(".json").read_text())
    about |= {"kind": "mesh_vae", "settings": {"sizes": [], "edges": [], "weights": []}}
    file.with_suffix(".json").write_text(json.dumps(about))
    with pytest.raises(InputError, match="not a network of this version"):
        load_network(file)


def test_a_state_comes_back(tmp_path):
    tensors = {"a.b": torch.randn(3, 2), "step": torch.tensor(7.0), "order": torch.arange(4)}
    write_state(tmp_path / "state", tensors, {"epoch": 3, "loss": [0.1, 0.2]})
    found, about = read_state(tmp_path / "state")
    assert about == {"epoch": 3, "loss": [0.1, 0.2]}
    assert found.keys() == tensors.keys() and all(torch.equal(found[name], tensors[name]) for name in tensors)
