"""HDF5 files from elsewhere: what is missing, not finite or in another file is one line."""

import h5py
import numpy as np
import pytest

from simgen.dataset.hdf5_files import dataset_at, group_at, member_at, numbers, open_hdf5
from simgen.errors import InputError


@pytest.fixture
def path(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["secret"] = [1.0]
    with h5py.File(tmp_path / "own.h5", "w") as file:
        file["group/values"] = np.arange(3)
        file["words"], file["holes"] = ["a"], [1.0, np.nan]
        file["soft"], file["external"] = h5py.SoftLink("/group"), h5py.ExternalLink("other.h5", "/secret")
        layout = h5py.VirtualLayout((1,), float)
        layout[:] = h5py.VirtualSource("other.h5", "secret", (1,))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("raw", (1,), float, external=[(str(tmp_path / "raw.bin"), 0, 8)])
    return tmp_path / "own.h5"


def test_members_are_found_by_their_key_also_through_a_link_within_the_file(path):
    with open_hdf5(path) as file:
        assert numbers(path, dataset_at(path, file, "soft/values")).tolist() == [0.0, 1.0, 2.0]
        assert group_at(path, file, "group").name == "/group"
        assert member_at(path, file, "group/none") is None and member_at(path, file, "words/none") is None


@pytest.mark.parametrize("key", ["external", "virtual", "raw"])
def test_values_in_another_file_are_refused(path, key):
    with open_hdf5(path) as file, pytest.raises(InputError, match=rf"{key}: lies in another file, .*(other|raw)"):
        member_at(path, file, key)


@pytest.mark.parametrize(
    ("read", "key", "says"),
    [
        (group_at, "words", "own.h5: words: not there, expected a group"),
        (dataset_at, "group", "own.h5: group: not there, expected numbers"),
        (lambda path, file, key: numbers(path, file[key]), "holes", "own.h5: /holes: values that are not finite"),
        (lambda path, file, key: numbers(path, file[key]), "words", "own.h5: /words: could not convert"),
    ],
)
def test_what_is_not_there_or_no_number_is_one_line(path, read, key, says):
    with open_hdf5(path) as file, pytest.raises(InputError, match=says) as refusal:
        read(path, file, key)
    assert "\n" not in str(refusal.value)


def test_a_file_that_is_not_hdf5_is_one_line(tmp_path):
    (tmp_path / "text.h5").write_text("none")
    with pytest.raises(InputError, match=r"text\.h5: cannot be read as HDF5"):
        open_hdf5(tmp_path / "text.h5")
