"""Tangent as 3 x 3 blocks between corners, between all nodes, and of each node with itself, in single precision.

``multigrid`` and ``factor`` build preconditioners from these blocks.
"""

from __future__ import annotations

from functools import cache

import warp as wp

from simgen.fem.blocks import Blocks, add_block
from simgen.fem.device import large_kernel
from simgen.fem.elements.element_fields import corner_gradients, corner_pressures, edge_gradient, interpolate
from simgen.fem.elements.solid import SingleSolid, gradient_metric, make_modulus
from simgen.fem.material.law import Law, law_module
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.fem.precision import mat33f, single, vec3f

wp.set_module_options({"enable_backward": False})


# Per GPU thread. The bound doubles the number of warps under way: on an H200 a tangent of eight points took 0.72 ms for
# 256 presses instead of 0.86 (0.84 with 96 registers). In double precision the bound costs more than it gains.
REGISTERS = 128


@wp.func
def add_pair(
    blocks: Blocks,
    block_index: wp.array3d(dtype=wp.int32),
    e: wp.int32,
    a: wp.int32,
    b: wp.int32,
    env: wp.int32,
    K: mat33f,
):
    add_block(blocks, block_index[e, a, b], env, K)
    add_block(blocks, block_index[e, b, a], env, wp.transpose(K))


@wp.func
def times_identity(value: single) -> mat33f:
    return wp.diag(vec3f(value, value, value))


@wp.func
def gradient_deviation(a: wp.int32, corner: wp.int32) -> vec3f:
    """Gradient by xi of node a's quadratic shape function at a corner, minus its mean over the element."""
    i, j = a, a
    if a >= 4:
        i, j = (a - 4) % 3, (a - 3) % 3  # edges 01, 12, 20
        if a >= 7:
            i, j = a - 7, 3  # edges 03, 13, 23
    at, middle = wp.vec4f(), wp.vec4f(0.25, 0.25, 0.25, 0.25)
    at[corner] = 1.0
    return edge_gradient(at, i, j) - edge_gradient(middle, i, j)


@wp.func
def deviation_product(a: wp.int32, b: wp.int32, G: mat33f) -> single:
    """Stiffness between nodes a and b from the stabilisation's strain gradient."""
    total = single(0.0)
    for corner in range(4):
        total += wp.dot(gradient_deviation(a, corner), G * gradient_deviation(b, corner))
    return total


@wp.func
def add_own_deviation(
    s: SingleSolid, e: wp.int32, a: wp.int32, G: mat33f, env: wp.int32, diagonal: Blocks
):
    add_block(diagonal, s.tetrahedra[e, a], env, times_identity(deviation_product(a, a, G)))


@cache
def block_kernels(law: type[Law]) -> tuple[wp.Kernel, wp.Kernel, wp.Kernel]:
    """Kernels of a law's tangent as blocks: between corners, between all nodes, of each node with itself."""
    module, modulus = law_module(__name__, law), make_modulus(law)

    @wp.kernel(module=module, cuda_max_registers=REGISTERS)
    def corner_blocks_kernel(
        s: SingleSolid,
        active: wp.array(dtype=wp.int32),
        block_index: wp.array3d(dtype=wp.int32),
        # outputs
        blocks_out: Blocks,
    ):
        """Gradients of linear shape functions are the axes of xi, and minus their sum for corner 0."""
        e, lane = wp.tid()
        env = active[lane]
        if env < 0:
            return
        Fa, Fb, Fc, Fd = corner_gradients(s.tetrahedra, s.state, e, env)
        pressures = corner_pressures(s.tetrahedra, s.state, s.first_pressure, e, env)
        x, y, z = vec3f(1.0, 0.0, 0.0), vec3f(0.0, 1.0, 0.0), vec3f(0.0, 0.0, 1.0)
        K11, K12, K13 = mat33f(), mat33f(), mat33f()
        K22, K23, K33 = mat33f(), mat33f(), mat33f()
        for q in range(s.volumes.shape[1]):
            shapes = s.shapes[q]
            m = modulus(s, interpolate(shapes, Fa, Fb, Fc, Fd), wp.dot(shapes, pressures), e, q, env)
            volume = s.volumes[e, q]
            K11 += volume * law.block(x, x, m)
            K12 += volume * law.block(x, y, m)
            K13 += volume * law.block(x, z, m)
            K22 += volume * law.block(y, y, m)
            K23 += volume * law.block(y, z, m)
            K33 += volume * law.block(z, z, m)
        K10 = -(K11 + K12 + K13)
        K20 = -(wp.transpose(K12) + K22 + K23)
        K30 = -(wp.transpose(K13) + wp.transpose(K23) + K33)
        add_block(blocks_out, block_index[e, 0, 0], env, -(K10 + K20 + K30))
        add_block(blocks_out, block_index[e, 1, 1], env, K11)
        add_block(blocks_out, block_index[e, 2, 2], env, K22)
        add_block(blocks_out, block_index[e, 3, 3], env, K33)
        add_pair(blocks_out, block_index, e, 1, 0, env, K10)
        add_pair(blocks_out, block_index, e, 2, 0, env, K20)
        add_pair(blocks_out, block_index, e, 3, 0, env, K30)
        add_pair(blocks_out, block_index, e, 1, 2, env, K12)
        add_pair(blocks_out, block_index, e, 1, 3, env, K13)
        add_pair(blocks_out, block_index, e, 2, 3, env, K23)

    @wp.kernel(module=module)
    def blocks_kernel(
        s: SingleSolid,
        gradients: wp.array2d(dtype=vec3f),
        active: wp.array(dtype=wp.int32),
        block_index: wp.array3d(dtype=wp.int32),
        # outputs
        blocks_out: Blocks,
    ):
        """Blocks between all nodes; ``gradients`` (q, nodes) are those of the shape functions by xi."""
        e, lane = wp.tid()
        env = active[lane]
        if env < 0:
            return
        Fa, Fb, Fc, Fd = corner_gradients(s.tetrahedra, s.state, e, env)
        pressures = corner_pressures(s.tetrahedra, s.state, s.first_pressure, e, env)
        for q in range(s.volumes.shape[1]):
            shapes = s.shapes[q]
            m = modulus(s, interpolate(shapes, Fa, Fb, Fc, Fd), wp.dot(shapes, pressures), e, q, env)
            for a in range(gradients.shape[1]):
                for b in range(gradients.shape[1]):
                    K = law.block(gradients[q, a], gradients[q, b], m)
                    add_block(blocks_out, block_index[e, a, b], env, s.volumes[e, q] * K)
        weight = s.weight[e, env]
        if weight > single(0.0):
            G = gradient_metric(s.mean_metric[e], weight)
            for a in range(gradients.shape[1]):
                for b in range(gradients.shape[1]):
                    add_block(blocks_out, block_index[e, a, b], env, times_identity(deviation_product(a, b, G)))

    @large_kernel(cpu_module=law_module(__name__, law, "cpu"), cuda_max_registers=REGISTERS)
    def diagonal_kernel(
        s: SingleSolid,
        active: wp.array(dtype=wp.int32),
        # outputs
        diagonal_out: Blocks,
    ):
        """Quadratic shape functions have gradients that are multiples of the corners', or sums of two."""
        e, lane = wp.tid()
        env = active[lane]
        if env < 0:
            return
        Fa, Fb, Fc, Fd = corner_gradients(s.tetrahedra, s.state, e, env)
        pressures = corner_pressures(s.tetrahedra, s.state, s.first_pressure, e, env)
        Ka, Kb, Kc, Kd = mat33f(), mat33f(), mat33f(), mat33f()
        Kab, Kbc, Kca = mat33f(), mat33f(), mat33f()
        Kad, Kbd, Kcd = mat33f(), mat33f(), mat33f()
        for q in range(s.volumes.shape[1]):
            shapes = s.shapes[q]
            m = modulus(s, interpolate(shapes, Fa, Fb, Fc, Fd), wp.dot(shapes, pressures), e, q, env)
            volume = s.volumes[e, q]
            Ka += law.own_block(edge_gradient(shapes, 0, 0), m, volume)
            Kb += law.own_block(edge_gradient(shapes, 1, 1), m, volume)
            Kc += law.own_block(edge_gradient(shapes, 2, 2), m, volume)
            Kd += law.own_block(edge_gradient(shapes, 3, 3), m, volume)
            Kab += law.own_block(edge_gradient(shapes, 0, 1), m, volume)
            Kbc += law.own_block(edge_gradient(shapes, 1, 2), m, volume)
            Kca += law.own_block(edge_gradient(shapes, 2, 0), m, volume)
            Kad += law.own_block(edge_gradient(shapes, 0, 3), m, volume)
            Kbd += law.own_block(edge_gradient(shapes, 1, 3), m, volume)
            Kcd += law.own_block(edge_gradient(shapes, 2, 3), m, volume)
        add_block(diagonal_out, s.tetrahedra[e, 0], env, Ka)
        add_block(diagonal_out, s.tetrahedra[e, 1], env, Kb)
        add_block(diagonal_out, s.tetrahedra[e, 2], env, Kc)
        add_block(diagonal_out, s.tetrahedra[e, 3], env, Kd)
        add_block(diagonal_out, s.tetrahedra[e, 4], env, Kab)
        add_block(diagonal_out, s.tetrahedra[e, 5], env, Kbc)
        add_block(diagonal_out, s.tetrahedra[e, 6], env, Kca)
        add_block(diagonal_out, s.tetrahedra[e, 7], env, Kad)
        add_block(diagonal_out, s.tetrahedra[e, 8], env, Kbd)
        add_block(diagonal_out, s.tetrahedra[e, 9], env, Kcd)
        weight = s.weight[e, env]
        if weight > single(0.0):
            G = gradient_metric(s.mean_metric[e], weight)
            for a in range(10):
                add_own_deviation(s, e, a, G, env, diagonal_out)

    return corner_blocks_kernel, blocks_kernel, diagonal_kernel


block_kernels(NeoHookean)
