"""The case of the BioTac on a flat plate: its file, its statistics, its plates, and the real data."""

from pathlib import Path

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensors.sensor import load_sensor
from simgen.verification.measured import biotac_pattern
from simgen.verification.validate import all_cases
from simgen.verification.validate.case import Context

CHANGE = np.arange(1.0, 20.0)


def solve(measured: Path | None, scratch: Path):
    return all_cases()["measured-biotac"].solve(Context("cpu", None, None, scratch, measured))


def test_without_data_the_case_is_skipped_with_its_reason(tmp_path):
    absent, empty = solve(None, tmp_path), solve(tmp_path, tmp_path)
    assert "no --measured DIR" in absent.skipped
    assert str(tmp_path / biotac_pattern.FILE) in empty.skipped
    assert not absent.rows + empty.rows


def test_the_file_gives_means_over_materials(tmp_path):
    file = tmp_path / biotac_pattern.FILE
    header = ["mat", "pdc", *(f"ele{i + 1}" for i in range(19))]
    rows = [[1, 30.0, *CHANGE], [2, 50.0, *3.0 * CHANGE]]
    file.write_text("\n".join(",".join(map(str, row)) for row in (header, *rows)))
    found = biotac_pattern.read_pattern(file)
    np.testing.assert_allclose(found.change, 2.0 * CHANGE)
    np.testing.assert_allclose(found.spread, [CHANGE, 3.0 * CHANGE])
    assert (found.pressure, found.rows) == (40.0, 2)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("mat,pdc,ele1\n", "first line: ele2,ele3,"),
        ("", "first line: pdc,ele1,"),
        (",".join(biotac_pattern.COLUMNS), "no rows; allowed: one for each material"),
        (",".join(biotac_pattern.COLUMNS) + "\n" + "1," * 19 + "many", "line 2: ele19 'many': allowed: a number"),
        (",".join(biotac_pattern.COLUMNS) + "\n1,2", "line 2: ele2 '': allowed: a number of counts"),
    ],
)
def test_another_file_is_one_line(tmp_path, text, complaint):
    file = tmp_path / biotac_pattern.FILE
    file.write_text(text)
    with pytest.raises(InputError, match="allowed: ") as raised:
        solve(tmp_path, tmp_path)
    assert str(raised.value).startswith(f"{file}: ") and complaint in str(raised.value)


def test_agreement_is_of_absolute_changes():
    same = biotac_pattern.agreement(-2.0 * CHANGE, CHANGE)
    assert same.cells == pytest.approx([1.0, 1.0, 1.0, 2.0])
    ranked = biotac_pattern.agreement(CHANGE**3, CHANGE)
    assert ranked.rank == pytest.approx(1.0) and ranked.r < 0.95
    strongest = CHANGE.copy()
    strongest[biotac_pattern.STRONGEST] = 500.0
    lonely = biotac_pattern.agreement(strongest, strongest[::-1])
    assert lonely.r_others == pytest.approx(np.corrcoef(*(each[biotac_pattern.OTHERS] for each in
                                                          (strongest, strongest[::-1])))[0, 1])  # fmt: skip


def test_a_plate_meets_the_skin_with_its_flat_face_alone():
    sensor = load_sensor("biotac", "coarse")
    for pitch in biotac_pattern.PITCHES_DEG:
        pose = biotac_pattern.plate_pose(sensor, pitch)
        np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-15)
        assert np.degrees(np.arctan2(pose[0, 1], pose[1, 1])) == pytest.approx(pitch)
        own = (sensor.surface.vertices - pose[:3, 3]) @ pose[:3, :3]
        assert own[:, 1].min() == pytest.approx(3e-4)  # the skin lies above the plate, 0.3 mm away
        near = own[own[:, 1] < 2e-3]  # what a press of 1.4 mm can reach
        assert np.abs(near[:, [0, 2]]).max() < 1e-3 * (biotac_pattern.PLATE_MM - biotac_pattern.FILLET_MM)


def test_columns_are_interpolated_at_a_pressure_within_the_samples():
    samples, pressures = np.array([[1.0, 10.0], [3.0, 30.0]]), np.array([100.0, 200.0])
    np.testing.assert_allclose(biotac_pattern.interpolate(samples, pressures, 150.0), [2.0, 20.0])
    for outside in (99.0, 201.0):
        with pytest.raises(RuntimeError, match="outside of 100 to 200 Pa"):
            biotac_pattern.interpolate(samples, pressures, outside)


def test_the_real_pattern_is_met(reference, tmp_path):
    folder = reference / "measured"
    if not (folder / biotac_pattern.FILE).is_file():
        pytest.skip(f"no {folder / biotac_pattern.FILE}")
    outcome = solve(folder, tmp_path)
    assert [row.quantity for row in outcome.rows if not row.passed] == []
    assert len(outcome.rows) == 3 and len(outcome.notes) == 6
    pitches, settings, electrodes = outcome.tables
    assert [row[0] for row in pitches.rows] == list(biotac_pattern.PITCHES_DEG)
    assert [row[0] for row in electrodes.rows] == [f"E{i + 1}" for i in range(19)]
    correlation = {row[0]: row[1] for row in settings.rows}
    wrong = [value for name, value in correlation.items() if name.startswith(("former", "least", "defaults, "))]
    assert len(wrong) == 3 and max(wrong) < biotac_pattern.LEAST_R < correlation["defaults"]
