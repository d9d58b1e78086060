"""Compare the training speed of the mesh beta-VAE with torch-geometric.

    python benchmarks/mesh_vae.py --sensor digit --device cuda --batch 128 --output mesh_vae.json

All variants have the same samples and initial weights. First their losses and gradients are compared in float64, so
that rounding does not flip a ReLU. Then training steps in float32 are timed in rounds. "torch-geometric" is the
library's `ChebConv`. "known weights" computes the Laplacian's weights once, as the published ports of CoMA do. "graph"
is ours as a CUDA graph. "TF32" also has products of that precision, as `simgen train` does. Samples are random normal
numbers on the device.
"""

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata

import numpy as np
import torch
import torch.nn.functional as F
from record import arguments, write
from scipy.sparse import csr_array, eye_array, vstack
from torch import Tensor, nn
from torch_geometric.nn import ChebConv

from simgen.config.resources import resource
from simgen.learning.networks.chebyshev import ChebyshevConvolution, scaled_laplacian
from simgen.learning.networks.hierarchy import Hierarchy, build_hierarchy
from simgen.learning.networks.mesh_vae import DECODER, ENCODER, HIDDEN, LATENT, ORDER, MeshVAE
from simgen.learning.training.step import tf32_products

SAMPLES = 123_000  # samples of an epoch: the training split of jobs/paired.yaml
BETA = 0.005
COMPARED = 8  # samples that are compared in float64
WARM_UP, STEPS = 3, 5  # steps of the first round, and of the others
ROUNDING = 1e-9  # allowed relative difference of losses and gradients in float64


class KnownWeights(ChebConv):
    """`ChebConv` whose edge weights are those of the scaled Laplacian."""

    def __norm__(self, edge_index, num_nodes, edge_weight, *_, **__):
        return edge_index, edge_weight


class Pool(nn.Module):
    """Sparse matrix times features (sample, vertex, feature), as a sum over its entries."""

    def __init__(self, matrix: csr_array):
        super().__init__()
        entries = matrix.tocoo()
        self.rows = entries.shape[0]
        for name, values in (("row", entries.row), ("column", entries.col), ("value", entries.data)):
            dtype = torch.get_default_dtype() if name == "value" else torch.int64
            self.register_buffer(name, torch.as_tensor(values, dtype=dtype))

    def forward(self, x: Tensor) -> Tensor:
        out = x.new_zeros(x.shape[0], self.rows, x.shape[2])
        return out.index_add(1, self.row, x[:, self.column] * self.value[:, None])


class GeometricVAE(nn.Module):
    """The same network with torch-geometric's layers; takes normalised (sample, vertex, 3) in the hierarchy's order."""

    def __init__(self, hierarchy: Hierarchy, known_weights: bool):
        super().__init__()
        self.known_weights, kind = known_weights, KnownWeights if known_weights else ChebConv
        for level, matrix in enumerate(hierarchy.adjacency[:-1]):
            laplacian = scaled_laplacian(matrix).tocoo()
            edges = torch.from_numpy(np.stack([laplacian.row, laplacian.col]).astype(np.int64))
            self.register_buffer(f"edges{level}", edges)
            self.register_buffer(f"weights{level}", torch.as_tensor(laplacian.data, dtype=torch.get_default_dtype()))
        ups = [vstack([eye_array(matrix.shape[1]), matrix]) for matrix in hierarchy.interpolation]
        self.up = nn.ModuleList(map(Pool, ups))
        self.down = nn.ModuleList(
            Pool(eye_array(small, size))
            for size, small in zip(hierarchy.sizes, hierarchy.sizes[1:], strict=False)
        )
        self.down_convolutions = nn.ModuleList(map(kind, ENCODER, ENCODER[1:], [ORDER] * 4))
        coarsest, hidden = hierarchy.sizes[-1], HIDDEN * LATENT
        self.to_hidden = nn.Linear(coarsest * ENCODER[-1], hidden)
        self.to_mean, self.to_log_variance = nn.Linear(hidden, LATENT), nn.Linear(hidden, LATENT)
        self.from_latent = nn.Linear(LATENT, hidden)
        self.from_hidden = nn.Linear(hidden, coarsest * DECODER[0])
        self.up_convolutions = nn.ModuleList(map(kind, DECODER, DECODER[1:], [ORDER] * 4))
        self.last = kind(DECODER[-1], 3, ORDER, bias=False)

    def convolve(self, convolution: ChebConv, x: Tensor, level: int) -> Tensor:
        edges = getattr(self, f"edges{level}")
        if self.known_weights:
            return convolution(x, edges, getattr(self, f"weights{level}"))
        return convolution(x, edges, lambda_max=2.0)

    def terms(self, x: Tensor, beta: float) -> dict[str, Tensor]:
        target = x
        for level, convolution in enumerate(self.down_convolutions):
            x = self.down[level](F.relu(self.convolve(convolution, x, level)))
        hidden = F.relu(self.to_hidden(x.flatten(1)))
        mean, log_variance = self.to_mean(hidden), self.to_log_variance(hidden)
        latent = mean + torch.exp(0.5 * log_variance) * torch.randn_like(mean)
        x = F.relu(self.from_hidden(F.relu(self.from_latent(latent)))).view(len(x), -1, DECODER[0])
        for level, convolution in zip(reversed(range(len(self.up))), self.up_convolutions, strict=True):
            x = F.relu(self.convolve(convolution, self.up[level](x), level))
        error = F.mse_loss(self.convolve(self.last, x, 0), target)
        divergence = -0.5 * (1.0 + log_variance - mean.square() - log_variance.exp()).mean()
        return {"loss": error + beta * divergence, "mse": error, "kl": divergence}

    def take_weights(self, network: MeshVAE) -> None:
        for name, module in network.named_modules():
            mine = self.get_submodule(name) if isinstance(module, ChebyshevConvolution | nn.Linear) else None
            if isinstance(module, ChebyshevConvolution):
                mine.load_state_dict({f"lins.{k}.weight": w for k, w in enumerate(module.weight)}
                                     | ({} if module.bias is None else {"bias": module.bias}))  # fmt: skip
            elif mine is not None:
                mine.load_state_dict(module.state_dict())

    def gradients(self) -> dict[str, Tensor]:
        """Gradients by the names of `MeshVAE`."""
        found = {name: value.grad for name, value in self.named_parameters() if ".lins." not in name
                 and not name.startswith("lins.")}  # fmt: skip
        for name, module in self.named_modules():
            if isinstance(module, ChebConv):
                found[f"{name}.weight"] = torch.stack([linear.weight.grad for linear in module.lins])
        return found


def step_of(network: nn.Module, samples: Tensor) -> Callable[[], None]:
    """Make a training step on fixed samples."""
    on_gpu = samples.is_cuda
    optimizer = torch.optim.Adam(network.parameters(), 1e-3, fused=on_gpu, capturable=on_gpu)

    def step() -> None:
        optimizer.zero_grad(set_to_none=True)
        network.terms(samples, BETA)["loss"].backward()
        optimizer.step()

    return step


def recorded(step: Callable[[], None]) -> Callable[[], None]:
    """Record a step as a CUDA graph."""
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(WARM_UP):
            step()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()

    def replay(of: Callable[[], None] = step) -> None:  # keeps moments and weights alive
        graph.replay()

    return replay


@dataclass
class Variants:
    """Networks, and the samples in the order that each takes."""

    ours: MeshVAE
    samples: Tensor
    geometric: dict[str, GeometricVAE]
    in_order: Tensor


def make(hierarchy: Hierarchy, batch: int, device: str, dtype: torch.dtype) -> Variants:
    torch.set_default_dtype(dtype)
    torch.manual_seed(0)
    size = hierarchy.sizes[0]
    samples = torch.randn(batch, size, 3).to(device)
    ours = MeshVAE.of_mesh(hierarchy, np.zeros((size, 3)), np.ones((size, 3))).to(device)
    known = {"torch-geometric": False, "torch-geometric, known weights": True}
    geometric = {name: GeometricVAE(hierarchy, value).to(device) for name, value in known.items()}
    for network in geometric.values():
        network.take_weights(ours)
    return Variants(ours, samples, geometric, samples[:, ours.order].contiguous())


def differences(variants: Variants) -> dict[str, dict[str, float]]:
    """Compare losses and gradients; a gradient's difference is relative to the parameter's largest entry.

    Raises `SystemExit` if the networks differ.
    """
    loss = loss_of(variants.ours, variants.samples)
    found = {}
    for name, network in variants.geometric.items():
        other = loss_of(network, variants.in_order)
        gradients = network.gradients()
        largest = max(
            float((value.grad - gradients[key]).abs().max() / value.grad.abs().max())
            for key, value in variants.ours.named_parameters()
        )
        found[name] = {"loss": abs(loss / other - 1.0), "gradient": largest}
        print(name, found[name], flush=True)
        if not max(found[name].values()) < ROUNDING:
            raise SystemExit(f"{name}: not the same network: {found[name]}, allowed {ROUNDING}")
    return found


def loss_of(network: nn.Module, samples: Tensor) -> float:
    """Compute the loss and its gradients, with the same random latents in each call."""
    torch.manual_seed(1)
    loss = network.terms(samples, BETA)["loss"]
    loss.backward()
    return loss.item()


def waited(device: str) -> float:
    if device != "cpu":
        torch.cuda.synchronize()
    return time.perf_counter()


def main() -> None:
    parser = arguments(__doc__, "mesh_vae.json")
    parser.add_argument("--sensor", default="digit", choices=["digit", "biotac"])
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--repeats", type=int, default=5)
    asked = parser.parse_args()

    with np.load(resource("sensor_models") / asked.sensor / "output.npz") as mesh:
        hierarchy = build_hierarchy(mesh["vertices"], mesh["tetrahedra"])
    found = differences(make(hierarchy, min(asked.batch, COMPARED), asked.device, torch.float64))
    variants = make(hierarchy, asked.batch, asked.device, torch.float32)
    steps = {name: step_of(network, variants.in_order) for name, network in variants.geometric.items()}
    steps["ours"] = step_of(variants.ours, variants.samples)
    if asked.device != "cpu":
        steps["ours, graph"] = recorded(step_of(variants.ours, variants.samples))
        with tf32_products():  # as `simgen train` has it
            steps["ours, graph, TF32"] = recorded(step_of(variants.ours, variants.samples))
    rows = timed(steps, asked)
    versions = {name: metadata.version(name) for name in ("torch", "torch-geometric")}
    write(asked, rows, differences=found, versions=versions, threads=torch.get_num_threads())


def timed(steps: dict[str, Callable[[], None]], asked: argparse.Namespace) -> list[dict]:
    """Median time of a step over rounds, and the peak memory, of each variant."""
    spent, memory = {name: [] for name in steps}, dict.fromkeys(steps, 0.0)
    for round_ in range(asked.repeats + 1):
        for name, step in steps.items():
            if asked.device != "cpu":
                torch.cuda.reset_peak_memory_stats()
            begin = waited(asked.device)
            for _ in range(STEPS if round_ else WARM_UP):
                step()
            if round_:
                spent[name].append((waited(asked.device) - begin) / STEPS)
            if asked.device != "cpu":
                memory[name] = torch.cuda.max_memory_allocated() / 2**30
    rows = []
    for name, seconds in spent.items():
        step = float(np.median(seconds))
        row = {"variant": name, "batch": asked.batch, "ms_per_step": 1e3 * step, "ms_least": 1e3 * min(seconds),
               "ms_most": 1e3 * max(seconds), "s_per_epoch": step * math.ceil(SAMPLES / asked.batch),
               "times_as_fast_as_torch_geometric": float(np.median(spent["torch-geometric"])) / step}  # fmt: skip
        if memory[name]:
            row["peak_memory_gib"] = memory[name]  # with all that is on the device
        rows.append({key: round(value, 3) if isinstance(value, float) else value for key, value in row.items()})
        print(rows[-1], flush=True)
    return rows


if __name__ == "__main__":
    main()
