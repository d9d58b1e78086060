"""Rows of sparse matrices times vectors, for groups of environments on a CPU, see `simgen.fem.groups`.

The code calls functions of kernels for one environment. A kernel must call these first, or Warp does not generate them.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import Indices, SingleVectors
from simgen.fem.blocks import TILE, load
from simgen.fem.groups import FOR_EACH, WIDTH
from simgen.fem.linear_solver.rounded_blocks import rounded_block
from simgen.fem.precision import single

wp.set_module_options({"enable_backward": False})

FOR_EACH_CHOSEN = f"{FOR_EACH} if (chosen >> l & 1)"


def block_row(body: str, vectors: tuple[str, ...], blocks: tuple[str, ...] = ()) -> str:
    """C++ code that computes the residuals ``r(l)`` of block row ``row``, and then runs ``body``.

    vectors, blocks : names of the arrays that ``body`` uses. Their environments begin with the group's first one
    """
    shift = [f"{name}.data += first;" for name in ("x", "b", *vectors)]
    for name in ("blocks", *blocks):
        tile = f"size_t(first / {TILE}) * ({name}.strides[0] / sizeof(*{name}.data))"
        shift.append(f"{name}.data += {tile} + first % {TILE};")
    return f"""
        {" ".join(shift)}
        wp::float32 residuals[3][{WIDTH}];
        {FOR_EACH} {{
            const wp::vec_t<3, wp::float32> own = {load.native_func}(b, row, l);
            for (int i = 0; i < 3; ++i) residuals[i][l] = own[i];
        }}
        for (int k = row_starts.data[row]; k < row_starts.data[row + 1]; ++k) {{
            const int column = columns.data[k];
            {FOR_EACH} {{
                const wp::vec_t<3, wp::float32> product
                    = wp::mul({rounded_block.native_func}(blocks, k, l), {load.native_func}(x, column, l));
                for (int i = 0; i < 3; ++i) residuals[i][l] -= product[i];
            }}
        }}
        const auto r = [&](int l) {{
            return wp::vec_t<3, wp::float32>(residuals[0][l], residuals[1][l], residuals[2][l]);
        }};
        {body}
    """


_SPARSE_ROW = f"""
    const unsigned stride = x.shape[1];
    wp::float32 totals[{WIDTH}] = {{}};
    for (int k = row_starts.data[row]; k < row_starts.data[row + 1]; ++k) {{
        const wp::float32 value = values.data[k];
        const wp::float32* const from = x.data + size_t(columns.data[k]) * stride + first;
        {FOR_EACH} totals[l] += value * from[l];
    }}
    wp::float32* const y = y_out.data + size_t(row) * stride + first;
    {FOR_EACH_CHOSEN} y[l] = totals[l] * factor + (keep ? y[l] : -0.0f);
"""


@wp.func_native(_SPARSE_ROW)
def group_sparse_row(
    row_starts: Indices, columns: Indices, values: wp.array(dtype=wp.float32), x: SingleVectors, factor: single,
    keep: wp.bool, row: wp.int32, first: wp.int32, chosen: wp.int32, y_out: SingleVectors,
): ...  # fmt: skip
