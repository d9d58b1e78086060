"""A folder has one owner at a time, and none as soon as its owner has died."""

import errno
import fcntl
import os
import signal
import subprocess
import sys

import pytest

from simgen.dataset.folder_lock import LOCK, LockedError, holder, locked, locked_new, remove_abandoned

CHILD = """
import sys, time, pathlib
from simgen.dataset.folder_lock import locked
with locked(pathlib.Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def child(tmp_path):
    """A process that holds the folder."""
    process = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()


def test_what_another_process_holds_is_not_to_be_had(tmp_path, child):
    with pytest.raises(LockedError, match=f"process {child.pid} on .* since 20"), locked(tmp_path):
        pass
    assert f"process {child.pid}" in holder(tmp_path)


def test_nothing_has_to_be_cleaned_up_after_kill_9(tmp_path, child):
    child.send_signal(signal.SIGKILL)
    child.wait()
    assert holder(tmp_path) is None
    with locked(tmp_path):
        assert f"process {os.getpid()}" in holder(tmp_path)


def test_a_folder_that_was_held_is_as_if_it_had_not_been(tmp_path):
    with locked(tmp_path), pytest.raises(LockedError), locked(tmp_path):
        pass
    assert holder(tmp_path) is None and (tmp_path / LOCK).read_bytes() == b""


def test_asking_who_holds_a_folder_does_not_keep_another_from_it(tmp_path):
    """While somebody looks, its lock is shared for an instant."""
    looking = os.open(tmp_path / LOCK, os.O_RDONLY | os.O_CREAT)
    fcntl.flock(looking, fcntl.LOCK_SH)
    with pytest.raises(LockedError), locked(tmp_path):
        pass
    os.close(looking)
    with locked(tmp_path):
        pass


def test_what_nobody_holds_is_removed_and_the_rest_stays(tmp_path):
    for folder in ("mine", "abandoned", "never held"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "half a file").write_bytes(b"1")
    (tmp_path / "file").write_bytes(b"1")
    with locked(tmp_path / "mine"):
        assert f"process {os.getpid()}" in remove_abandoned(tmp_path.glob("*"))
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert remove_abandoned(tmp_path.glob("*")) is None and not list(tmp_path.iterdir())


def test_a_file_system_without_locks_is_told_of(tmp_path, monkeypatch):
    def flock(handle, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.warns(UserWarning, match="this file system has no locks"), locked(tmp_path):
        assert holder(tmp_path) is None


def test_a_folder_that_is_removed_before_it_is_held_is_made_again(tmp_path):
    """Whoever removes what nobody holds may come between a folder and its lock."""
    names = iter(["first", "second"])

    def named(text):
        return tmp_path / next(names)

    real = os.open

    def open_after_removal(path, *arguments):
        if path == tmp_path / "first" / LOCK:
            os.rmdir(path.parent)
        return real(path, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "open", open_after_removal)
        with locked_new(named) as folder:
            assert folder == tmp_path / "second" and holder(folder)


def test_a_lock_on_a_file_that_has_been_removed_is_none(tmp_path, monkeypatch):
    lock, flock = tmp_path / LOCK, fcntl.flock

    def removed_meanwhile(handle, operation):
        flock(handle, operation)
        lock.unlink()
        lock.touch()

    monkeypatch.setattr(fcntl, "flock", removed_meanwhile)
    with pytest.raises(FileNotFoundError), locked(tmp_path):
        pass


def test_the_lock_is_removed_when_it_is_closed(tmp_path, monkeypatch):
    """NFS keeps files that are open, under another name, and with them their folder."""
    (tmp_path / "folder/inside").mkdir(parents=True)
    opened, close, remove = set(), os.close, os.unlink
    real = os.open

    def count(path, *arguments, **options):
        handle = real(path, *arguments, **options)
        if str(path).endswith(LOCK):
            opened.add(handle)
        return handle

    def uncount(handle):
        opened.discard(handle)
        close(handle)

    def check(path, *arguments, **options):
        assert not (str(path).endswith(LOCK) and opened)
        remove(path, *arguments, **options)

    monkeypatch.setattr(os, "open", count)
    monkeypatch.setattr(os, "close", uncount)
    monkeypatch.setattr(os, "unlink", check)
    assert remove_abandoned([tmp_path / "folder"]) is None and not (tmp_path / "folder").exists()
