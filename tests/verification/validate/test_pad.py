"""The pad of a GelSight sensor: its mesh, and the case that needs data of others."""

from pathlib import Path

import numpy as np
import pytest

from simgen.geometry.tetrahedra import boundary_triangles
from simgen.verification.validate import pad
from simgen.verification.validate.case import Context


def test_the_quarter_fills_its_block_and_is_fine_around_the_axis():
    mesh = pad.quarter_pad(pad.PadMeshSize(0.8, 2.0, 0.4, 0.8))
    a, b, c, d = (mesh.nodes[mesh.tetrahedra[:, i]] for i in range(4))
    volumes = np.einsum("ei,ei->e", b - a, np.cross(c - a, d - a)) / 6.0
    assert (volumes > 0.0).all()
    assert volumes.sum() == pytest.approx(pad.LENGTH_MM * pad.WIDTH_MM * pad.HEIGHT_MM / pad.QUARTERS)
    along = np.unique(mesh.nodes[: mesh.n_corners, 0].round(9))
    assert np.diff(along)[0] == pytest.approx(0.8, rel=0.1) and np.diff(along)[-1] > 2.0 * np.diff(along)[0]
    assert len(boundary_triangles(mesh.tetrahedra[:, :4])[0]) == len(mesh.faces)


def test_without_measured_forces_the_case_is_skipped_with_the_file_that_is_missing(tmp_path: Path):
    for reference in (None, tmp_path):
        outcome = pad.measured(Context("cpu", reference, None, tmp_path))
        assert not outcome.rows and pad.MEASURED_FILE in outcome.skipped
