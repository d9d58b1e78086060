"""Locks of folders, so that one process at a time writes into a folder.

Locks are flock(2) locks. The operating system releases them when their process ends, also after a kill. They hold
between the machines of an NFS too.
"""

import errno
import fcntl
import os
import shutil
import socket
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

LOCK = ".lock"
NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.ENOLCK)  # errors of a file system without locks


class LockedError(Exception):
    """Another process or call has locked the folder; the text names it."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder. Raises `LockedError` at once if it is locked, `FileNotFoundError` if it is gone."""
    handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        if not _lock(handle, folder):
            raise LockedError(os.pread(handle, 1000, 0).decode(errors="replace") or "an unknown process")
        if os.fstat(handle).st_ino != os.stat(folder / LOCK).st_ino:  # removed and made again meanwhile
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder / LOCK))
        about = f"process {os.getpid()} on {socket.gethostname()} since {time.strftime('%Y-%m-%d %H:%M:%S %Z')}"
        with suppress(OSError):  # a full disk; the lock holds nevertheless
            os.ftruncate(handle, 0)
            os.pwrite(handle, about.encode(), 0)
        try:
            yield
        finally:
            with suppress(OSError):
                os.ftruncate(handle, 0)
    finally:
        os.close(handle)


@contextmanager
def locked_new(named: Callable[[str], Path]) -> Iterator[Path]:
    """Make and lock a folder; ``named`` turns a unique text into its path.

    Another process can remove the folder before it is locked; then the next one is made.
    """
    with ExitStack() as stack:
        for last in (False, False, False, True):
            folder = named(uuid.uuid4().hex)
            folder.mkdir(parents=True)
            try:
                stack.enter_context(locked(folder))
                break
            except (LockedError, FileNotFoundError):
                if last:
                    raise
        yield folder


def holder(folder: Path) -> str | None:
    """Name the process that has locked a folder; None without one, or on a file system without locks."""
    if not (folder / LOCK).exists():
        return None
    handle = os.open(folder / LOCK, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return os.pread(handle, 1000, 0).decode(errors="replace") or "an unknown process"
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
    finally:
        os.close(handle)
    return None


def remove_abandoned(paths: Iterable[Path]) -> str | None:
    """Remove files and unlocked folders. Returns the holder of a locked folder that stays, or None."""
    left = None
    for path in paths:
        try:
            if path.is_dir():
                with locked(path):
                    for entry in path.iterdir():
                        if entry.name != LOCK:
                            _remove(entry)
            _remove(path)  # the lock's file last, once closed: NFS keeps open files
        except LockedError as error:
            left = str(error)
        except FileNotFoundError:  # another process has removed it
            pass
    return left


def _remove(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink()


def _lock(handle: int, folder: Path) -> bool:
    for _ in range(3):  # `holder` locks for an instant
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            time.sleep(0.02)
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
            warnings.warn(f"{folder}: this file system has no locks; let one run at a time write here", stacklevel=3)
            return True
    return False
