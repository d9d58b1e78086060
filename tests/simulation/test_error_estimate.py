"""Error estimates, against errors that are known."""

from dataclasses import replace

import numpy as np
import pytest

from simgen.config.solver_settings import SolverSettings
from simgen.simulation.error_estimate import (
    ENERGY_FACTOR,
    MOVED_M,
    ORDER,
    force_error_estimate,
    share_of_difference,
    surface_difference,
    surface_error_estimate,
)
from simgen.simulation.press import Scene, press
from simulation.blocks import GEL, SPHERE, make_block, pose


def test_an_error_of_the_expected_order_is_found_exactly():
    """Displacements that are off by C N^(-p / 3)."""
    exact, slope = np.random.default_rng(2).normal(size=(2, 3, 40, 3)) * 1e-3
    unknowns = (9_000, 55_000)
    coarser, own = (exact + slope * n ** (-ORDER / 3.0) for n in unknowns)
    found = surface_error_estimate(own, coarser, share_of_difference(*unknowns))
    expected = unknowns[1] ** (-ORDER / 3.0) * np.sqrt((slope**2).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_the_force_is_off_by_the_slope_of_the_energy():
    """Energy C s^2 over the travel s, along a path that turns: central differences are exact."""
    path = np.array([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 2.0, 0.5], [0.0, 2.0, 1.5]]) * 1e-4
    travel = np.array([1.0, 2.0, 2.5, 3.5]) * 1e-4
    force = np.array([[0.0, 2.0, 0.0]] * 4)
    found = force_error_estimate(3.0 * travel**2, force, path)
    spans = np.array([[0.0, 2.0], [1.0, 2.5], [2.0, 3.5], [2.5, 3.5]]) * 1e-4  # the last one looks back only
    np.testing.assert_allclose(found, ENERGY_FACTOR * 3.0 * spans.sum(axis=1) / 2.0, rtol=1e-6)


def test_no_force_error_where_a_press_ended_or_only_turns():
    path = np.array([[0.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.0, 3.0, 0.0]]) * 1e-4
    found = force_error_estimate(np.array([1.0, 2.0, np.nan]), np.ones((3, 3)), path)
    assert np.isfinite(found[:2]).all() and np.isnan(found[2])
    turning = np.tile(path[0], (4, 1))
    assert np.isnan(force_error_estimate(np.arange(1.0, 5.0), np.ones((4, 3)), turning)[2:]).all()


def test_only_vertices_that_move_count_and_what_is_missing_stays_missing():
    b = np.zeros((3, 2, 3))
    b[0, 0, 1] = 10 * MOVED_M
    a = b.copy()
    a[..., 2] += MOVED_M
    b[2] = np.nan
    np.testing.assert_allclose(surface_difference(a, b), [MOVED_M, 0.0, np.nan])


@pytest.mark.slow
def test_the_true_error_of_a_press_is_within_a_factor_of_two():
    """A sphere on a block. The truth is extrapolated from a mesh with three fifths of the edges."""
    settings, depths = SolverSettings(contact_tolerance=5e-3), np.array([0.25, 0.5]) * 1e-3
    output = make_block((6, 3, 6)).output_mesh
    blocks = [replace(make_block(counts), output_mesh=output) for counts in ((8, 4, 8), (14, 6, 14), (24, 10, 24))]
    scenes = [Scene(block, GEL, settings=settings, outputs=("error_energy",)) for block in blocks]
    coarse, mesh, fine = (press(scene, [SPHERE], pose(), depths)[0] for scene in scenes)
    share, of_fine = (share_of_difference(scenes[i].unknowns, scenes[i + 1].unknowns) for i in range(2))
    surface = surface_error_estimate(mesh.displacement, coarse.displacement, share)
    true = (1.0 + of_fine) * surface_difference(fine.displacement, mesh.displacement)  # the fine mesh errs, too
    size, limit = (np.linalg.norm(each.force, axis=1) for each in (mesh, fine))
    true_force = (1.0 + of_fine) * (size - limit) / size
    print("surface", (1e6 * true).round(2), (1e6 * surface).round(2), "um")
    print("force", (100.0 * true_force).round(2), (100.0 * mesh.force_error_estimate).round(2), "%")
    assert (true > 0.5 * surface).all() and (true < 2.0 * surface).all()
    assert (np.abs(true_force) < 2.0 * mesh.force_error_estimate).all()  # friction's error may cancel the mesh's
    assert np.abs(true_force).max() > 0.5 * mesh.force_error_estimate.max()
