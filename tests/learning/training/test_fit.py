"""The training loop: it goes on to the same bits, keeps the best epoch, stops in time, and says what went wrong."""

import pytest
import torch
from torch import nn

from simgen.errors import InputError
from simgen.learning.data.schema import Fit, FitByMuon
from simgen.learning.networks.checkpoint import read_state, write_state
from simgen.learning.training import fit
from simgen.learning.training.fit import Training, epoch_seed
from simgen.learning.training.step import tf32_products

SETTINGS = Fit(epochs=8, batch=10, learning_rate=1e-2, patience=100)
BY_MUON = FitByMuon(**SETTINGS.model_dump())


class Regression:
    """y = A x by a small network with dropout: random order and random masks both matter."""

    def __init__(self, device="cpu"):
        torch.manual_seed(5)
        self.inputs = torch.randn(57, 4).to(device)
        self.targets = self.inputs @ torch.randn(4, 3).to(device)
        self.network = nn.Sequential(nn.Linear(4, 16), nn.Tanh(), nn.Dropout(0.2), nn.Linear(16, 3)).to(device)

    def terms(self, rows):
        error = self.network(self.inputs[rows]) - self.targets[rows]
        return {"loss": (error**2).mean(), "worst": error.abs().max()}

    def training(self, state, settings=SETTINGS, seed=1):
        rows = torch.arange(57, device=self.inputs.device)
        return Training("toy", self.network, self.terms, (rows[:45], rows[45:]), settings, seed, state)


@pytest.fixture(autouse=True)
def saved_every_epoch(monkeypatch):
    monkeypatch.setattr(fit, "SAVE_EVERY_S", 0.0)


@pytest.fixture
def settings():
    return SETTINGS


def weights(network):
    return torch.cat([value.flatten() for value in network.state_dict().values()])


@pytest.fixture
def undisturbed(tmp_path, settings):
    toy = Regression()
    training = toy.training(tmp_path / "undisturbed", settings)
    list(training)
    return weights(toy.network), training.progress


@pytest.mark.parametrize("epochs_before, settings", [
    (1, SETTINGS), (4, SETTINGS), (7, SETTINGS), (4, BY_MUON),
])  # fmt: skip
def test_what_goes_on_after_a_stop_ends_with_the_same_bits(tmp_path, undisturbed, epochs_before, settings):
    first = iter(Regression().training(tmp_path / "state", settings))
    for _ in range(epochs_before):
        next(first)
    toy = Regression()
    torch.manual_seed(99)  # another process would have drawn other numbers
    training = toy.training(tmp_path / "state", settings)
    assert len(list(training)) == SETTINGS.epochs - epochs_before
    assert torch.equal(weights(toy.network), undisturbed[0])
    assert [epoch.terms for epoch in training.progress.history] == [epoch.terms for epoch in undisturbed[1].history]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("settings", [SETTINGS, BY_MUON])
def test_a_gpu_draws_the_same_numbers_after_a_stop(tmp_path, settings):
    """Recording a step draws some, in the first epoch of each process."""
    whole, parts = Regression("cuda"), Regression("cuda")
    list(whole.training(tmp_path / "whole", settings))
    next(iter(parts.training(tmp_path / "parts", settings)))
    parts = Regression("cuda")
    list(parts.training(tmp_path / "parts", settings))
    difference = (weights(parts.network) - weights(whole.network)).abs().max()
    assert difference < 1e-4  # eight epochs of rounding; another mask moves a weight by a step, 2e-3 or more


def test_another_seed_ends_elsewhere(tmp_path, undisturbed):
    toy = Regression()
    list(toy.training(tmp_path / "state", seed=2))
    assert not torch.equal(weights(toy.network), undisturbed[0])


def test_it_learns(undisturbed):
    losses = [epoch.terms["validation_loss"] for epoch in undisturbed[1].history]
    assert losses[-1] < 0.5 * losses[0]


def test_the_best_epoch_is_kept_and_patience_ends_it(tmp_path):
    toy = Regression()
    settings = SETTINGS.model_copy(update={"learning_rate": 1.0, "epochs": 60, "patience": 5})  # which diverges soon
    training = toy.training(tmp_path / "state", settings)
    list(training)
    losses = [epoch.terms["validation_loss"] for epoch in training.progress.history]
    assert training.progress.best == losses.index(min(losses)) == len(losses) - 1 - settings.patience
    with torch.no_grad():
        assert float(toy.terms(torch.arange(45, 57))["loss"]) == pytest.approx(min(losses), rel=1e-6)


def test_validation_and_training_are_means_over_samples(tmp_path):
    """With a learning rate that changes nothing the loss of an epoch is that of the network."""
    toy = Regression()
    toy.network.eval()
    with torch.no_grad():
        of_all = float(toy.terms(torch.arange(45, 57))["loss"])
    settings = SETTINGS.model_copy(update={"learning_rate": 1e-12, "epochs": 1})
    (epoch,) = toy.training(tmp_path / "state", settings)
    assert epoch.terms["validation_loss"] == pytest.approx(of_all, rel=1e-5)


def test_validation_multiplies_as_training_does(tmp_path, monkeypatch):
    """A GPU records its steps within `products`."""
    toy, seen = Regression(), []
    training = toy.training(tmp_path / "state", SETTINGS.model_copy(update={"epochs": 1}))
    monkeypatch.setattr(training.step, "products", tf32_products)

    def terms(rows):
        seen.append(torch.get_float32_matmul_precision())
        return toy.terms(rows)

    monkeypatch.setattr(training, "terms", terms)
    list(training)
    assert set(seen) == {"high"} and torch.get_float32_matmul_precision() == "highest"


def test_a_loss_that_is_no_number_is_one_line(tmp_path):
    toy = Regression()
    toy.targets[3] = torch.nan
    with pytest.raises(InputError, match=r"toy: train_loss is nan in epoch 0; a smaller learning_rate"):
        list(toy.training(tmp_path / "state"))


def test_a_state_without_its_moments_is_one_line(tmp_path):
    next(iter(Regression().training(tmp_path / "state")))
    tensors, progress = read_state(tmp_path / "state")
    del tensors["optimizer.adamw.0.exp_avg"]
    write_state(tmp_path / "state", tensors, progress)
    with pytest.raises(InputError, match=r"state: not a state of this training .*exp_avg.*; remove it"):
        Regression().training(tmp_path / "state")


def test_a_state_that_is_none_is_one_line(tmp_path):
    (tmp_path / "state").write_bytes(b"nothing")
    with pytest.raises(InputError, match="state: not a state of `simgen train`"):
        Regression().training(tmp_path / "state")


def test_rates():
    exponential = Fit(learning_rate=1e-3, decay=0.99)
    assert exponential.learning_rate_in(100) == pytest.approx(1e-3 * 0.99**100)
    cosine = Fit(learning_rate=1e-3, schedule="cosine", epochs=10)
    assert cosine.learning_rate_in(0) == 1e-3
    assert cosine.learning_rate_in(5) == pytest.approx(5e-4)


def test_every_epoch_of_every_network_has_a_seed_of_its_own():
    seeds = {epoch_seed(seed, name, epoch) for seed in range(3) for name in ("mvb", "mvd") for epoch in range(-1, 50)}
    assert len(seeds) == 3 * 2 * 51
