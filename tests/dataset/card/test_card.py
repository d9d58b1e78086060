"""The card of a dataset: when it is written, and that its owner may edit it."""

import csv
import hashlib
import io
import json
import shutil

import fake

import simgen.pipeline.run
from dataset.card.conftest import JOB
from simgen.dataset.card import CARD
from simgen.dataset.reader import Dataset
from simgen.pipeline.run import run


def test_a_card_that_was_not_written_is_written_by_the_same_command(dataset):
    """As after a kill between the last shard and the card."""
    before = fake.contents(dataset.path)
    (dataset.path / CARD[1]).unlink()
    run(fake.make_plan(fake.make_job(**JOB)), dataset.path, build=fake.failing_presser)
    assert fake.contents(dataset.path) == before


def test_an_owner_may_edit_it(dataset):
    card = dataset.path / "README.md"
    before = card.read_text()
    card.write_text(before + "\nOurs.\n")
    run(fake.make_plan(fake.make_job(**JOB)), dataset.path, build=fake.failing_presser)
    assert card.read_text().endswith("Ours.\n")
    card.write_text(before)


def test_a_repair_leaves_the_owner_s_text_and_renews_the_table(dataset, tmp_path):
    """Solved again by a press that succeeds where the ring had stalled."""
    path = tmp_path / "d.zarr"
    shutil.copytree(dataset.path, path)
    (path / "README.md").write_text("Ours.")
    run(fake.make_plan(fake.make_job(**JOB)), path, build=fake.fake_presser, again=range(7))
    assert (path / "README.md").read_text() == "Ours."
    rows = list(csv.DictReader(io.StringIO((path / "presses.csv").read_text())))
    assert {row["digit_converged"] for row in rows} == {"4"}
    known = json.loads((path / "croissant.json").read_text())["distribution"][0]
    assert known["sha256"] == hashlib.sha256((path / "presses.csv").read_bytes()).hexdigest()


def test_a_run_needs_no_files_of_shards_for_it_at_its_end(tmp_path, monkeypatch):
    """The run has kept what the card needs of each shard. Here these files are gone when it is written."""
    plan, write = fake.make_plan(fake.make_job()), simgen.pipeline.run.write_card
    expected = run(plan, tmp_path / "first.zarr", build=fake.fake_presser)

    def write_without_files(dataset, aside):
        for name in dataset.arrays:
            shutil.rmtree(dataset.path / name / "c", ignore_errors=True)
        write(dataset, aside)

    monkeypatch.setattr(simgen.pipeline.run, "write_card", write_without_files)
    found = run(plan, tmp_path / "second.zarr", build=fake.fake_presser)
    for name in CARD:
        assert (found.path / name).read_bytes() == (expected.path / name).read_bytes()


def test_an_unfinished_dataset_has_none(tmp_path):
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.overflowing_presser)
    assert Dataset(dataset.path).unfinished() and not [name for name in CARD if (dataset.path / name).exists()]
