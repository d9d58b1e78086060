"""Samples as torch tensors. Only who asks for them imports torch."""

from typing import TYPE_CHECKING

import torch

if TYPE_CHECKING:
    from simgen.loading import Samples


class TorchSamples(torch.utils.data.Dataset):
    """A map-style dataset over `simgen.loading.Samples`, for `torch.utils.data.DataLoader`, any number of workers."""

    def __init__(self, samples: "Samples"):
        self.samples = samples

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, number: int) -> dict[str, torch.Tensor]:
        return {name: torch.as_tensor(value) for name, value in self.samples[number].items()}
