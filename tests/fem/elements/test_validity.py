"""Bounds of det dx/dxi over elements, against determinants that are known exactly and against dense samples."""

import numpy as np
import pytest
import warp as wp

from simgen.fem.elements import validity
from simgen.fem.elements.element import TET_EDGES
from simgen.fem.elements.validity import LEVELS, PARTS, bound_of_det_F, is_inside_out
from simgen.fem.precision import mat33
from simgen.geometry.interpolation import geometry_jacobian
from tests.fem.box import lattice

REFERENCE = np.vstack([np.zeros(3), np.eye(3)])  # x(xi) = xi
EVERYWHERE = lattice(24)


@wp.kernel(enable_backward=False)
def verdict_kernel(
    corners: wp.array2d(dtype=mat33), parts: wp.array(dtype=wp.mat44d), levels: wp.int32,
    # outputs
    verdict_out: wp.array(dtype=wp.int32),
):  # fmt: skip
    e = wp.tid()
    A, B, C, D = corners[e, 0], corners[e, 1], corners[e, 2], corners[e, 3]
    verdict_out[e] = wp.where(is_inside_out(A, B, C, D, parts, levels), 1, 0)


@wp.kernel(enable_backward=False)
def bound_kernel(
    deformed: wp.array2d(dtype=mat33), rest: wp.array2d(dtype=mat33), parts: wp.array(dtype=wp.mat44d),
    levels: wp.int32,
    # outputs
    bound_out: wp.array(dtype=wp.float64),
):  # fmt: skip
    e = wp.tid()
    bound_out[e] = bound_of_det_F(
        deformed[e, 0], deformed[e, 1], deformed[e, 2], deformed[e, 3],
        rest[e, 0], rest[e, 1], rest[e, 2], rest[e, 3], parts, levels,
    )  # fmt: skip


def bounds(deformed: np.ndarray, rest: np.ndarray, levels: int = LEVELS) -> np.ndarray:
    """(e,) bounds of det F in elements (e, 10, 3)."""
    corners = [geometry_jacobian(each[:, None], np.eye(4)[None]) for each in (deformed, rest)]
    out = wp.zeros(len(deformed), dtype=wp.float64, device="cpu")
    inputs = [*(wp.array(each, dtype=mat33, device="cpu") for each in corners),
              wp.array(PARTS, dtype=wp.mat44d, device="cpu"), levels]  # fmt: skip
    wp.launch(bound_kernel, dim=len(deformed), inputs=inputs, outputs=[out], device="cpu")
    return out.numpy()


def inside_out(elements: np.ndarray, levels: int = LEVELS) -> np.ndarray:
    """(e,) bool of elements (e, 10, 3)."""
    corners = geometry_jacobian(elements[:, None], np.eye(4)[None])
    parts = wp.array(PARTS, dtype=wp.mat44d, device="cpu")
    out = wp.zeros(len(elements), dtype=wp.int32, device="cpu")
    inputs = [wp.array(corners, dtype=mat33, device="cpu"), parts, levels]
    wp.launch(verdict_kernel, dim=len(elements), inputs=inputs, outputs=[out], device="cpu")
    return out.numpy() == 1


def with_dip(least: float, at: float) -> np.ndarray:
    """The element (10, 3) of x = (least xi_1 + (xi_1 - at) xi_3, xi_2, xi_3 - (xi_1 - at)^2 / 2).

    det dx/dxi = least + xi_3 + (xi_1 - at)^2: it is ``least`` at xi_1 = at on the face xi_3 = 0, and larger elsewhere.
    """
    a, b, c = np.vstack([REFERENCE, REFERENCE[TET_EDGES].mean(axis=1)]).T
    return np.column_stack([least * a + (a - at) * c, b, c - 0.5 * (a - at) ** 2])


def determinants(elements: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """(e, point)."""
    return np.linalg.det(geometry_jacobian(elements[:, None], barycentric[None]))


def test_an_element_that_is_inverted_between_twenty_valid_points_is_found():
    element = with_dip(-0.005, at=0.5)[None]
    assert determinants(element, lattice(3)).min() == pytest.approx(1.0 / 36.0 - 0.005)
    assert determinants(element, np.array([[0.25, 0.5, 0.25, 0.0]]))[0, 0] == pytest.approx(-0.005)
    assert inside_out(element).all()


def test_an_element_that_is_barely_valid_is_accepted_after_divisions():
    """The first bound, of the undivided element, is negative: (0 - 0.37) (1 - 0.37) is a coefficient of the square."""
    element = with_dip(0.006, at=0.37)[None]
    assert inside_out(element, levels=0).all() and not inside_out(element).any()
    assert inside_out(with_dip(-1e-9, at=0.37)[None]).all()  # no value that was looked at says so: undecided


def test_straight_elements_are_decided_by_their_volume():
    straight = np.vstack([REFERENCE, REFERENCE[TET_EDGES].mean(axis=1)])
    flat, mirrored, unknown = straight * [1.0, 1.0, 0.0], straight * [1.0, -1.0, 1.0], np.full_like(straight, np.nan)
    found = inside_out(np.array([straight, 1e-3 * straight, flat, mirrored, unknown]), levels=0)
    assert found.tolist() == [False, False, True, True, True]


def test_the_parts_tile_the_element():
    volumes = np.abs(np.linalg.det(PARTS))
    np.testing.assert_allclose(volumes, 1.0 / 8.0)
    points = np.random.default_rng(3).dirichlet(np.ones(4), size=200)
    inside = (np.linalg.solve(np.swapaxes(PARTS, 1, 2)[None], points[:, None, :, None])[..., 0] > 0.0).all(axis=2)
    assert (inside.sum(axis=1) == 1).all()


def test_no_random_element_that_is_inverted_anywhere_is_accepted():
    """Against 2,925 points of each element; those that the bound flags and no point shows are near zero somewhere."""
    random = np.random.default_rng(7)
    straight = np.vstack([REFERENCE, REFERENCE[TET_EDGES].mean(axis=1)])
    elements = straight + random.uniform(0.02, 0.14, size=(2000, 1, 1)) * random.normal(size=(2000, 10, 3))
    least = determinants(elements, EVERYWHERE).min(axis=1)
    found, undivided = inside_out(elements), inside_out(elements, levels=0)
    assert found[least <= 0.0].all() and 300 < np.count_nonzero(least <= 0.0) < 1700
    assert np.count_nonzero(found & (least > 0.0)) < 0.01 * len(elements)
    assert least[found & (least > 0.0)].max(initial=0.0) < 0.02
    assert (found <= undivided).all() and np.count_nonzero(undivided) > np.count_nonzero(found)


def test_more_divisions_flag_less_and_never_what_is_valid_before():
    elements = np.array([with_dip(10.0**-k, at=0.37) for k in range(1, 6)])
    flagged = [np.count_nonzero(inside_out(elements, levels)) for levels in range(validity.LEVELS + 2)]
    assert flagged == sorted(flagged, reverse=True) and flagged[0] > flagged[-1]


def test_the_bound_of_det_F_is_below_every_value_and_close_where_it_matters():
    """Curved rest elements. Where det F falls below 0.3, the bound is sharp; against 2,925 points of each element."""
    random = np.random.default_rng(11)
    straight = np.vstack([REFERENCE, REFERENCE[TET_EDGES].mean(axis=1)])
    rest = straight + 0.02 * random.normal(size=(1000, 10, 3))
    deformed = rest + random.uniform(0.02, 0.14, size=(1000, 1, 1)) * random.normal(size=(1000, 10, 3))
    least = (determinants(deformed, EVERYWHERE) / determinants(rest, EVERYWHERE)).min(axis=1)
    found = bounds(deformed, rest)
    assert (found < least + 1e-12).all()
    np.testing.assert_array_equal(found <= 0.0, inside_out(deformed))
    low = (least > 0.02) & (least < 0.25)
    assert low.sum() > 50 and (least - found)[low].max() < 0.06
    np.testing.assert_array_less(bounds(deformed, rest, levels=0), found + 1e-12)


def test_a_uniform_stretch_has_its_own_determinant():
    rest = with_dip(0.5, at=0.5)[None]
    np.testing.assert_allclose(bounds(rest * [1.0, 0.5, 0.9], rest), [0.45], rtol=1e-12)
