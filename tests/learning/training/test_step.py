"""A step of the optimisers, on a CPU: AdamW by its formula, what Muon moves, means of terms, a state taken over."""

import pytest
import torch
from torch import nn

from simgen.learning.data.schema import Fit, FitByMuon
from simgen.learning.training.muon import Muon
from simgen.learning.training.step import TrainingStep, tf32_products

CPU = torch.device("cpu")
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8  # of Adam (Kingma and Ba, ICLR 2015)


class Line(nn.Module):
    """y = w x, for one w."""

    def __init__(self):
        super().__init__()
        self.w = nn.Parameter(torch.tensor(2.0, dtype=torch.float64))
        self.x = torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], dtype=torch.float64)

    def terms(self, rows):
        error = self.w * self.x[rows] - 1.0
        return {"loss": error.square().mean(), "bias": error.mean()}

    def step(self, **settings) -> TrainingStep:
        return TrainingStep(self, self.terms, Fit(**settings), 2, CPU)


def by_hand(line: Line, order: list[int], rate: float, decay: float) -> tuple[float, list[float]]:
    """w after AdamW (Loshchilov and Hutter, ICLR 2019) in batches of two, and the losses before each step."""
    w, m, v, losses = 2.0, 0.0, 0.0, []
    for number, start in enumerate(range(0, len(order), 2), start=1):
        x = line.x[order[start : start + 2]].numpy()
        losses.append(((w * x - 1.0) ** 2).mean())
        gradient = (2.0 * (w * x - 1.0) * x).mean()
        m, v = BETA1 * m + (1 - BETA1) * gradient, BETA2 * v + (1 - BETA2) * gradient**2
        w *= 1.0 - rate * decay
        w -= rate * (m / (1 - BETA1**number)) / ((v / (1 - BETA2**number)) ** 0.5 + EPSILON)
    return w, losses


@pytest.mark.parametrize("decay", [0.0, 0.5])
def test_it_is_adamw_by_its_formula(decay):
    line, order = Line(), [3, 0, 5, 1, 2, 4]
    found = line.step(learning_rate=0.5, weight_decay=decay).over(torch.tensor(order), 0.1)
    w, losses = by_hand(line, order, 0.1, decay)
    assert line.w.item() == pytest.approx(w, rel=1e-12)  # float64
    assert found["loss"] == pytest.approx(sum(losses) / 3, rel=1e-12)
    assert list(found) == ["loss", "bias"]


class Layer(nn.Module):
    """y = A x + b."""

    def __init__(self):
        super().__init__()
        torch.manual_seed(5)
        self.layer = nn.Linear(3, 2)
        self.x = torch.randn(6, 3)

    def terms(self, rows):
        return {"loss": (self.layer(self.x[rows]) - 1.0).square().mean()}

    def step(self, **settings) -> TrainingStep:
        return TrainingStep(self, self.terms, FitByMuon(**settings), 2, CPU)


def test_muon_moves_matrices_and_adamw_the_rest():
    """Both with the rate of the step, not that of the settings."""
    found, expected, rows = Layer(), Layer(), torch.tensor([0, 3])
    found.step(learning_rate=0.5, weight_decay=0.1).over(rows, 0.1)
    expected.terms(rows)["loss"].backward()
    Muon([expected.layer.weight], 0.1, weight_decay=0.1).step()
    torch.optim.AdamW([expected.layer.bias], 0.1, weight_decay=0.1).step()
    assert torch.equal(found.layer.weight, expected.layer.weight)
    assert torch.equal(found.layer.bias, expected.layer.bias)


def test_the_rate_grows_in_the_first_steps():
    """As by calls of one step each, with the rates of the warm-up; it goes on in a later call."""
    one, other = Line(), Line()
    warm, plain = one.step(warm_up=4), other.step()
    warm.over(torch.tensor([0, 1, 2, 3]), 0.1)
    warm.over(torch.tensor([4, 5, 0, 1, 2, 3]), 0.2, done=2)
    for rows, rate in (([0, 1], 0.025), ([2, 3], 0.05), ([4, 5], 0.15), ([0, 1], 0.2), ([2, 3], 0.2)):
        plain.over(torch.tensor(rows), rate)
    assert one.w.item() == pytest.approx(other.w.item(), rel=1e-12)


def test_long_gradients_are_shortened():
    """The moments of Adam then are those of a gradient of this length; a short one stays as it is."""
    line = Line()
    step = line.step(clip=0.5)
    step.over(torch.tensor([4, 5]), 0.1)
    assert step.optimizer_state()["adamw.0.exp_avg"].item() == pytest.approx((1 - BETA1) * 0.5, rel=1e-5)
    line = Line()
    step = line.step(clip=1e3)
    step.over(torch.tensor([0, 1]), 0.1)
    gradient = 7.0  # mean of 2 x (2 x - 1) for x = 1, 2
    assert step.optimizer_state()["adamw.0.exp_avg"].item() == pytest.approx((1 - BETA1) * gradient, rel=1e-12)


def test_means_are_of_one_call():
    line = Line()
    step = line.step()
    step.over(torch.tensor([4, 5]), 1e-12)
    rows = torch.tensor([0, 1, 2, 3])
    expected = {name: value.item() for name, value in line.terms(rows).items()}
    assert step.over(rows, 1e-12) == pytest.approx(expected, rel=1e-9)  # the rate, of w and so of the terms


def test_what_does_not_learn_stays():
    line = Line()
    line.w.requires_grad_(False)
    line.own = nn.Parameter(torch.ones((), dtype=torch.float64))
    TrainingStep(line, lambda rows: {"loss": line.own * line.w}, Fit(), 2, CPU).over(torch.tensor([0, 1]), 0.1)
    assert line.w == 2.0 and line.own != 1.0


@pytest.mark.parametrize("network, settings", [(Line, {}), (Layer, {"optimizer": "adamw"}), (Layer, {})])
def test_it_goes_on_from_a_state(network, settings):
    whole, first, second = network(), network(), network()
    rows = torch.tensor([0, 1, 2, 3, 4, 5])
    whole.step(**settings).over(rows, 0.1)
    before = first.step(**settings)
    before.over(rows[:4], 0.1)
    after = second.step(**settings)
    second.load_state_dict(first.state_dict())
    after.load_optimizer_state({name: value.clone() for name, value in before.optimizer_state().items()})
    after.over(rows[4:], 0.1)
    for found, expected in zip(second.parameters(), whole.parameters(), strict=True):
        assert torch.equal(found, expected)


@pytest.mark.parametrize("change", [
    lambda state: state.pop("adamw.0.exp_avg"), lambda state: state.pop("muon.0.momentum"), lambda state: state.clear(),
    lambda state: state.update({"adamw.0.exp_avg_sq": torch.zeros(3)}),
    lambda state: state.update({"adamw.0.step": torch.zeros(2)}),
    lambda state: state.update({"muon.0.momentum": torch.zeros(3)}),
])  # fmt: skip
def test_moments_that_do_not_fit_are_no_state(change):
    step = Layer().step()
    step.over(torch.tensor([0, 1]), 0.1)
    state = step.optimizer_state()
    Layer().step().load_optimizer_state(state)
    change(state)
    with pytest.raises((LookupError, ValueError)):
        Layer().step().load_optimizer_state(state)


def test_a_new_step_has_no_state():
    assert Line().step().optimizer_state() == {}


def test_tf32_products_end_with_the_block():
    before = torch.get_float32_matmul_precision()
    with pytest.raises(KeyError), tf32_products():
        assert torch.get_float32_matmul_precision() == "high"
        raise KeyError
    assert torch.get_float32_matmul_precision() == before
