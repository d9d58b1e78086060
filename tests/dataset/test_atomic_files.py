"""Files that are there whole or not at all."""

import hashlib
import os

import pytest

from simgen.dataset.atomic_files import ROOM, check_new, check_room, put_in_place, whole_folder, write_aside
from simgen.dataset.folder_lock import LOCK
from simgen.errors import InputError


def test_a_file_has_its_place_only_when_it_is_put_there(tmp_path):
    root, data = tmp_path / "root", b"\x00\xff touch" * 1000
    (root / "aside").mkdir(parents=True)
    first, second = (write_aside(root / "aside", data) for _ in range(2))
    assert sorted(root.iterdir()) == [root / "aside"]
    assert first.sha256 == hashlib.sha256(data).hexdigest()
    (root / "b").mkdir()
    (root / "b/old").write_bytes(b"before")
    put_in_place(root, {"a/new": first, "b/old": second})
    assert (root / "a/new").read_bytes() == (root / "b/old").read_bytes() == data
    assert not list((root / "aside").iterdir())


def test_a_file_and_the_folders_on_its_way_are_flushed_to_disk(tmp_path, monkeypatch):
    flushed = []
    monkeypatch.setattr(os, "fsync", lambda handle: flushed.append(os.readlink(f"/proc/self/fd/{handle}")))
    aside = write_aside(tmp_path, b"touch")
    put_in_place(tmp_path, {"a/new": aside})
    assert flushed[0] == str(aside.temporary) and set(flushed[1:]) == {str(tmp_path), str(tmp_path / "a")}


def test_a_folder_appears_when_it_is_whole(tmp_path):
    path = tmp_path / "made/folder"
    with whole_folder(path) as aside:
        (aside / "file").write_text("whole")
        assert not path.exists()
    assert {entry.name for entry in path.iterdir()} == {"file", LOCK}
    assert list(path.parent.iterdir()) == [path]


def test_a_folder_that_fails_leaves_nothing_and_what_was_left_by_a_kill_goes(tmp_path):
    killed = tmp_path / f".folder.{'0' * 32}.partial"
    killed.mkdir()
    with pytest.raises(KeyboardInterrupt), whole_folder(tmp_path / "folder") as aside:
        (aside / "file").touch()
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_a_folder_that_somebody_else_made_meanwhile_stays(tmp_path):
    path = tmp_path / "folder"
    with pytest.raises(FileExistsError, match="folder"), whole_folder(path) as aside:
        (aside / "file").write_text("ours")
        path.mkdir()
        (path / "file").write_text("theirs")
    assert (path / "file").read_text() == "theirs" and list(tmp_path.iterdir()) == [path]


def test_new_is_what_is_free_or_empty(tmp_path):
    check_new(tmp_path / "free")
    check_new(tmp_path)
    (tmp_path / "file").touch()
    for taken in (tmp_path, tmp_path / "file"):
        with pytest.raises(InputError, match="exists already"):
            check_new(taken)


def test_room_is_asked_of_the_disk(tmp_path, monkeypatch):
    class Usage:
        free = ROOM

    monkeypatch.setattr("shutil.disk_usage", lambda path: Usage)
    check_room(tmp_path)
    Usage.free = ROOM - 1
    with pytest.raises(OSError, match="No space left"):
        check_room(tmp_path)
