"""One step of the optimiser on a batch. A GPU records it once as a CUDA graph and replays it.

A step launches hundreds of kernels of a few microseconds each. A CPU launches them more slowly than a GPU runs them.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

import torch
from torch import Tensor, nn

from simgen.learning.data.schema import Fit
from simgen.learning.training.muon import Muon

WARM_UP = 3  # steps before recording: in the first ones libraries choose kernels and allocate memory
MOMENTS = {"adamw": ("exp_avg", "exp_avg_sq"), "muon": ("momentum",)}  # of a parameter, as large as it
COUNTS = {"adamw": ("step",), "muon": ()}  # tensors of shape ()


@contextmanager
def tf32_products() -> Iterator[None]:
    """Multiply float32 matrices in TF32 on a GPU; nothing changes on a CPU."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("high")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


class TrainingStep:
    """AdamW on the mean of a batch (Loshchilov and Hutter, ICLR 2019). If the settings say so, `Muon` moves matrices.

    terms : row numbers (batch,) -> means over these samples; the first is minimised
    tf32 : multiply matrices with TF32's ten bits of mantissa where the GPU can: within `products`
    """

    def __init__(
        self, network: nn.Module, terms: Callable[[Tensor], dict[str, Tensor]], settings: Fit, batch: int,
        device: torch.device, tf32: bool = False,
    ):  # fmt: skip
        self.settings = settings
        self.network, self.terms = network, terms
        self.on_gpu = device.type == "cuda"
        self.products = tf32_products if tf32 and self.on_gpu else nullcontext
        self.parameters = [parameter for parameter in network.parameters() if parameter.requires_grad]
        self.optimizers = self._optimizers()
        self.rows = torch.zeros(batch, dtype=torch.int64, device=device)
        self.names: list[str] = []
        self.sums: Tensor | None = None
        self.graph: torch.cuda.CUDAGraph | None = None

    def _optimizers(self) -> dict[str, torch.optim.Optimizer]:
        """Make the optimisers by name. Each has the parameters that it moves."""
        rate, decay = self.settings.learning_rate, self.settings.weight_decay
        least = 2 if self.settings.by_muon else math.inf  # dimensions
        by_muon = [each for each in self.parameters if each.ndim >= least]
        by_adamw = [each for each in self.parameters if each.ndim < least]
        if self.on_gpu:
            rate = torch.tensor(rate, device=self.parameters[0].device)
        found: dict[str, torch.optim.Optimizer] = {}
        if by_adamw:
            found["adamw"] = torch.optim.AdamW(
                by_adamw, rate, weight_decay=decay, capturable=self.on_gpu, fused=self.on_gpu or None
            )
        if by_muon:
            found["muon"] = Muon(by_muon, rate, decay)
        return found

    def over(self, rows: Tensor, rate: float, done: int = 0) -> dict[str, float]:
        """Step through rows, a whole number of batches, in their order. Returns the means of the terms.

        rate : learning rate
        done : steps of earlier calls; the first ``warm_up`` steps of all have a smaller rate
        """
        self._set_rate(rate)
        if self.on_gpu and self.graph is None:
            self._record(rows[: len(self.rows)])
        if self.sums is not None:
            self.sums.zero_()
        batches = rows.split(len(self.rows))
        for number, batch in enumerate(batches, start=done + 1):
            if number <= self.settings.warm_up:
                self._set_rate(rate * number / self.settings.warm_up)
            self.rows.copy_(batch)
            if self.graph is None:
                self._step()
            else:
                self.graph.replay()
        return dict(zip(self.names, (self.sums / len(batches)).tolist(), strict=True))

    def _set_rate(self, rate: float) -> None:
        for optimizer in self.optimizers.values():
            group = optimizer.param_groups[0]
            if self.on_gpu:
                group["lr"].fill_(rate)
            else:
                group["lr"] = rate

    def _step(self) -> None:
        self.network.zero_grad(set_to_none=True)
        terms = self.terms(self.rows)
        next(iter(terms.values())).backward()
        if self.settings.clip:
            nn.utils.clip_grad_norm_(self.parameters, self.settings.clip)
        for optimizer in self.optimizers.values():
            optimizer.step()
        if self.sums is None:
            self.names = list(terms)
            self.sums = torch.zeros(len(terms), dtype=torch.float64, device=self.rows.device)
        self.sums += torch.stack([value.detach().double() for value in terms.values()])

    def _record(self, rows: Tensor) -> None:
        """Record a step, then restore network, optimiser and random numbers."""
        weights = [parameter.detach().clone() for parameter in self.parameters]
        buffers = [buffer.detach().clone() for buffer in self.network.buffers()]
        moments = {name: value.clone() for name, value in self.optimizer_state().items()}
        self.rows.copy_(rows)
        graph = torch.cuda.CUDAGraph()
        # Otherwise the first epoch of a process would draw other numbers than the same epoch of an earlier process.
        with torch.random.fork_rng([self.rows.device]), self.products():
            stream = torch.cuda.Stream()
            stream.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(stream):
                for _ in range(WARM_UP):
                    self._step()
            torch.cuda.current_stream().wait_stream(stream)
            self.network.zero_grad(set_to_none=True)
            with torch.cuda.graph(graph):
                self._step()
        with torch.no_grad():
            for parameter, value in zip(self.parameters, weights, strict=True):
                parameter.copy_(value)
            for buffer, value in zip(self.network.buffers(), buffers, strict=True):
                buffer.copy_(value)
            for name, value in self.optimizer_state().items():
                value.copy_(moments.get(name, torch.zeros_like(value)))
        self.graph = graph

    def optimizer_state(self) -> dict[str, Tensor]:
        """Moments and step counts by ``<optimizer>.<parameter>.<name>``; empty before the first step."""
        return {
            f"{optimizer}.{number}.{name}": value
            for optimizer, owner in self.optimizers.items()
            for number, own in owner.state_dict()["state"].items()
            for name, value in own.items()
        }

    def load_optimizer_state(self, tensors: dict[str, Tensor]) -> None:
        """Restore an `optimizer_state`. Raises `LookupError` or `ValueError` if moments are missing or do not fit."""
        for optimizer, owner in self.optimizers.items():
            state: dict[int, dict[str, Tensor]] = {}
            for number, parameter in enumerate(owner.param_groups[0]["params"]):
                shapes = dict.fromkeys(COUNTS[optimizer], ()) | dict.fromkeys(MOMENTS[optimizer], parameter.shape)
                for name, shape in shapes.items():
                    value = tensors[key := f"{optimizer}.{number}.{name}"]
                    if value.shape != shape:
                        raise ValueError(f"optimizer.{key}: shape {tuple(value.shape)}; allowed: {tuple(shape)}")
                    state.setdefault(number, {})[name] = value
            owner.load_state_dict({"state": state, "param_groups": owner.state_dict()["param_groups"]})
