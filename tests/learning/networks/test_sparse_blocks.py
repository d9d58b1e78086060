"""Blocks of a sparse matrix: the same matrix, whose rows share more columns than in any other order nearby."""

import numpy as np
import pytest
import scipy.sparse
import torch

from simgen.config.resources import resource
from simgen.learning.networks.chebyshev import scaled_laplacian
from simgen.learning.networks.hierarchy import build_hierarchy
from simgen.learning.networks.sparse_blocks import COLUMNS, ROWS, SparseBlocks, grouped, tf32

CPU = torch.device("cpu")


def random(rows: int, columns: int, density: float = 0.1) -> scipy.sparse.csr_array:
    rng = np.random.default_rng(0)
    return scipy.sparse.random_array((rows, columns), density=density, rng=rng, format="csr")


def assembled(blocks: SparseBlocks, shape: tuple[int, int]) -> np.ndarray:
    whole = np.zeros((shape[0] + 1, shape[1]))  # what fills the last block up goes to the row below
    for block, rows in enumerate(blocks.rows.tolist()):
        for chunk in range(*blocks.starts[block : block + 2].tolist()):
            np.add.at(whole, np.ix_(rows, blocks.columns[chunk].tolist()), blocks.values[chunk].numpy())
    return whole


@pytest.mark.parametrize("shape", [(70, 50), (64, 200), (5, 3)])
@pytest.mark.parametrize("density", [0.0, 0.02, 0.3])
def test_blocks_are_the_matrix_rounded(shape, density):
    matrix = random(*shape, density)
    whole = assembled(SparseBlocks.of_matrix(matrix, CPU), shape)
    np.testing.assert_array_equal(whole[:-1], tf32(matrix.toarray()))
    assert not whole[-1].any()


def test_every_row_stands_in_one_group():
    matrix = random(100, 60)
    np.testing.assert_array_equal(np.sort(grouped(matrix, 16)), np.arange(100))


def test_rows_of_a_shuffled_chain_are_grouped_along_it():
    """Each row has its own column and the next one: groups of four rows read five columns."""
    place = np.random.default_rng(0).permutation(40)
    chain = scipy.sparse.csr_array(np.eye(40, 41) + np.eye(40, 41, k=1))[place]
    groups = place[grouped(chain, 4)].reshape(-1, 4)
    assert sum(np.ptp(np.sort(group)) == 3 for group in groups) >= 8  # two ends may be left over


@pytest.mark.parametrize("sensor", ["digit", "biotac"])
def test_a_mesh_reads_less_than_five_columns_a_row(sensor):
    """A row has 11 to 12 entries; in the vertices' own order, blocks read 7 to 8 columns a row."""
    with np.load(resource("sensor_models") / sensor / "output.npz") as mesh:
        adjacency = build_hierarchy(mesh["vertices"], mesh["tetrahedra"], levels=2).adjacency[0]
    blocks = SparseBlocks.of_matrix(scaled_laplacian(adjacency), CPU)
    assert adjacency.nnz / adjacency.shape[0] > 11
    assert blocks.columns.numel() / adjacency.shape[0] < 5
    assert blocks.values.shape == (len(blocks.columns), ROWS, COLUMNS)


def test_rounding_is_to_ten_bits():
    values = np.random.default_rng(0).normal(size=1000)
    rounded = tf32(values)
    assert np.abs(rounded / values - 1.0).max() <= 2.0**-11 + 2.0**-24  # and float32's own
    assert not (rounded.view(np.uint32) & 0x1FFF).any()
    np.testing.assert_array_equal(tf32(np.array([0.0, 1.0, -2.5, 1.0 + 2.0**-11])), [0.0, 1.0, -2.5, 1.0 + 2.0**-10])
