"""The point translator: draws, mirror images, any points, its loss, and that it learns."""

import math

import pytest
import torch
import torch.nn.functional as F

from simgen.learning.data.registry import NETWORKS
from simgen.learning.data.schema import Fit
from simgen.learning.evaluation.doubt import reach_of
from simgen.learning.networks import point_translator
from simgen.learning.networks.chain import make_chain
from simgen.learning.networks.network_data import NetworkData
from simgen.learning.networks.point_translator import (
    CONTACT,
    DRAWS,
    ENTROPY,
    LEAST_CONTACT,
    LEAST_SIZE,
    NOISE,
    ROUNDING,
    SURFACE,
    PointTranslator,
    _energy,
)
from simgen.learning.training.step import TrainingStep


@pytest.fixture
def made(trained):
    """A network whose outputs are not small, and its data."""
    torch.manual_seed(0)
    data = NetworkData(NETWORKS["pt"], trained.inputs)
    data.settings = data.settings.model_copy(update={"predicted": 0.0, "members": 1})
    network, terms = PointTranslator.for_training(data)
    return network, terms, data


@torch.no_grad()
def test_any_points_are_translated(made):
    """The vertices in another order, and points between them."""
    network, _, data = made
    u, rest = data.inputs(data.train[:3]), network.target_rest.numpy()
    order = torch.randperm(len(rest), generator=torch.Generator().manual_seed(1))
    found, logits = network.draws(u, network.places(rest[order.numpy()]))
    assert found.shape == (3, DRAWS, len(rest), 3) and logits.shape == found.shape[:3]
    torch.testing.assert_close(found, network.draws(u)[0][:, :, order], rtol=1e-4, atol=1e-9)
    between = network.draws(u, network.places(0.5 * (rest[:5] + rest[1:6])))[0]
    assert between.shape == (3, DRAWS, 5, 3) and between.isfinite().all()


@torch.no_grad()
def test_draws_differ_and_a_prediction_is_their_mean(made):
    network, _, data = made
    u = data.inputs(data.train[:4])
    found = network.draws(u)[0]
    torch.testing.assert_close(network(u), found.mean(dim=1))
    away = (found[:, :, None] - found[:, None]).square().mean(dim=(3, 4)).sqrt()
    size = found.square().mean(dim=(1, 2, 3)).sqrt()[:, None]
    assert (away[:, ~torch.eye(DRAWS, dtype=bool)] > 1e-3 * size).all()
    assert torch.equal(found, network.draws(u)[0]), "predictions draw no new numbers"


def test_means_over_the_draws_are_those_of_a_normal_distribution(made):
    """Exact for all polynomials up to the third degree. In each half, first and third moments vanish."""
    noise = made[0].noise.double()
    torch.testing.assert_close(noise.T @ noise / DRAWS, torch.eye(NOISE, dtype=torch.float64))
    for some in (noise, *noise.chunk(2)):
        assert (some.sum(dim=0) == 0.0).all()
        assert (torch.einsum("di,dj,dk->ijk", some, some, some).abs() < 1e-12).all()


@torch.no_grad()
def test_half_of_the_draws_go_by_the_mirror_image(made):
    network, _, data = made
    network.mirrored = True
    u, noise = data.inputs(data.train[:4]), network.noise.expand(4, -1, -1)
    ways = [network._drawn(network.members[0], u, noise, torch.full((4,), sign))[0] for sign in (1.0, -1.0)]
    expected = torch.cat([ways[0][:, : DRAWS // 2], ways[1][:, DRAWS // 2 :]], dim=1)
    torch.testing.assert_close(network.draws(u)[0], expected)
    mixed = network._drawn(network.members[0], u, noise, torch.tensor([1.0, -1.0, 1.0, -1.0]))[0]
    torch.testing.assert_close(mixed, torch.stack([ways[0][0], ways[1][1], ways[0][2], ways[1][3]]))


@torch.no_grad()
def test_sensors_that_are_not_symmetric_have_no_mirror_images(made, monkeypatch):
    network, _, data = made
    for symmetric in (True, False):
        monkeypatch.setattr(point_translator, "is_symmetric", lambda *_, answer=symmetric: answer)
        assert PointTranslator.for_training(data)[0].mirrored == symmetric
    network.mirrored = False
    u, noise = data.inputs(data.train[:4]), network.noise.expand(4, -1, -1)
    torch.testing.assert_close(network.draws(u)[0], network._drawn(network.members[0], u, noise, torch.ones(()))[0])


@torch.no_grad()
def test_many_samples_are_predicted_in_parts(made, monkeypatch):
    network, _, data = made
    u = data.inputs(data.train[:7])
    whole = network(u)
    monkeypatch.setattr(point_translator, "SAMPLES_AT_ONCE", 3)
    torch.testing.assert_close(network(u), whole)


@torch.no_grad()
@pytest.mark.parametrize("power", [0.0, 1.0])
def test_the_loss_adds_energy_scores(made, power):
    network, _, data = made
    network.eval()
    network.power = power
    source, target = data.inputs(data.train[:5]), data.outputs(data.train[:5])
    drawn = network._drawn(network.members[0], source, point_translator._noise_of_validation(5), torch.ones(()))
    (a, b), logits = (each.unbind(1) for each in drawn)
    share, rounding = network.share, ROUNDING**2

    def whole(x):
        return (x.square().mean(dim=(1, 2)) + rounding).sqrt()

    def surface(x):
        return ((x.square() * share[:, None]).sum(dim=(1, 2)) / 3 + rounding).sqrt()

    def score(norm, a, b, true):
        return 0.5 * (norm(a - true) + norm(b - true)) - 0.5 * norm(a - b)

    size = target.square().mean(dim=(1, 2)).sqrt()
    unit = (size / network.target_size).clamp_min(LEAST_SIZE) ** -power / network.target_size
    moved = (unit * (score(whole, a, b, target) + SURFACE * score(surface, a, b, target))).mean()
    terms = network.terms(source, target)
    torch.testing.assert_close(terms["loss"], moved)
    torch.testing.assert_close(terms["rmse_m"], 0.5 * (whole(a - target) + whole(b - target)).mean())

    touching = torch.zeros(target.shape[:2], dtype=torch.bool)
    touching[:, :20] = True
    true, (p, q) = touching.float(), (each.sigmoid() for each in logits)
    contact = score(lambda x: ((x.square() * share).sum(dim=1) + LEAST_CONTACT**2).sqrt(), p, q, true).mean()
    wrong = sum((F.softplus(torch.where(touching, -each, each)) * share).sum(dim=1).mean() / 2 for each in logits)
    torch.testing.assert_close(
        network.terms(source, target, touching)["loss"], moved + CONTACT * contact + ENTROPY * wrong
    )


@torch.no_grad()
def test_validation_scores_random_draws(made, monkeypatch):
    """Its loss is that of training on average, and the same in each epoch. One pair for all samples is not."""
    network, _, data = made
    network.mirrored = False  # no chance but that of the draws
    rows = data.train[:4].repeat(64)
    source, target = data.inputs(rows), data.outputs(rows)

    def loss() -> float:
        return network.terms(source, target)["loss"].item()

    network.train()
    losses = torch.tensor([loss() for _ in range(8)])
    network.eval()
    assert loss() == pytest.approx(losses.mean().item(), abs=4.0 * losses.std().item()) and loss() == loss()
    monkeypatch.setattr(point_translator, "_noise_of_validation", lambda n: network.noise[:2].expand(n, -1, -1))
    assert abs(loss() - losses.mean().item()) > 4.0 * losses.std().item()


def test_the_energy_score_is_least_for_the_true_distribution():
    """Truth is +1 or -1 by chance. Draws that are the same lose to their mean, and that to draws of both."""
    random = torch.Generator().manual_seed(0)

    def sign(*shape):
        return 2.0 * torch.randint(2, shape, generator=random) - 1.0

    truth, draws = sign(20_000, 1), sign(20_000, 2, 1)
    scores = [_energy(each, truth, lambda x: x.abs().mean(dim=-1))[0].mean().item()
              for each in (draws, torch.zeros_like(draws), torch.ones_like(draws), 0.5 * draws)]  # fmt: skip
    assert scores[0] < 0.52 and min(scores[1:]) > 0.7


def test_a_share_of_the_inputs_is_predicted(trained):
    torch.manual_seed(0)
    data = NetworkData(NETWORKS["pt"], trained.inputs)
    network, _ = PointTranslator.for_training(data)
    chain = make_chain(("s2rm",), trained.trained)
    with torch.no_grad():
        assert torch.equal(data.predicted_inputs(data.train), chain(data.signals.values[data.train]))
    true, predicted = torch.zeros(2000, 1, 3), torch.ones(2000, 1, 3)
    assert network.train().mixed(true, predicted, 0.3).mean() == pytest.approx(0.3, abs=0.03)
    found = network.eval().mixed(true, predicted, 0.3)[:, 0, 0]
    assert torch.equal(found, network.mixed(true, predicted, 0.3)[:, 0, 0]), "validation does not depend on chance"
    assert found.unflatten(0, (20, 100)).mean(dim=1).tolist() == pytest.approx([0.3] * 20, abs=0.021), "it is even"


def test_sizes_are_root_mean_squares_of_training(made):
    network, _, data = made
    with torch.no_grad():
        target = data.outputs(data.train).square().mean().sqrt()
        known = network.weights.sum(dim=1) > 0.5
        skin = network.skin(data.inputs(data.train))[:, known].square().mean().sqrt()
    torch.testing.assert_close(network.target_size, target, rtol=1e-4, atol=0.0)
    torch.testing.assert_close(network.source_size, skin, rtol=1e-4, atol=0.0)


def test_the_reach_is_set_on_validation_samples(made, trained):
    """From true source meshes first, then from those of S2RM and RMB."""
    network, _, data = made
    assert network.eval().reach.isnan().all()
    network.finish(data)
    s2rm, rmb = (trained.trained(name) for name in ("s2rm", "rmb"))
    gauge, rows = trained.inputs.gauge, data.validation
    with torch.no_grad():
        given = data.inputs(rows), rmb.decode(s2rm(trained.inputs.signals.values[rows]))
        for source, reach in zip(given, network.reach.tolist(), strict=True):
            found = torch.stack([gauge.centroid(each) for each in network.draws(source)[0]])
            assert reach == pytest.approx(reach_of(found, gauge.centroid(data.outputs(rows))), rel=1e-3)
    assert network.reach[0] != network.reach[1]


def test_without_predicted_inputs_their_reach_is_not_known(made):
    network, _, data = made
    data.__dict__["predicted_inputs"] = None
    network.eval().finish(data)
    assert network.reach.isfinite().tolist() == [True, False]


def test_without_a_touchable_surface_the_reach_is_not_known(made, monkeypatch):
    network, _, data = made
    monkeypatch.setattr(NetworkData, "gauge", None)
    network.eval().finish(data)
    assert network.reach.isnan().all()


def test_it_learns(made):
    network, terms, data = made
    network.train()
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    first = terms(data.train)["rmse_m"].item()
    for _ in range(80):
        optimizer.zero_grad()
        terms(data.train)["loss"].backward()
        optimizer.step()
    assert network.eval() and terms(data.train)["rmse_m"].item() < 0.5 * first


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA GPU on this machine")
@pytest.mark.parametrize("members", [1, 2])
def test_a_gpu_records_its_step(made, members):
    """In bfloat16, as a CUDA graph, with fused operations and shortened gradients: the loss falls."""
    _, _, data = made
    data.settings = data.settings.model_copy(update={"members": members})
    network, _ = PointTranslator.for_training(data)
    device = torch.device("cuda", 0)
    network.to(device).train()
    source, target = (values(data.train).to(device) for values in (data.inputs, data.outputs))
    touching = data.touching()[data.train].to(device)
    step = TrainingStep(
        network, lambda rows: network.terms(source[rows], target[rows], touching[rows]),
        Fit(clip=1.0, warm_up=3), 16, device, tf32=True,
    )  # fmt: skip
    rows = torch.arange(len(source) // 16 * 16, device=device)
    losses = [step.over(rows, 3e-3, done=epoch * (len(rows) // 16))["loss"] for epoch in range(20)]
    assert all(map(math.isfinite, losses)) and losses[-1] < 0.8 * losses[0]
    assert network.eval()(source[:2]).isfinite().all()


@pytest.fixture
def two(made):
    """A network of two members, and its data."""
    _, _, data = made
    data.settings = data.settings.model_copy(update={"members": 2})
    return PointTranslator.for_training(data)[0], data


@torch.no_grad()
def test_all_members_answer(two):
    network, data = two
    u, noise = data.inputs(data.train[:3]), network.noise.expand(3, -1, -1)
    network.mirrored = False
    found = network.draws(u)
    assert network.draw_count == 2 * DRAWS == found[0].shape[1]
    for number, member in enumerate(network.members):
        for values, own in zip(found, network._drawn(member, u, noise, torch.ones(())), strict=True):
            torch.testing.assert_close(values[:, number * DRAWS : (number + 1) * DRAWS], own)


@pytest.mark.parametrize("training", [True, False])
def test_a_member_learns_from_its_share_alone(two, training):
    """The first of two members has three of five samples. What the last sample is does not matter to it."""
    network, data = two
    source, target = data.inputs(data.train[:5]), data.outputs(data.train[:5])

    def slopes(true):
        torch.manual_seed(0)
        network.zero_grad()
        network.train(training).terms(source, true)["loss"].backward()
        return [[parameter.grad.clone() for parameter in member.parameters()] for member in network.members]

    other = target.clone()
    other[-1] *= 2.0
    (first, second), (first_again, second_again) = slopes(target), slopes(other)
    assert all(map(torch.equal, first, first_again)) and not all(map(torch.equal, second, second_again))


def test_all_members_learn(made):
    """Also if their number does not divide the batch."""
    _, _, data = made
    data.settings = data.settings.model_copy(update={"members": 5})
    network, _ = PointTranslator.for_training(data)
    source, target = data.inputs(data.train[:7]), data.outputs(data.train[:7])
    network.train().terms(source, target)["loss"].backward()
    for member in network.members:
        assert any(parameter.grad.abs().max() > 0.0 for parameter in member.parameters())


def test_fewer_samples_than_members(two):
    network, data = two
    terms = network.eval().terms(data.inputs(data.train[:1]), data.outputs(data.train[:1]))
    assert terms["loss"].isfinite()


def test_networks_from_before_there_were_members_load(made):
    """Their U-Net and perceptron had no member's number, and their settings no members."""
    network, _, data = made
    old = {name.removeprefix("members.0."): value for name, value in network.state_dict().items()}
    settings = {name: value for name, value in network.settings().items() if name != "members"}
    loaded = PointTranslator.empty(settings)
    loaded.load_state_dict(old)
    u = data.inputs(data.train[:2])
    assert torch.equal(loaded.eval()(u), network.eval()(u))
