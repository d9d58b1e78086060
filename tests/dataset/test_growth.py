"""Adding trajectories to a dataset: what is there stays, what is new is solved, and a kill costs nothing."""

import errno
import os
import shutil
from pathlib import Path

import fake
import numpy as np
import pytest

from simgen import load_dataset
from simgen.dataset import growth
from simgen.dataset.audit import check, passes
from simgen.dataset.growth import finish_growth, grow
from simgen.dataset.reader import GROWING, Dataset
from simgen.dataset.splits import SPLITS, split_by_trajectory
from simgen.dataset.writer import has_all, manifest_path
from simgen.errors import InputError
from simgen.pipeline.run import run

WHOLE = {"presses_per_shard": 3}  # a trajectory with its three indenters


def make_job(count, **changes):
    return fake.make_job(**{"trajectories": {"count": count}, "dataset": WHOLE, **changes})


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run(fake.make_plan(make_job(4)), tmp_path_factory.mktemp("whole") / "d.zarr", build=fake.fake_presser)


@pytest.fixture
def folder(whole, tmp_path):
    """A copy, to be grown."""
    return shutil.copytree(whole.path, tmp_path / "d.zarr")


def test_only_what_is_new_is_solved(folder):
    before = fake.contents(folder)
    reports, already = [], []
    larger = run(fake.make_plan(make_job(7)), folder, on_start=already.append, on_report=reports.append,
                 build=fake.fake_presser)  # fmt: skip
    assert [report.shard for report in reports] == [4, 5, 6] and already == [12]
    after = fake.contents(folder)
    shards = {name for name in before if "/c/" in name and name.startswith(("digit/", "biotac/", "press/pose"))}
    solved = {name for name in shards if after[name] == before[name]}
    assert len(solved) > 100 and all("pose" in name for name in shards - solved)  # the plan's poses are one array
    assert larger.presses == 21 and larger.grown_from == (4,)
    assert passes(check(larger)), [finding for finding in check(larger) if finding.failed]
    assert "7 contacts" in (folder / "README.md").read_text()
    assert len((folder / "presses.csv").read_text().splitlines()) == 22


def test_a_complete_dataset_has_all_of_its_job_and_not_of_a_larger_one(folder, tmp_path):
    assert has_all(folder, make_job(4)) and not has_all(folder, make_job(5))
    assert not has_all(tmp_path / "e.zarr", make_job(4))
    (folder / manifest_path(2)).unlink()  # a shard is missing
    assert not has_all(folder, make_job(4))


def test_it_is_the_larger_dataset_but_for_its_splits(folder, tmp_path):
    grown = run(fake.make_plan(make_job(7)), folder, build=fake.fake_presser)
    at_once = run(fake.make_plan(make_job(7)), tmp_path / "e.zarr", build=fake.fake_presser)
    one, other = fake.contents(grown.path), fake.contents(at_once.path)
    assert one.keys() == other.keys()
    differing = {name for name in one if one[name] != other[name]}
    told = {"zarr.json", "manifest/plan.json", "README.md", "presses.csv", "croissant.json", "press/split/c/0"}
    assert differing <= told


def test_splits_of_what_was_there_stay(tmp_path):
    """Four trajectories a shard, whose files take the time."""
    folder, shards = tmp_path / "d.zarr", {"dataset": {"presses_per_shard": 12}}

    def grown_to(count):
        return run(fake.make_plan(make_job(count, **shards)), folder, build=fake.fake_presser)

    before = grown_to(4)["press/split"]
    grown = grown_to(40)["press/split"]
    again = grown_to(100)
    split = again["press/split"]
    np.testing.assert_array_equal(split[: len(before)], before)
    np.testing.assert_array_equal(split[:120], grown)
    assert again.grown_from == (4, 40)
    assert np.bincount(split[::3]).tolist() == [79, 10, 11]
    assert passes(check(again))
    assert len(load_dataset(folder, split="test")) == 11 * 3 * 4


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("counts", [(3, 4, 5, 6), (1, 2, 3), (10, 11, 100), (860, 900)])
def test_shares_are_as_near_as_they_can_be(counts, seed):
    *before, last = counts
    split = split_by_trajectory(last, seed, before)
    assert len(split) == last and set(split) <= set(range(len(SPLITS)))
    np.testing.assert_array_equal(split[: before[-1]], split_by_trajectory(before[-1], seed, before[:-1]))
    found, wanted = np.bincount(split, minlength=3), np.array(list(SPLITS.values())) * last
    assert np.abs(found - wanted).max() <= 1.0  # rounded, and at most one too many from before


def test_a_last_shard_that_was_not_full_is_solved_again(tmp_path):
    """Three presses each, two a shard."""
    changes = {"dataset": {"presses_per_shard": 2}}
    run(fake.make_plan(make_job(3, **changes)), tmp_path / "d.zarr", build=fake.fake_presser)
    reports = []
    grown = run(fake.make_plan(make_job(5, **changes)), tmp_path / "d.zarr", on_report=reports.append,
                build=fake.fake_presser)  # fmt: skip
    assert [report.shard for report in reports] == [4, 5, 6, 7]
    at_once = run(fake.make_plan(make_job(5, **changes)), tmp_path / "e.zarr", build=fake.fake_presser)
    np.testing.assert_array_equal(grown["digit/force"], at_once["digit/force"])


def test_a_full_disk_costs_nothing(folder, monkeypatch):
    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))

    before = fake.contents(folder)
    monkeypatch.setattr(growth, "write_plan", full)
    with pytest.raises(InputError, match="No space left"):
        run(fake.make_plan(make_job(7)), folder, build=fake.fake_presser)
    assert fake.contents(folder) == before and not Dataset(folder).unfinished()


def test_a_growth_by_another_run_meanwhile_is_seen(folder, monkeypatch):
    """Between the first look and the lock another run adds trajectories: nothing is taken back."""
    filling = growth.filling

    def late(dataset):
        with monkeypatch.context() as patch:
            patch.setattr(growth, "filling", filling)
            run(fake.make_plan(make_job(9)), folder, build=fake.fake_presser)
        return filling(dataset)

    plan = fake.make_plan(make_job(7))
    monkeypatch.setattr(growth, "filling", late)
    grow(folder, plan.attributes, plan.arrays, plan.job)
    assert Dataset(folder).job.trajectories.count == 9 and passes(check(Dataset(folder)))


class KilledError(BaseException):
    pass


def growth_killed_after(moves, folder, monkeypatch) -> bool:
    """Grow, and end before so many files have been moved; returns whether the growth was shorter than that."""
    plan, done = fake.make_plan(make_job(7)), []
    replace = os.replace

    def counted(source, target):
        if folder / GROWING in Path(source).parents:
            if len(done) == moves:
                raise KilledError
            done.append(target)
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(growth.os, "replace", counted)
        try:
            grow(folder, plan.attributes, plan.arrays, plan.job)
        except KilledError:
            return False
    return True


def test_a_growth_that_was_cut_short_is_completed(tmp_path, monkeypatch):
    run(fake.make_plan(make_job(4)), tmp_path / "four.zarr", build=fake.fake_presser)
    shutil.copytree(tmp_path / "four.zarr", tmp_path / "f.zarr")
    expected = fake.contents(run(fake.make_plan(make_job(7)), tmp_path / "f.zarr", build=fake.fake_presser).path)
    moves = 0
    while True:
        folder = tmp_path / f"{moves}.zarr"
        shutil.copytree(tmp_path / "four.zarr", folder)
        if growth_killed_after(moves, folder, monkeypatch):
            break
        with pytest.raises(InputError, match="a run is adding trajectories"):
            Dataset(folder)
        run(fake.make_plan(make_job(7)), folder, build=fake.fake_presser)
        assert fake.contents(folder) == expected, moves
        moves += 19
    assert moves > 57


def test_the_smaller_job_cannot_undo_a_growth(folder, monkeypatch):
    assert not growth_killed_after(5, folder, monkeypatch)
    with pytest.raises(InputError, match=r"trajectories\.count: 7 -> 4"):
        run(fake.make_plan(make_job(4)), folder, build=fake.fake_presser)


def test_other_changes_than_the_count_are_refused_and_cost_nothing(folder):
    before = fake.contents(folder)
    for changes, told in (
        ({"seed": 4}, "seed: 3 -> 4"),
        ({"indenters": ["sphere_7mm", "ring_7mm"]}, "indenters"),
        ({"depths_mm": {"first": 0.1, "last": 0.5, "count": 5}}, r"depths_mm\.last"),
    ):
        with pytest.raises(InputError, match=told):
            run(fake.make_plan(make_job(7, **changes)), folder, build=fake.fake_presser)
    other_code = fake.make_plan(make_job(7))
    other_code.attributes["code"] = other_code.attributes["code"] | {"source": "another"}
    with pytest.raises(InputError, match=r"code\.source"):
        run(other_code, folder, build=fake.fake_presser)
    elsewhere = fake.make_plan(make_job(7))
    elsewhere.arrays["press/contact_pose"] = elsewhere.arrays["press/contact_pose"] + 1e-6
    with pytest.raises(InputError, match="press/contact_pose: differs from what the job plans"):
        run(elsewhere, folder, build=fake.fake_presser)
    assert fake.contents(folder) == before


def test_shards_of_a_grown_dataset_can_be_solved_again(folder):
    run(fake.make_plan(make_job(7)), folder, build=fake.fake_presser)
    before = fake.contents(folder)
    run(fake.make_plan(make_job(7)), folder, build=fake.fake_presser, again=[1, 5])
    assert fake.contents(folder) == before


def test_a_card_that_was_edited_stays(folder):
    (folder / "README.md").write_bytes(b"mine: \xff")
    run(fake.make_plan(make_job(5)), folder, build=fake.fake_presser)
    assert (folder / "README.md").read_bytes() == b"mine: \xff"
    assert len((folder / "presses.csv").read_text().splitlines()) == 16


def test_nothing_to_finish_is_nothing(folder, tmp_path):
    before = fake.contents(folder)
    finish_growth(folder)
    finish_growth(tmp_path / "not there")
    assert fake.contents(folder) == before


@pytest.mark.parametrize("before", [0, 2])
def test_refused_contacts_grow_with_the_contacts(tmp_path, before):
    refused = np.random.default_rng(0).normal(size=(5, 3))

    def plan(count, rows):
        made = fake.make_plan(make_job(count))
        made.arrays |= {f"refused/{name}": refused[:rows] for name in ("points", "normals") if rows}
        return made

    folder = tmp_path / "d.zarr"
    run(plan(4, before), folder, build=fake.fake_presser)
    grown = run(plan(7, 5), folder, build=fake.fake_presser)
    np.testing.assert_array_equal(grown["refused/points"], refused)
    assert passes(check(grown)), [finding for finding in check(grown) if finding.failed]
    refused[0] += 1.0
    with pytest.raises(InputError, match="refused/points: differs from what the job plans"):
        run(plan(9, 5), folder, build=fake.fake_presser)


def test_given_contacts_grow_by_more_of_them(tmp_path):
    """The first contacts must be those of the dataset."""
    places = [{"x_mm": float(x), "arc_mm": 0.0} for x in range(6)]

    def with_contacts(chosen):
        return fake.make_plan(make_job(4, trajectories={"contacts": chosen}))

    run(with_contacts(places[:4]), tmp_path / "d.zarr", build=fake.fake_presser)
    reports = []
    grown = run(with_contacts(places), tmp_path / "d.zarr", on_report=reports.append, build=fake.fake_presser)
    assert [report.shard for report in reports] == [4, 5] and grown.grown_from == (4,)
    assert len(grown.job.trajectories.contacts) == 6 and passes(check(grown))
    for other in (places[::-1], places[1:]):
        with pytest.raises(InputError, match="holds another dataset"):
            run(with_contacts(other), tmp_path / "d.zarr", build=fake.fake_presser)
