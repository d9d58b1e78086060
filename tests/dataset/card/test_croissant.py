"""croissant.json, read by the reader of MLCommons."""

import logging

import fake
import pytest


def test_croissant_s_own_reader_takes_it(dataset, caplog):
    """Without an error; it recommends a date of publication, which a run cannot know."""
    croissant = pytest.importorskip("mlcroissant", reason="mlcroissant is not installed (the dev extra)")
    with caplog.at_level(logging.WARNING):
        read = croissant.Dataset(dataset.path / "croissant.json")
    assert not read.metadata.ctx.issues.errors
    warnings = [str(issue) for issue in read.metadata.ctx.issues.warnings]
    assert all("datePublished" in warning for warning in warnings), warnings
    presses = list(read.records("presses"))  # it compares the file's sha256, too
    assert [press["presses/press"] for press in presses] == list(range(60))
    assert presses[1]["presses/indenter"] == b"ring_7mm"
    listed = {record["arrays/path"]: record for record in read.records("arrays")}
    assert listed["digit/displacement"]["arrays/shape"] == f"60 x 4 x {len(fake.VERTICES)} x 3"
    members = {path for path, member in dataset.root.members(max_depth=None) if hasattr(member, "shape")}
    assert set(listed) == members
