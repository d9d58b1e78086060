"""Forces and the tangent's action of an element in eight environments at once, see `simgen.fem.groups`.

Each step of an element is a loop over the environments here, and calls the functions of ``operators.py``.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import Scalars, SingleVectors, Vectors
from simgen.fem.elements.element_fields import corner_gradients, interpolate, scatter_gradients
from simgen.fem.elements.solid import SingleSolid, Solid
from simgen.fem.groups import FOR_EACH, WIDTH

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
    const auto store = [](Number (&to)[9][WIDTH], int l, const Matrix& A) {{
        for (int i = 0; i < 9; ++i) to[i][l] = A.data[i / 3][i % 3];
    }};
    const auto load = [](const Number (&from)[9][WIDTH], int l) {{
        Matrix A;
        for (int i = 0; i < 9; ++i) A.data[i / 3][i % 3] = from[i][l];
        return A;
    }};
    const auto mean = [&](const Corners& shapes, const Matrices& of, int l) {{
        return {interpolate}(shapes, load(of[0], l), load(of[1], l), load(of[2], l), load(of[3], l));
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
            store(gradients[0], l, A); store(gradients[1], l, B); store(gradients[2], l, C); store(gradients[3], l, D);
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
            {stabilise}(s, load(gradients[0], l), load(gradients[1], l), load(gradients[2], l), load(gradients[3], l),
                load(stresses[0], l), load(stresses[1], l), load(stresses[2], l), load(stresses[3], l), e, l,
                A, B, C, D);
            store(stresses[0], l, A); store(stresses[1], l, B); store(stresses[2], l, C); store(stresses[3], l, D);
        }}
        for (int l = 0; l < WIDTH; ++l) if (!(chosen >> l & 1)) {corners} {{
            for (int i = 0; i < 9; ++i) stresses[k][i][l] = 0;
            constraints[k][l] = 0;
        }}
        {each} {{
            {scatter_gradients}(s.tetrahedra, load(stresses[0], l), load(stresses[1], l), load(stresses[2], l),
                load(stresses[3], l), e, l, out);
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
    Number least[WIDTH], gamma[WIDTH];
    gather(x, u, p);
    {each} gamma[l] = {gamma}(s, e, l);
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
            {at_point}(s, mean(shapes, F, l), mean_number(shapes, p, l), gamma[l], e, q, P, constraint, J);
            least[l] = wp::min(least[l], J);
            add(weights, P, constraint, l, stresses, constraints);
        }}
    }}
    scatter(u, stresses, constraints, residual);
    for (int l = 0; l < WIDTH; ++l)
        if (chosen >> l & 1) min_det.data[first + l] = wp::min(min_det.data[first + l], least[l]);
"""


def _code(body: str, number: str, **functions: wp.Function) -> str:
    """C++ code with the names that Warp gives to these functions and to those of an element's fields."""
    fields = {each.key: each for each in (corner_gradients, interpolate, scatter_gradients)}
    names = {name: function.native_func for name, function in {**fields, **functions}.items()}
    return (_TOOLS + body).format(width=WIDTH, number=number, each=FOR_EACH, corners=_CORNERS, **names)


def make_group_action(at_point: wp.Function, stabilise: wp.Function) -> wp.Function:
    """Function that adds the tangent's action of element e in those environments ``first + l`` whose bit l is set."""

    @wp.func_native(_code(_ACTION, "wp::float32", at_point=at_point, stabilise=stabilise))
    def group_action(
        s: SingleSolid, v: SingleVectors, e: wp.int32, first: wp.int32, chosen: wp.int32, action: SingleVectors
    ): ...

    return group_action


def make_group_forces(at_point: wp.Function, gamma: wp.Function, stabilise: wp.Function) -> wp.Function:
    """Function that adds the forces of element e in the same way, and lowers ``min_det`` to the least det F."""

    @wp.func_native(_code(_FORCES, "wp::float64", at_point=at_point, gamma=gamma, stabilise=stabilise))
    def group_forces(
        s: Solid, x: Vectors, e: wp.int32, first: wp.int32, chosen: wp.int32, residual: Vectors, min_det: Scalars
    ): ...

    return group_forces
