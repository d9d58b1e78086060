"""Forces and the tangent's action of an element in eight environments at once, by a CPU's vector instructions.

Each step of the element's kernel is a loop over eight neighbouring environments here. Its body calls the functions that
the kernel for one environment calls, so that a formula exists once. The compiler turns the loops into operations on
vectors of eight numbers. Results have the same bytes as those of one environment after the other.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import Scalars, SingleVectors, Vectors
from simgen.fem.elements.element_fields import corner_gradients, interpolate, scatter_gradients
from simgen.fem.elements.solid import SingleSolid, Solid
from simgen.fem.groups import EACH, WIDTH

wp.set_module_options({"enable_backward": False})

_CORNERS = """_Pragma("clang loop unroll(full)") for (int k = 0; k < 4; ++k)"""

# Names that the code below shares. Environments of arrays begin with the group's first one, so that the compiler sees
# neighbours in environments 0, 1, ...
_TOOLS = """
    constexpr int WIDTH = {width};
    typedef {number} Number;
    typedef wp::mat_t<3, 3, Number> Matrix;
    typedef wp::vec_t<4, Number> Corners;
    typedef Number Matrices[4][9][WIDTH];  // one for each corner
    typedef Number Numbers[4][WIDTH];
    s.weight.data += first;
    const auto keep = [](Number (&to)[9][WIDTH], int l, const Matrix& A) {{
        for (int i = 0; i < 9; ++i) to[i][l] = A.data[i / 3][i % 3];
    }};
    const auto kept = [](const Number (&from)[9][WIDTH], int l) {{
        Matrix A;
        for (int i = 0; i < 9; ++i) A.data[i / 3][i % 3] = from[i][l];
        return A;
    }};
    const auto mean = [&](const Corners& shapes, const Matrices& of, int l) {{
        return {interpolate}(shapes, kept(of[0], l), kept(of[1], l), kept(of[2], l), kept(of[3], l));
    }};
    const auto mean_number = [](const Corners& shapes, const Numbers& of, int l) {{
        return wp::dot(shapes, Corners(of[0][l], of[1][l], of[2][l], of[3][l]));
    }};
    const auto pressure = [&](const wp::array_t<Number>& x, int k) {{
        return x.data + size_t(s.first_pressure + s.tetrahedra.data[10 * e + k]) * x.shape[1];
    }};
    const auto gather = [&](const wp::array_t<Number>& x, Matrices& gradients, Numbers& pressures) {{
        {each} {{
            Matrix A, B, C, D;
            {corner_gradients}(s.tetrahedra, x, e, l, A, B, C, D);
            keep(gradients[0], l, A); keep(gradients[1], l, B); keep(gradients[2], l, C); keep(gradients[3], l, D);
            {corners} pressures[k][l] = pressure(x, k)[l];
        }}
    }};
    const auto add = [](const Corners& weights, const Matrix& P, Number constraint, int l,
                        Matrices& stresses, Numbers& constraints) {{
        {corners} {{
            for (int i = 0; i < 9; ++i) stresses[k][i][l] += weights[k] * P.data[i / 3][i % 3];
            constraints[k][l] += constraint * weights[k];
        }}
    }};
    const auto scatter = [&](const Matrices& gradients, Matrices& stresses, Numbers& constraints,
                             wp::array_t<Number>& out) {{
        bool stabilised = false;
        for (int l = 0; l < WIDTH; ++l) stabilised |= s.weight.data[size_t(e) * s.weight.shape[1] + l] > 0.0f;
        if (stabilised) {each} {{
            Matrix A, B, C, D;
            {stabilise}(s, kept(gradients[0], l), kept(gradients[1], l), kept(gradients[2], l), kept(gradients[3], l),
                kept(stresses[0], l), kept(stresses[1], l), kept(stresses[2], l), kept(stresses[3], l), e, l,
                A, B, C, D);
            keep(stresses[0], l, A); keep(stresses[1], l, B); keep(stresses[2], l, C); keep(stresses[3], l, D);
        }}
        for (int l = 0; l < WIDTH; ++l) if (!(chosen >> l & 1)) {corners} {{
            for (int i = 0; i < 9; ++i) stresses[k][i][l] = 0;
            constraints[k][l] = 0;
        }}
        {each} {{
            {scatter_gradients}(s.tetrahedra, kept(stresses[0], l), kept(stresses[1], l), kept(stresses[2], l),
                kept(stresses[3], l), e, l, out);
            {corners} pressure(out, k)[l] += constraints[k][l];
        }}
    }};
    Matrices stresses = {{}};
    Numbers constraints = {{}};
    const int points = s.volumes.shape[1];
"""

_ACTION = """
    s.state.data += first; s.damping.data += first; v.data += first; action.data += first;
    Matrices F, H;
    Numbers p, dp;
    gather(s.state, F, p);
    gather(v, H, dp);
    for (int q = 0; q < points; ++q) {{
        const Corners shapes = s.shapes.data[q], weights = wp::mul(s.volumes.data[e * points + q], shapes);
        {each} {{
            Matrix dP;
            Number constraint;
            {at_point}(s, mean(shapes, F, l), mean(shapes, H, l), mean_number(shapes, p, l),
                mean_number(shapes, dp, l), e, q, l, dP, constraint);
            add(weights, dP, constraint, l, stresses, constraints);
        }}
    }}
    scatter(H, stresses, constraints, action);
"""

_FORCES = """
    x.data += first; residual.data += first;
    Matrices u, F;
    Numbers p;
    Number least[WIDTH];
    gather(x, u, p);
    {corners} {{
        const Matrix rest = s.rest.data[4 * e + k];
        for (int i = 0; i < 9; ++i) {each} F[k][i][l] = rest.data[i / 3][i % 3] + u[k][i][l];
    }}
    for (int l = 0; l < WIDTH; ++l) least[l] = 1e30;
    for (int q = 0; q < points; ++q) {{
        const Corners shapes = s.shapes.data[q], weights = wp::mul(s.volumes.data[e * points + q], shapes);
        {each} {{
            Matrix P;
            Number constraint, J;
            {at_point}(s, mean(shapes, F, l), mean_number(shapes, p, l), e, q, l, P, constraint, J);
            least[l] = wp::min(least[l], J);
            add(weights, P, constraint, l, stresses, constraints);
        }}
    }}
    scatter(u, stresses, constraints, residual);
    for (int l = 0; l < WIDTH; ++l)
        if (chosen >> l & 1) min_det.data[first + l] = wp::min(min_det.data[first + l], least[l]);
"""


def _code(body: str, number: str, at_point: wp.Function, stabilise: wp.Function) -> str:
    functions = (corner_gradients, interpolate, scatter_gradients)
    names = {each.key: each.native_func for each in functions}
    names |= {"at_point": at_point.native_func, "stabilise": stabilise.native_func}
    return (_TOOLS + body).format(width=WIDTH, number=number, each=EACH, corners=_CORNERS, **names)


def make_actions(at_point: wp.Function, stabilise: wp.Function) -> wp.Function:
    """Function that adds the tangent's action of element e in those environments ``first + l`` whose bit l is set."""

    @wp.func_native(_code(_ACTION, "wp::float32", at_point, stabilise))
    def actions(
        s: SingleSolid, v: SingleVectors, e: wp.int32, first: wp.int32, chosen: wp.int32, action: SingleVectors
    ): ...

    return actions


def make_forces(at_point: wp.Function, stabilise: wp.Function) -> wp.Function:
    """Function that adds the forces of element e in the same way, and lowers ``min_det`` to the least det F."""

    @wp.func_native(_code(_FORCES, "wp::float64", at_point, stabilise))
    def forces(
        s: Solid, x: Vectors, e: wp.int32, first: wp.int32, chosen: wp.int32, residual: Vectors, min_det: Scalars
    ): ...

    return forces
