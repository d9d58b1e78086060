"""Time series for ParaView, read back by VTK's own reader."""

import numpy as np
import pytest
import pyvista

from simgen.dataset.exchange.exporting import export
from simgen.sensors.indenter import load_indenter


@pytest.fixture(scope="module")
def folder(one_sided, tmp_path_factory):
    folder = tmp_path_factory.mktemp("vtk") / "out"
    export(one_sided, "vtk", folder, trajectories="1")
    return folder


def series(path):
    """Time (mm) and mesh of each entry."""
    reader = pyvista.get_reader(path)
    for time in reader.time_values:
        reader.set_active_time_value(time)
        yield time, reader.read()[0]


def test_samples_inside_out_are_left_out(ending, tmp_path):
    export(ending, "vtk", tmp_path / "out", trajectories="0")
    times = [time for time, _ in series(tmp_path / "out/trajectory_0/texture_14mm/digit.pvd")]
    np.testing.assert_allclose(times, 1e3 * ending["depth"][[0, 2, 3]])


def press_of(dataset, trajectory, indenter):
    at = (dataset["press/trajectory"] == trajectory) & (dataset["press/indenter"] == indenter)
    return int(np.flatnonzero(at)[0])


@pytest.mark.parametrize("sensor", ["digit", "biotac"])
def test_a_sensor_in_the_shared_frame(one_sided, folder, sensor):
    press, pose = press_of(one_sided, 1, 2), one_sided[f"{sensor}/pose"][press_of(one_sided, 1, 2)]
    found = list(series(folder / f"trajectory_1/texture_14mm/{sensor}.pvd"))
    np.testing.assert_allclose([time for time, _ in found], 1e3 * one_sided["depth"])
    rest = one_sided[f"{sensor}/rest_positions"]
    for step, (_, mesh) in enumerate(found):
        moved = one_sided.displacement(sensor, press, step)
        np.testing.assert_array_equal(mesh.points, (rest + moved) @ pose[:3, :3].T + pose[:3, 3])
        np.testing.assert_array_equal(mesh["displacement"], moved @ pose[:3, :3].T)
        np.testing.assert_array_equal(mesh.cells_dict[pyvista.CellType.TETRA], one_sided[f"{sensor}/tetrahedra"])
        for flag in ("held", "touchable"):
            np.testing.assert_array_equal(mesh[flag] > 0, one_sided[f"{sensor}/{flag}"])
        force = pose[:3, :3] @ one_sided[f"{sensor}/force"][press, step]
        np.testing.assert_array_equal(mesh.field_data["force_N"].ravel(), force)


def test_the_indenter_is_where_it_presses(one_sided, folder):
    press = press_of(one_sided, 1, 0)
    shape = load_indenter("sphere_7mm").mesh()
    for sensor in one_sided.sensors:
        found = list(series(folder / f"trajectory_1/sphere_7mm/{sensor}_indenter.pvd"))
        assert len(found) == 4
        for step, (_, mesh) in enumerate(found):
            pose = one_sided["press/pose"][press]
            travel = one_sided[f"{sensor}/touch"][press] + one_sided["depth"][step]
            tip = pose[:3, 3] + travel * pose[:3, 1]
            expected = shape.vertices @ pose[:3, :3].T + tip
            # VTK moves points in the precision that they have.
            np.testing.assert_allclose(mesh.points, expected, atol=1e-8)


def test_nothing_for_a_press_that_never_touched(folder):
    assert {path.name for path in (folder / "trajectory_1/ring_7mm").iterdir()} == {
        "biotac", "biotac.pvd", "biotac_indenter.pvd"}  # fmt: skip
