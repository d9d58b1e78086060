"""Drawn latents and their divergence, against torch's own distributions."""

import torch
from torch.distributions import Normal, kl_divergence

from simgen.learning.networks.variational import divergence, sample


def test_the_divergence_is_the_mean_of_torch_s_own():
    mean, log_variance = torch.randn(40, 3), torch.randn(40, 3)
    expected = kl_divergence(Normal(mean, torch.exp(0.5 * log_variance)), Normal(0.0, 1.0)).mean()
    torch.testing.assert_close(divergence(mean, log_variance), expected)


def test_no_divergence_from_itself():
    assert divergence(torch.zeros(5, 2), torch.zeros(5, 2)) == 0.0


def test_samples_have_the_mean_and_the_variance():
    torch.manual_seed(0)
    count, mean, log_variance = 40_000, torch.tensor([1.0, -2.0]), torch.tensor([0.5, -3.0])
    found = sample(mean.expand(count, 2), log_variance.expand(count, 2))
    deviation = torch.exp(0.5 * log_variance)
    # Five standard errors: deviation / sqrt(n) of a mean, deviation / sqrt(2 n) of a deviation.
    assert ((found.mean(dim=0) - mean).abs() < 5 * deviation / count**0.5).all()
    assert ((found.std(dim=0) - deviation).abs() < 5 * deviation / (2 * count) ** 0.5).all()


def test_both_get_a_gradient():
    torch.manual_seed(0)
    mean, log_variance = torch.zeros(9, requires_grad=True), torch.zeros(9, requires_grad=True)
    drawn = sample(mean, log_variance)
    drawn.sum().backward()
    torch.testing.assert_close(mean.grad, torch.ones(9))
    torch.testing.assert_close(log_variance.grad, 0.5 * drawn.detach())  # of exp(v / 2) noise, at v = 0
