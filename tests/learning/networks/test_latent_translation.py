"""The translation: what it minimises, that it learns, and that a file holds all of it."""

import safetensors.torch
import torch

from simgen.learning.networks.latent_translation import LEAST, LEAST_SIZE, LatentTranslation
from simgen.sensing.electrodes.model import ElectrodeSettings, voltage


def curve(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Inputs (count, 6) on a surface with two parameters, and outputs (count, 4) that bend with these."""
    a, b = torch.rand(2, count) * 2.0
    source = torch.stack([a.sin(), a.cos(), b.sin(), b.cos(), a * b, a - b], dim=1)
    return 3.0 + 0.01 * source, torch.stack([(2 * a).sin(), (a + b).cos(), a * b, b**2], dim=1)


def new(source: torch.Tensor, target: torch.Tensor, noise: float = 0.0, power: float = 0.5) -> LatentTranslation:
    at_rest = source.mean(dim=0), target.mean(dim=0)
    return LatentTranslation.of_samples(source, target, *at_rest, width=64, blocks=2, noise=noise, power=power)


def test_the_loss_is_the_norm_of_the_error():
    torch.manual_seed(0)
    source, target = curve(20)
    network = new(source, target, noise=0.1, power=0.0).eval()
    expected = (network(source) - target).norm(dim=1).mean()
    for term in network.terms(source, target).values():
        torch.testing.assert_close(term, expected, rtol=1e-5, atol=LEAST)


def test_errors_count_in_proportion_to_the_press():
    """The power of 1: a relative error is the same however far from rest. Below a hundredth of all it is not."""
    torch.manual_seed(0)
    source, target = curve(20)
    network = new(source, target, power=1.0).eval()
    size = (target - target.mean(dim=0)).norm(dim=1)
    relative = (network(source) - target).norm(dim=1) / size * size.square().mean().sqrt()
    found = network.terms(source, target)
    torch.testing.assert_close(found["loss"], relative.mean(), rtol=1e-4, atol=0.0)
    assert found["error"] != found["loss"]
    at_rest = network.terms(source[:1], network.target_rest[None])
    torch.testing.assert_close(at_rest["loss"], at_rest["error"] / LEAST_SIZE)


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


def test_noise_is_in_proportion_to_the_press():
    torch.manual_seed(0)
    source, target = curve(200)
    network = new(source, target, noise=0.1)
    network.first.weight.data[:, -1] = 0.0  # which knows the size
    spread, away = [], source - network.source_rest
    farthest = away[away.norm(dim=1).argmax()]  # far beyond LEAST_SIZE
    for share in (0.1, 1.0):
        near = network.source_rest + share * farthest
        spread.append(network(near.expand(2000, -1)).std(dim=0).norm())
    torch.testing.assert_close(spread[0] / spread[1], torch.tensor(0.1), rtol=0.05, atol=0.0)  # of 2000 samples


def test_what_is_linear_is_so_by_construction():
    """Without the size as an input, a press half as deep is half the field."""
    torch.manual_seed(0)
    source, target = curve(50)
    network = new(source, target).eval()
    network.first.weight.data[:, -1] = 0.0
    far = (source - network.source_rest).square().mean(dim=1).sqrt() / network.source_size > 0.5
    half = network(network.source_rest + 0.5 * (source[far] - network.source_rest)) - network.target_rest
    whole = network(source[far]) - network.target_rest
    torch.testing.assert_close(half, 0.5 * whole, rtol=2e-3, atol=1e-4)  # LEAST_SIZE**2 / 0.25**2: 0.2 %


def test_inputs_keep_their_proportions():
    """One size for all: a small input stays small."""
    torch.manual_seed(0)
    source = torch.randn(1000, 2) * torch.tensor([1.0, 0.01])
    network = new(source, source)
    scaled = (source - network.source_rest) / network.source_size
    torch.testing.assert_close(scaled.square().mean(), torch.tensor(1.0))
    torch.testing.assert_close(scaled.std(dim=0)[1] / scaled.std(dim=0)[0], source[:, 1].std() / source[:, 0].std())


def test_inputs_that_never_change():
    source = torch.full((4, 3), 0.5)
    assert torch.isfinite(new(source, source)(source)).all()


def test_a_file_holds_all_of_it(tmp_path):
    source, target = curve(5)
    network = new(source, target, noise=0.2).eval()
    safetensors.torch.save_file(network.state_dict(), tmp_path / "network.safetensors")
    loaded = LatentTranslation.empty(network.settings()).eval()
    loaded.load_state_dict(safetensors.torch.load_file(tmp_path / "network.safetensors"))
    assert loaded.settings() == network.settings()
    assert torch.equal(loaded(source), network(source))


def test_synthetic_signals_are_taken_as_film_thickness():
    """Films in m, and their readings in V, give the same network."""
    torch.manual_seed(0)
    thickness, target = curve(20)
    thickness = 1e-4 * thickness  # 0.3 mm
    settings = ElectrodeSettings(bits=None)
    volts = torch.from_numpy(voltage(thickness.double().numpy(), settings))
    made = []
    for source, circuit in ((thickness, None), (volts.float(), settings.model_dump(mode="json"))):
        torch.manual_seed(1)
        at_rest = source[0], target.mean(dim=0)
        made.append(LatentTranslation.of_samples(
            source, target, *at_rest, width=16, blocks=1, noise=0.0, power=0.5, circuit=circuit
        ))  # fmt: skip
    torch.testing.assert_close(made[1].source_size, made[0].source_size, rtol=1e-2, atol=0.0)
    torch.testing.assert_close(made[1](volts.float()), made[0](thickness), rtol=0.0, atol=2e-2)
    again = LatentTranslation.empty(made[1].settings())
    again.load_state_dict(made[1].state_dict())
    assert torch.equal(again(volts.float()), made[1](volts.float()))


def mirrored_network() -> tuple[LatentTranslation, torch.Tensor, torch.Tensor, torch.Tensor]:
    """A network, inputs and outputs, and a mirror that swaps the first two inputs and changes an output's sign."""
    torch.manual_seed(0)
    source, target = curve(400)
    at_rest = torch.zeros(6), torch.zeros(4)
    network = LatentTranslation.of_samples(
        source, target, *at_rest, width=16, blocks=1, noise=0.0, power=0.5, mirrored=True
    )
    image = torch.tensor([1.0, -1.0, 1.0, 1.0])
    network.learn_mirror(torch.tensor([1, 0, 2, 3, 4, 5]), target, target * image)
    return network, source, target, image


def test_the_mirror_of_outputs_is_learned():
    network, _, _, image = mirrored_network()
    torch.testing.assert_close(network.mirror, image.diag(), rtol=0.0, atol=1e-4)


@torch.no_grad()
def test_the_mirror_image_of_inputs_gives_that_of_outputs():
    network, source, _, image = mirrored_network()
    found = network(source)
    torch.testing.assert_close(network(source[:, network.partner]), found * image, rtol=1e-3, atol=1e-3)
    again = LatentTranslation.empty(network.settings())
    again.load_state_dict(network.state_dict())
    assert torch.equal(again(source), found)


def test_training_shows_mirror_images_by_chance():
    """Their loss is that of the swapped inputs and the mirrored outputs; validation shows none."""
    network, source, target, image = mirrored_network()
    with torch.no_grad():
        ways = [network._from_rest(source) - target, network._from_rest(source[:, network.partner]) - target * image]
        errors = torch.stack([way.square().sum(dim=1).add(LEAST**2).sqrt() for way in ways])
        losses = torch.stack([network.terms(source, target, target * image)["error"] for _ in range(50)])
    expected = errors.mean()
    assert abs(losses.mean() - expected) < 0.02 * expected and losses.std() > 0.0
    network.eval()
    assert network.terms(source, target, target * image) == network.terms(source, target)


def test_networks_of_earlier_versions_load():
    """Their settings know neither film nor mirror images."""
    source, target = curve(20)
    network = new(source, target)
    older = {key: value for key, value in network.settings().items() if key not in ("circuit", "mirrored")}
    again = LatentTranslation.empty(older)
    again.load_state_dict(network.state_dict())
    assert torch.equal(again.eval()(source), network.eval()(source))
