"""Triton kernels of graph convolutions in TF32. Torch's builds for GPUs on Linux bring Triton along.

Features are tensors (vertex, feature, sample), as in `simgen.learning.networks.chebyshev`. Kernels read each of them
once, or from a cache. A CUDA graph may hold them, if they ran once before: their first run compiles them.
"""

import triton
import triton.language as tl
from torch import Tensor

from simgen.learning.networks.sparse_blocks import SparseBlocks

SAMPLES = 128  # of a program
LEAST = 16  # rows and columns of the smallest matrices that `tl.dot` takes
OUTPUTS = 32  # of a program of `filtered`
SUMMED = 32  # samples that a program of `correlated` reads at a time
PARTS = 528  # partial sums of `correlated`: four for each multiprocessor of an H200


def multiply_blocks(blocks: SparseBlocks, count: int, dense: Tensor, out: Tensor, add: bool = False) -> None:
    """Compute out = matrix @ dense, or out += matrix @ dense, for a matrix of ``count`` rows."""
    (number, rows), columns, n = blocks.rows.shape, blocks.columns.shape[1], dense.shape[1]
    grid = (number, triton.cdiv(n, SAMPLES))  # all rows of some samples one after another: these samples stay in caches
    _multiply[grid](blocks.rows, blocks.starts, blocks.columns, blocks.values, dense, out, count, n,
                    dense.stride(0), out.stride(0), add, rows, columns, SAMPLES, num_warps=2)  # fmt: skip


def filtered(x: Tensor, powers: Tensor, weight: Tensor, rows: int, bias: Tensor | None = None,
             relu: bool = False) -> Tensor:  # fmt: skip
    """See `simgen.learning.networks.chebyshev.filtered`."""
    (_, inputs, samples), (count, outputs, _) = x.shape, weight.shape
    y = x.new_empty(rows, outputs, samples)
    some, width = _padded(min(samples, SAMPLES)), _padded(min(outputs, OUTPUTS))
    grid = (rows, triton.cdiv(outputs, width), triton.cdiv(samples, some))
    _filter[grid](x, powers, weight, y if bias is None else bias, y, samples, *weight.stride(), inputs, outputs, count,
                  bias is not None, relu, _padded(inputs), width, some)  # fmt: skip
    return y


def correlated(x: Tensor, powers: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """See `simgen.learning.networks.chebyshev.correlated`."""
    (vertices, features, samples), others = other.shape[:1] + x.shape[1:], other.shape[1]
    further = powers.shape[1] * features
    size = (features + further) * others
    parts = x.new_empty(PARTS, size + features)
    _correlate[(PARTS,)](x, powers, other, parts, vertices, samples, features, further, others,
                         _padded(features), _padded(further), _padded(others), SUMMED, num_stages=3)  # fmt: skip
    products, sums = parts.sum(dim=0).split([size, features])
    return products.view(-1, features, others), sums


def _padded(size: int) -> int:
    return max(LEAST, triton.next_power_of_2(size))


@triton.jit
def _rounded(x):
    """x to the nearest value of TF32. `tl.dot` would cut bits off, which makes all products too small."""
    return ((x.to(tl.int32, bitcast=True) + 0x1000) & -0x2000).to(tl.float32, bitcast=True)


@triton.jit
def _multiply(
    rows, starts, columns, values, dense, out, count, n, dense_stride, out_stride,
    ADD: tl.constexpr, ROWS: tl.constexpr, COLUMNS: tl.constexpr, N: tl.constexpr,
):  # fmt: skip
    """One block of rows times N columns of ``dense``."""
    block = tl.program_id(0)
    at = tl.program_id(1) * N + tl.arange(0, N)[None, :]
    in_block, in_chunk = tl.arange(0, ROWS), tl.arange(0, COLUMNS)
    row = tl.load(rows + block * ROWS + in_block)[:, None]
    to = out + row.to(tl.int64) * out_stride + at
    inside = (row < count) & (at < n)
    total = tl.zeros([ROWS, N], tl.float32)
    if ADD:
        total += tl.load(to, mask=inside, other=0.0)
    for chunk in range(tl.load(starts + block), tl.load(starts + block + 1)):
        column = tl.load(columns + chunk * COLUMNS + in_chunk)[:, None]
        weight = tl.load(values + (chunk * ROWS + in_block[:, None]) * COLUMNS + in_chunk[None, :])
        source = tl.load(dense + column.to(tl.int64) * dense_stride + at, mask=at < n, other=0.0)
        total = tl.dot(weight, _rounded(source), total, input_precision="tf32")
    tl.store(to, total, mask=inside)


@triton.jit
def _filter(
    x, powers, weight, bias, y, samples, of_power, of_output, of_input,
    INPUTS: tl.constexpr, OUTPUTS: tl.constexpr, COUNT: tl.constexpr, BIAS: tl.constexpr, RELU: tl.constexpr,
    I: tl.constexpr, O: tl.constexpr, S: tl.constexpr,
):  # fmt: skip
    """O outputs of one vertex for S samples."""
    vertex = tl.program_id(0).to(tl.int64)
    o, i = tl.program_id(1) * O + tl.arange(0, O)[:, None], tl.arange(0, I)
    s = tl.program_id(2) * S + tl.arange(0, S)[None, :]
    known = (i[:, None] < INPUTS) & (s < samples)
    from_x = i[:, None] * samples + s
    of_weight = weight + o * of_output + i[None, :] * of_input
    in_weight = (o < OUTPUTS) & (i[None, :] < INPUTS)
    w = tl.load(of_weight, mask=in_weight, other=0.0)
    source = tl.load(x + vertex * INPUTS * samples + from_x, mask=known, other=0.0)
    total = tl.dot(_rounded(w), _rounded(source), input_precision="tf32")
    first = powers + vertex * (COUNT - 1) * INPUTS * samples + from_x
    for power in range(COUNT - 1):
        w = tl.load(of_weight + (power + 1) * of_power, mask=in_weight, other=0.0)
        source = tl.load(first + power * INPUTS * samples, mask=known, other=0.0)
        total = tl.dot(_rounded(w), _rounded(source), total, input_precision="tf32")
    if BIAS:
        total += tl.load(bias + o, mask=o < OUTPUTS, other=0.0)
    if RELU:
        total = tl.maximum(total, 0.0)
    tl.store(y + (vertex * OUTPUTS + o) * samples + s, total, mask=(o < OUTPUTS) & (s < samples))


@triton.jit
def _correlate(
    x, powers, other, parts, vertices, samples,
    FEATURES: tl.constexpr, FURTHER: tl.constexpr, OTHERS: tl.constexpr,
    F: tl.constexpr, P: tl.constexpr, G: tl.constexpr, S: tl.constexpr,
):  # fmt: skip
    """A partial sum, over every so many vertices and S samples."""
    part = tl.program_id(0)
    f, p, g, s = tl.arange(0, F)[:, None], tl.arange(0, P)[:, None], tl.arange(0, G)[:, None], tl.arange(0, S)[None, :]
    of_x, of_powers, total = tl.zeros([F, G], tl.float32), tl.zeros([P, G], tl.float32), tl.zeros([F, S], tl.float32)
    pieces = tl.cdiv(samples, S)
    for piece in range(part, vertices * pieces, tl.num_programs(0)):
        vertex, at = (piece // pieces).to(tl.int64), (piece % pieces) * S + s
        inside = at < samples
        a = tl.load(x + (vertex * FEATURES + f) * samples + at, mask=(f < FEATURES) & inside, other=0.0)
        b = tl.load(powers + (vertex * FURTHER + p) * samples + at, mask=(p < FURTHER) & inside, other=0.0)
        c = tl.load(other + (vertex * OTHERS + g) * samples + at, mask=(g < OTHERS) & inside, other=0.0).T
        # Not rounded, which takes time: Adam does not see a common factor of the gradient.
        of_x = tl.dot(a, c, of_x, input_precision="tf32")
        of_powers = tl.dot(b, c, of_powers, input_precision="tf32")
        total += a
    size = (FEATURES + FURTHER) * OTHERS
    to = parts + part * (size + FEATURES)
    tl.store(to + f * OTHERS + g.T, of_x, mask=(f < FEATURES) & (g.T < OTHERS))
    tl.store(to + (FEATURES + p) * OTHERS + g.T, of_powers, mask=(p < FURTHER) & (g.T < OTHERS))
    tl.store(to + size + tl.arange(0, F), tl.sum(total, 1), mask=tl.arange(0, F) < FEATURES)
