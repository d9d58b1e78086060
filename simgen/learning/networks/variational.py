"""Sampling and divergence of beta-VAEs (Kingma and Welling 2014; Higgins et al. 2017)."""

import torch
from torch import Tensor


def sample(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Draw latents from N(mean, exp(log_variance)), differentiable in both."""
    return mean + torch.exp(0.5 * log_variance) * torch.randn_like(mean)


def divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL divergence from N(0, 1), a mean over samples and latents: beta weighs each latent, as published."""
    return -0.5 * torch.mean(1.0 + log_variance - mean**2 - torch.exp(log_variance))
