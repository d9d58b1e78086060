"""The translation: what it minimises, that it learns, and that a file holds all of it."""

import safetensors.torch
import torch

from simgen.training.translation import LEAST, Translation


def curve(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Inputs (count, 6) on a surface with two parameters, and outputs (count, 4) that bend with these."""
    a, b = torch.rand(2, count) * 2.0
    source = torch.stack([a.sin(), a.cos(), b.sin(), b.cos(), a * b, a - b], dim=1)
    return 3.0 + 0.01 * source, torch.stack([(2 * a).sin(), (a + b).cos(), a * b, b**2], dim=1)


def new(source: torch.Tensor, target: torch.Tensor, noise: float) -> Translation:
    return Translation.of_samples(source, target, width=64, noise=noise)


def test_the_loss_is_the_norm_of_the_error():
    torch.manual_seed(0)
    source, target = curve(20)
    network = new(source, target, noise=0.1).eval()
    expected = (network(source) - target).norm(dim=1).mean()
    torch.testing.assert_close(network.terms(source, target)["loss"], expected, rtol=1e-5, atol=LEAST)


def test_it_bends_where_a_linear_map_cannot():
    torch.manual_seed(0)
    source, target = curve(400)
    unseen, wanted = curve(100)
    with_one = torch.cat([source, torch.ones(len(source), 1)], dim=1).double()
    linear = torch.linalg.lstsq(with_one, target.double()).solution
    of_linear = (torch.cat([unseen, torch.ones(len(unseen), 1)], dim=1).double() @ linear - wanted).norm(dim=1).mean()
    network = new(source, target, noise=0.0)
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    rates = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 300)  # or the last step decides, and that is chance
    for _ in range(300):
        optimizer.zero_grad()
        network.terms(source, target)["loss"].backward()
        optimizer.step()
        rates.step()
    assert network.eval().terms(unseen, wanted)["loss"] < 0.5 * of_linear


def test_noise_is_of_training_alone():
    source, target = curve(5)
    network = new(source, target, noise=0.5)
    assert not torch.equal(network(source), network(source))
    assert torch.equal(network.eval()(source), network(source))


def test_inputs_keep_their_proportions():
    """One deviation for all: a small input stays small."""
    torch.manual_seed(0)
    source = torch.randn(1000, 2) * torch.tensor([1.0, 0.01])
    network = Translation.of_samples(source, source)
    scaled = (source - network.mean) / network.deviation
    torch.testing.assert_close(scaled.square().mean(), torch.tensor(1.0))
    torch.testing.assert_close(scaled.std(dim=0)[1] / scaled.std(dim=0)[0], source[:, 1].std() / source[:, 0].std())


def test_inputs_that_never_change():
    source = torch.full((4, 3), 0.5)
    assert torch.isfinite(Translation.of_samples(source, source)(source)).all()


def test_a_file_holds_all_of_it(tmp_path):
    source, target = curve(5)
    network = new(source, target, noise=0.2).eval()
    safetensors.torch.save_file(network.state_dict(), tmp_path / "network.safetensors")
    loaded = Translation.empty(network.settings()).eval()
    loaded.load_state_dict(safetensors.torch.load_file(tmp_path / "network.safetensors"))
    assert loaded.settings() == network.settings()
    assert torch.equal(loaded(source), network(source))
