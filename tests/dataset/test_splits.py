"""Splits: shares, seeds, an indenter that is left out, and what the audit says of them."""

import fake
import numpy as np
import pytest

from simgen.dataset.audit import check
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import IN_NONE, SPLITS, leave_out, number_presses, split_by_trajectory
from simgen.errors import InputError
from simgen.pipeline.run import run

TRAIN, VALIDATION, TEST = range(3)


@pytest.mark.parametrize("count, expected", [(860, (679, 86, 95)), (100, (79, 10, 11)), (2, (2, 0, 0))])
def test_split_is_79_10_11_of_the_trajectories(count, expected):
    split = split_by_trajectory(count, seed=1)
    assert tuple(np.bincount(split, minlength=3)) == expected
    np.testing.assert_array_equal(split, split_by_trajectory(count, seed=1))
    if count == 860:
        assert (split != split_by_trajectory(count, seed=2)).any()


def test_the_published_samples_have_the_same_shares():
    """122,924, 15,560 and 17,121 samples (ACROSS) are these shares to a tenth of a per cent."""
    published = np.array([122_924, 15_560, 17_121])
    np.testing.assert_allclose(list(SPLITS.values()), published / published.sum(), atol=1e-3)


def test_an_indenter_that_is_left_out_is_tested_alone_where_nobody_has_trained():
    trajectory, indenter = np.divmod(np.arange(300), 3)
    whole = split_by_trajectory(100, seed=1)[trajectory]
    split = leave_out(whole, indenter, left_out=1)
    assert set(indenter[split == TEST]) == {1}
    assert set(indenter[(split == TRAIN) | (split == VALIDATION)]) == {0, 2}
    of_split = [set(trajectory[split == code]) for code in (TRAIN, VALIDATION, TEST)]
    assert [len(each) for each in of_split] == [79, 10, 11]
    assert not (of_split[TRAIN] & of_split[TEST] or of_split[VALIDATION] & of_split[TEST])
    assert np.count_nonzero(split == IN_NONE) == 89 + 2 * 11


def test_all_indenters_press_at_each_contact_unless_the_job_says_how_many():
    trajectory, indenter = number_presses(fake.make_job())
    np.testing.assert_array_equal(trajectory, np.repeat(np.arange(4), 3))
    np.testing.assert_array_equal(indenter, np.tile(np.arange(3), 4))


@pytest.mark.parametrize("each", [1, 2])
def test_indenters_share_the_contacts_fairly_and_in_no_order(each):
    job = fake.make_job(trajectories={"count": 300, "indenters_each": each})
    trajectory, indenter = number_presses(job)
    assert len(trajectory) == job.presses == 300 * each
    np.testing.assert_array_equal(trajectory, np.repeat(np.arange(300), each))
    of_groups = indenter.reshape(100, 3 * each)  # of three contacts, as many as there are indenters
    np.testing.assert_array_equal(np.sort(of_groups, axis=1), np.tile(np.repeat(np.arange(3), each), (100, 1)))
    assert (np.diff(indenter.reshape(300, each), axis=1) > 0).all()
    assert len(np.unique(of_groups, axis=0)) == 6  # all orders of three
    for smaller in (299, 7):
        part = number_presses(fake.make_job(trajectories={"count": smaller, "indenters_each": each}))
        np.testing.assert_array_equal(part, (trajectory[: smaller * each], indenter[: smaller * each]))


def test_a_dataset_with_one_indenter_at_each_contact_grows_and_passes_its_audit(tmp_path):
    for count in (7, 12):
        job = fake.make_job(trajectories={"count": count, "indenters_each": 1})
        dataset = run(fake.make_plan(job), tmp_path / "d.zarr", build=fake.fake_presser)
        assert len(dataset["press/indenter"]) == count and len(set(dataset["press/indenter"])) == 3
        assert not [finding for finding in check(dataset) if finding.failed]


@pytest.fixture
def left_out(tmp_path) -> Dataset:
    plan = fake.make_plan(fake.make_job(dataset={"leave_out": "ring_7mm"}, trajectories={"count": 20}))
    return run(plan, tmp_path / "d.zarr", build=fake.fake_presser)


def test_a_job_that_leaves_an_indenter_out_stores_it_and_passes_its_audit(left_out):
    ring = left_out["press/indenter"] == left_out.indenters.index("ring_7mm")
    split = left_out["press/split"]
    assert np.count_nonzero(split == TEST) == 2 and ring[split == TEST].all() and not ring[split == TRAIN].any()
    assert not [finding for finding in check(left_out) if finding.failed]


@pytest.mark.parametrize("code", [TRAIN, TEST])
def test_the_audit_names_presses_that_are_where_they_must_not_be(left_out, code):
    """The indenter that is left out must not train, nor any other be tested."""
    split, indenter = left_out["press/split"], left_out["press/indenter"]
    own = left_out.indenters.index("ring_7mm")
    press = np.flatnonzero((split == IN_NONE) & ((indenter == own) == (code == TRAIN)))[0]
    fake.change(left_out, "press/split", int(press), code)
    failed = {finding.what: finding for finding in check(Dataset(left_out.path)) if finding.failed}
    assert failed.keys() == {"left out", "numbering"}
    assert failed["left out"].note == f"in the wrong split: presses {press}"
    assert failed["numbering"].note == f"split: press {press}"


@pytest.mark.parametrize("changes", [{"leave_out": "ring"}, {"leave_out": ""}])
def test_only_an_indenter_of_the_job_can_be_left_out(changes):
    with pytest.raises(InputError, match=r"leave_out .* is not allowed; allowed: one of sphere_7mm, ring_7mm, texture"):
        fake.make_job(dataset=changes)


def test_the_only_indenter_cannot_be_left_out():
    with pytest.raises(InputError, match="allowed: nothing, as the job has only one indenter"):
        fake.make_job(indenters=["ring_7mm"], dataset={"leave_out": "ring_7mm"})
