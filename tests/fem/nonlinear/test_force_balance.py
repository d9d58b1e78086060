"""The balance of forces on a skin that an indenter presses onto its core."""

import numpy as np
import pytest
import warp as wp

from simgen.sensors.indenter import load_indenter
from simgen.sensors.pairing import indenter_poses, sample_contacts
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, press

DEPTH = 1.9e-3  # m: the skin lies on the core


def test_the_resultant_is_measured_against_the_indenters_load():
    """The core's load is as large, and would hide half of what is out of balance."""
    sensor = load_sensor("biotac", "coarse")
    scene = Scene(sensor, sensor.materials["solid"])
    pose = indenter_poses(sample_contacts(sensor, 1, 1, DEPTH))
    [result] = press(scene, [load_indenter("sphere_7mm").shape()], pose, [DEPTH])
    solver, balance = scene.solver, scene.solver.balance
    measured = balance.measure(solver.x)
    loads = []
    for contact in solver.contacts:
        alone = wp.zeros_like(balance.surface)
        contact.residual(solver.x, alone)
        loads.append(np.linalg.norm(alone.numpy()[: 3 * len(scene.nodes), 0].reshape(-1, 3), axis=1).sum())
    assert len(loads) == 2 and loads[1] > 0.5 * loads[0]
    n_u = solver.elasticity.n_displacements
    residual = balance.residual.numpy()[:n_u, 0].reshape(-1, 3).sum(axis=0)
    assert measured.imbalance[0] == pytest.approx(np.linalg.norm(residual) / loads[0], rel=1e-6)
    assert measured.imbalance[0] <= solver.settings.residual_tolerance
    force = np.linalg.norm(result.force[-1]) / (scene.material.youngs_modulus_pa * 1e-6)
    expected = measured.imbalance[0] * loads[0] / force
    assert result.certificate["force_balance"][-1] == pytest.approx(expected, rel=1e-3)
