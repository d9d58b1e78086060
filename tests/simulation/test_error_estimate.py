"""Error estimates, against errors that are known."""

from dataclasses import replace

import numpy as np
import pytest

from simgen.config.solver_settings import SolverSettings
from simgen.simulation.error_estimate import (
    MOVED_M,
    ORDER,
    add_error_estimates,
    share_of_difference,
    surface_difference,
)
from simgen.simulation.press import PressResult, Scene, press
from simulation.blocks import GEL, SPHERE, make_block, pose


def result(force, displacement) -> PressResult:
    return PressResult({"force": np.array(force), "displacement": np.array(displacement)}, 0.0, 1.0)


def test_an_error_of_the_expected_order_is_found_exactly():
    """Forces and displacements that are off by C N^(-p / 3)."""
    random = np.random.default_rng(2)
    exact, slope = random.normal(size=(2, 3, 40, 3)) * 1e-3
    limit, unknowns = np.array([[0.0, 1.0, 0.0]] * 3), (9_000, 55_000)
    meshes = [result((1.0 + 3.0 * n ** (-ORDER / 3.0)) * limit, exact + slope * n ** (-ORDER / 3.0)) for n in unknowns]
    found = add_error_estimates(meshes[1], meshes[0], share_of_difference(*unknowns))
    off = unknowns[1] ** (-ORDER / 3.0)
    np.testing.assert_allclose(found.force_error_estimate, 3.0 * off / (1.0 + 3.0 * off), rtol=1e-5)
    expected = np.sqrt(((slope * off) ** 2).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(found.surface_error_estimate_m, expected, rtol=1e-5)
    assert found.seconds == 2.0


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
    scenes = [Scene(block, GEL, settings=settings) for block in blocks]
    coarse, mesh, fine = (press(scene, [SPHERE], pose(), depths)[0] for scene in scenes)
    add_error_estimates(mesh, coarse, share_of_difference(scenes[0].unknowns, scenes[1].unknowns))
    true = surface_difference(fine.displacement, mesh.displacement)
    true *= 1.0 + share_of_difference(scenes[1].unknowns, scenes[2].unknowns)  # the fine mesh errs, too
    print("true", (1e6 * true).round(2), "estimated", (1e6 * mesh.surface_error_estimate_m).round(2), "um")
    ratio = true / mesh.surface_error_estimate_m
    assert (ratio > 0.5).all() and (ratio < 2.0).all()
