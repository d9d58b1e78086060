"""The table of presses against what the stand-ins do."""

import time
from dataclasses import replace

import fake
import numpy as np
import pytest

from simgen.errors import InputError
from simgen.fem.nonlinear.status import NOT_THERE, Status, in_words
from simgen.pipeline.run import run
from simgen.view.press_table import STATUSES, Filter, PressTable, following, kind_of, preceding


@pytest.fixture(scope="module")
def table(failing) -> PressTable:
    return PressTable.of_dataset(failing)


def test_every_outcome_has_a_place():
    assert {in_words(code) for code in (NOT_THERE, 77, *Status)} == set(STATUSES)


def test_a_ring_that_stalls(table):
    assert len(table) == 12 and table.steps_reached[:3].tolist() == [[4, 4], [2, 2], [4, 4]]
    np.testing.assert_allclose(table.depth_mm[:3], [[0.4, 0.4], [0.2, 0.2], [0.4, 0.4]])
    assert table.status[:3].tolist() == ["converged", "failed", "converged"]
    row = table.row(4)
    assert (row.press, row.trajectory, row.indenter, row.status) == (4, 1, "ring_7mm", "failed")
    assert row.steps_reached == {"digit": 2, "biotac": 2} and row.error_um is None
    assert table.furthest() == 0 and not table.has_estimates


def test_ends_as_planned_and_inside_out(tmp_path):
    plan = fake.make_plan(fake.make_job(trajectories={"count": 1}))
    table = PressTable.of_dataset(run(plan, tmp_path / "d.zarr", build=fake.ending_presser))
    assert table.status.tolist() == ["not pressed", "not pressed", "inside out"]
    assert table.steps_reached.tolist() == [[3, 3], [2, 2], [4, 4]]


def test_filters(failing, table):
    assert len(table.matching(Filter())) == 12
    assert table.matching(Filter(indenter="ring_7mm")).tolist() == [1, 4, 7, 10]
    assert table.matching(Filter(status="failed")).tolist() == [1, 4, 7, 10]
    assert table.matching(Filter(least_depth_mm=0.3)).tolist() == [0, 2, 3, 5, 6, 8, 9, 11]
    assert len(table.matching(Filter(least_depth_mm=0.4))) == 8  # 4 x 0.1 is not 0.4 in floating point
    assert len(table.matching(Filter(least_depth_mm=0.41))) == 0
    assert len(table.matching(Filter(largest_error_um=100.0))) == 0  # there are no estimates
    for split in ("train", "validation", "test"):
        found = table.matching(Filter(split=split, indenter="sphere_7mm"))
        own = [p for p in range(12) if table.row(p).split == split and table.row(p).indenter == "sphere_7mm"]
        assert found.tolist() == own
    assert sum(len(table.matching(Filter(split=split))) for split in ("train", "validation", "test", "none")) == 12


def test_the_filter_of_estimated_errors_takes_the_largest_of_a_press(estimating):
    table = PressTable.of_dataset(estimating)
    assert table.has_estimates
    np.testing.assert_allclose(table.error_um[:3], [3.0, 6.0, 12.0])
    assert table.matching(Filter(largest_error_um=6.01)).tolist() == [0, 1, 3, 4, 6, 7, 9, 10]
    assert table.row(1).error_um == pytest.approx(6.0)


@pytest.mark.parametrize("key, value", [("indenter", "pin"), ("split", "exam"), ("status", "fine")])
def test_a_filter_that_nothing_can_pass_is_refused(table, key, value):
    with pytest.raises(InputError, match=f"filter: {key}: '{value}'; allowed: .*, "):
        table.matching(replace(Filter(), **{key: value}))


def test_the_way_from_press_to_press(table):
    among = table.matching(Filter(indenter="ring_7mm"))
    assert [following(press, among) for press in (0, 1, 4, 10)] == [1, 4, 7, None]
    assert [preceding(press, among) for press in (1, 2, 11)] == [None, 1, 10]
    assert following(0, np.array([], int)) is preceding(0, np.array([], int)) is None


def test_a_press_is_found_by_contact_and_indenter(table):
    assert table.find(2, "texture_14mm") == table.find(2, 2) == 8
    assert table.find(4, 0) is None


def test_an_unfinished_dataset_has_presses_that_are_not_there_yet(unfinished):
    table = PressTable.of_dataset(unfinished)
    assert table.status.tolist() == ["converged"] * 4 + ["not there yet"] * 8
    assert table.steps_reached[3:5].tolist() == [[4, 4], [0, 0]]
    assert table.depth_mm[11].tolist() == [0.0, 0.0]


def test_samples_that_imported_files_lack_are_not_failures(table, imported):
    assert kind_of(100) == "not there yet" and kind_of(1) == "failed"
    found = PressTable.of_dataset(imported)
    assert found.status[:3].tolist() == ["converged", "not there yet", "converged"]
    np.testing.assert_array_equal(found.steps_reached, table.steps_reached)
    np.testing.assert_allclose(found.depth_mm, table.depth_mm)


def test_a_file_that_is_gone_is_named(unfinished):
    (unfinished.path / "digit/status/c/0/0").unlink()
    with pytest.raises(InputError, match="digit/status/c/0/0: is gone"):
        PressTable.of_dataset(unfinished)


def test_filters_of_as_many_presses_as_the_paired_job_take_no_time(table):
    times = 7740 // len(table)
    columns = "trajectory", "indenter", "split", "status", "steps_reached", "depth_mm", "error_um"
    many = replace(table, **{key: np.concatenate([getattr(table, key)] * times) for key in columns})
    start = time.perf_counter()
    found = many.matching(Filter(indenter="ring_7mm", split="train", status="failed", least_depth_mm=0.1))
    assert len(found) and time.perf_counter() - start < 0.1
