"""Provenance: the code that made a dataset is known by its sources, also where there is no repository."""

import fake
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simgen.config.resources import PACKAGE
from simgen.dataset import provenance
from simgen.dataset.writer import create, open_or_create
from simgen.errors import InputError

LEAF = st.integers() | st.dictionaries(st.sampled_from("xy"), st.integers())


def package(folder, **files):
    for name, text in {"__init__": "", "press": "depth = 1", **files}.items():
        path = folder / f"{name.replace('.', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def test_the_hash_of_the_sources_is_that_of_names_and_contents(tmp_path):
    first = provenance.source_hash(package(tmp_path / "a"))
    same = package(tmp_path / "b")
    (same / "__pycache__").mkdir()
    (same / "__pycache__" / "press.pyc").write_bytes(b"compiled")
    assert provenance.source_hash(same) == first
    others = [
        package(tmp_path / "edited", press="depth = 2"),
        package(tmp_path / "more", **{"fem.newton": ""}),
    ]
    assert len({first, *map(provenance.source_hash, others)}) == 3


def test_without_a_repository_the_sources_are_still_known(monkeypatch, tmp_path):
    monkeypatch.setattr(provenance, "PACKAGE", tmp_path / "simgen")
    code = provenance.code_version()
    assert (code["commit"], code["dirty"]) == (None, None)
    assert code["source"] == provenance.source_hash(PACKAGE)


def test_a_dataset_of_other_sources_is_refused(tmp_path):
    plan = fake.make_plan(fake.make_job())
    old = {**plan.attributes, "code": {"version": "1", "source": "aa", "commit": None, "dirty": None}}
    new = {**old, "code": {**old["code"], "source": "bb"}}
    create(tmp_path / "d.zarr", old, plan.arrays, plan.job)
    open_or_create(tmp_path / "d.zarr", old, plan.arrays, plan.job)
    with pytest.raises(InputError, match=r"holds another dataset \(code\.source: aa -> bb\)"):
        open_or_create(tmp_path / "d.zarr", new, plan.arrays, plan.job)


@given(st.dictionaries(st.sampled_from("abc"), LEAF))
def test_difference_is_empty_between_equals_and_names_what_is_new(data):
    assert provenance.difference(data, data) == []
    assert provenance.difference(data, {**data, "new": 1}) == ["new: (absent) -> 1"]
