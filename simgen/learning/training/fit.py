"""Training of one network: epochs, early stopping, and a state on disk from which it continues.

Each epoch has its own seed for everything random: order, dropout, noise, latents and answers that are drawn, and which
samples are mirrored or have predicted inputs. A training that was killed therefore ends with the same bits on a CPU.
"""

import hashlib
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from simgen.errors import InputError, shown
from simgen.learning.data.schema import Fit
from simgen.learning.networks.checkpoint import read_state, write_state
from simgen.learning.networks.network import Terms
from simgen.learning.training.step import TrainingStep

SAVE_EVERY_S = 20.0  # a kill costs at most this and an epoch


@dataclass(frozen=True)
class Epoch:
    """Result of one epoch. ``terms`` are means over its samples, such as ``train_loss`` and ``validation_mse``."""

    number: int
    learning_rate: float
    seconds: float
    terms: dict[str, float]

    def row(self) -> dict[str, float]:
        return {"epoch": self.number, "learning_rate": self.learning_rate, "seconds": self.seconds, **self.terms}


@dataclass
class Progress:
    """Progress of a training, without its tensors."""

    history: list[Epoch] = field(default_factory=list)
    best: int = -1  # the epoch with the least validation loss
    stopped: bool = False

    @property
    def since_best(self) -> int:
        return len(self.history) - 1 - self.best

    def loss(self, epoch: int) -> float:
        return self.history[epoch].terms["validation_loss"]

    def to_json(self) -> dict[str, Any]:
        return {"history": [asdict(epoch) for epoch in self.history], "best": self.best, "stopped": self.stopped}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "Progress":
        return cls([Epoch(**epoch) for epoch in data["history"]], data["best"], data["stopped"])


class Training:
    """A training that yields its epochs. At the end ``network`` has the weights with the least validation loss.

    terms : loss and other terms of ``network``, by row numbers
    rows : row numbers of training and of validation, on the network's device
    state : file that saves the training, and from which it continues
    tf32 : see `simgen.learning.training.step.TrainingStep`
    """

    def __init__(
        self, name: str, network: nn.Module, terms: Terms, rows: tuple[Tensor, Tensor], settings: Fit, seed: int,
        state: Path, tf32: bool = False,
    ):  # fmt: skip
        self.name, self.network, self.terms, self.settings, self.seed = name, network, terms, settings, seed
        self.train_rows, self.validation_rows = rows
        self.state, self.progress = state, Progress()
        self.batch = min(settings.batch, len(self.train_rows))
        self.step = TrainingStep(network, terms, settings, self.batch, self.train_rows.device, tf32)
        self.best = _copy(network)
        if state.exists():
            self._read()

    def __iter__(self) -> Iterator[Epoch]:
        saved = time.monotonic()
        while not self.finished:
            epoch = self._epoch()
            self.progress.history.append(epoch)
            if self.progress.best < 0 or epoch.terms["validation_loss"] < self.progress.loss(self.progress.best):
                self.progress.best = epoch.number
                self.best = _copy(self.network)
            self.progress.stopped = self.progress.since_best >= self.settings.patience
            if self.finished or time.monotonic() - saved > SAVE_EVERY_S:
                self._write()
                saved = time.monotonic()
            yield epoch
        self.network.load_state_dict(self.best)
        self.network.eval()

    @property
    def finished(self) -> bool:
        return self.progress.stopped or len(self.progress.history) >= self.settings.epochs

    @property
    def samples(self) -> int:
        """Samples that an epoch trains on. An incomplete last batch is left out; its samples differ in each epoch."""
        return len(self.train_rows) // self.batch * self.batch

    def _epoch(self) -> Epoch:
        number = len(self.progress.history)
        started = time.monotonic()
        torch.manual_seed(epoch_seed(self.seed, self.name, number))  # on all devices
        rate = self.settings.learning_rate_in(number)
        order = torch.randperm(len(self.train_rows)).to(self.train_rows.device)
        self.network.train()
        done = number * (self.samples // self.batch)
        means = self.step.over(self.train_rows[order[: self.samples]], rate, done)
        found = {f"train_{name}": value for name, value in means.items()}
        self.network.eval()
        found |= {f"validation_{name}": value for name, value in self._validate().items()}
        for name, value in found.items():
            if not torch.isfinite(torch.tensor(value)):
                raise InputError(f"{self.name}: {name} is {value} in epoch {number}; a smaller learning_rate may help")
        return Epoch(number, rate, time.monotonic() - started, found)

    @torch.no_grad()
    def _validate(self) -> dict[str, float]:
        sums: dict[str, Tensor] = {}
        with self.step.products():  # as in training
            for rows in self.validation_rows.split(self.batch):
                for name, value in self.terms(rows).items():
                    sums[name] = sums.get(name, 0.0) + value.double() * len(rows)
        return {name: float(value) / len(self.validation_rows) for name, value in sums.items()}

    def _write(self) -> None:
        tensors = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        tensors |= {f"best.{name}": value for name, value in self.best.items()}
        tensors |= {f"optimizer.{name}": value for name, value in self.step.optimizer_state().items()}
        write_state(self.state, tensors, self.progress.to_json())

    def _read(self) -> None:
        tensors, progress = read_state(self.state)
        groups: dict[str, dict[str, Tensor]] = {"network": {}, "best": {}, "optimizer": {}}
        try:
            for name, value in tensors.items():
                group, _, rest = name.partition(".")
                groups[group][rest] = value.to(self.train_rows.device)
            self.network.load_state_dict(groups["best"])
            self.network.load_state_dict(groups["network"])
            self.step.load_optimizer_state(groups["optimizer"])
            self.progress = Progress.from_json(progress)
            self.progress.loss(self.progress.best)
        except (LookupError, TypeError, ValueError, RuntimeError) as error:
            what = shown(str(error), 200)
            raise InputError(f"{self.state}: not a state of this training ({what}); remove it") from None
        self.best = groups["best"]


def epoch_seed(seed: int, name: str, epoch: int) -> int:
    """Seed for everything random in one epoch of a network."""
    return int.from_bytes(hashlib.sha256(f"{seed} {name} {epoch}".encode()).digest()[:7], "little")


def _copy(network: nn.Module) -> dict[str, Tensor]:
    return {name: value.detach().clone() for name, value in network.state_dict().items()}
