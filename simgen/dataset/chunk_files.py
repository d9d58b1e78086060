"""Files of zarr arrays, written and read fast: the file of one shard, and arrays of thousands of chunks.

zarr uses one thread of the process, and spends 0.3 to 0.7 ms of Python on each chunk and 2 to 3 ms on each array.
Displacements have a chunk for each sample, 720 in a shard of 36 presses; zarrs writes and reads them without Python.
All other arrays have a single chunk in a shard; `chunk_file` makes it.
"""

import os
import shutil
import tempfile
import threading
from functools import cache
from pathlib import Path

import numpy as np
import zarr
from numcodecs import Blosc
from zarr.codecs import BloscCodec, BytesCodec, Endian, ShardingCodec
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import LocalStore, MemoryStore

from simgen.errors import system_errors

# Level 5 makes samples 2.4 % smaller but takes five times as long, too long beside a GPU.
COMPRESSION = {"cname": "zstd", "clevel": 2}  # and byte shuffle

# One thread keeps the order of a file's chunks; shards run in parallel instead. Strict: falling back to zarr would
# change the bytes.
PIPELINE = {
    "codec_pipeline.path": "zarrs.ZarrsCodecPipeline",
    "codec_pipeline.strict": True,
    "threading.max_workers": 1,
}
# zarr's settings are global, and an array keeps those that it was opened with. Arrays that other threads open meanwhile
# get them too: zarrs then reads those in folders, zarr those in memory as before.
OPENING = threading.Lock()


@cache
def make_threads():
    """Make zarr create its thread pool, once in a process, with a thread for each core.

    Otherwise the pool would have the pipeline's single thread, and shards would wait for each other.
    """
    with zarr.config.set({"threading.max_workers": max(4, os.cpu_count() or 1)}):
        zarr.open_group(MemoryStore(), mode="w")


def open_sharded(root: Path, name: str, mode: str = "r") -> zarr.Array:
    """Open a sharded array of the zarr group in a folder, to be read and written by zarrs."""
    with OPENING:
        make_threads()
        with zarr.config.set(PIPELINE):
            return zarr.open_array(LocalStore(root), path=name, mode=mode)


def sharded_files(root: Path, name: str, presses: range, stored: np.ndarray, aside: Path) -> dict[str, bytes]:
    """Make the files, by path below ``root``, that hold values (presses, ...) of these presses in a sharded array.

    ``aside`` is a folder for temporary files.
    """
    rows = slice(presses.start, presses.stop)
    with tempfile.TemporaryDirectory(dir=aside) as scratch:
        there = Path(scratch)
        chunks = there / name / "c"
        chunks.parent.mkdir(parents=True)
        shutil.copy(root / name / "zarr.json", chunks.parent)
        with system_errors():
            open_sharded(there, name, mode="r+")[rows] = stored
        found = {file.relative_to(there).as_posix(): file.read_bytes()
                 for file in sorted(chunks.rglob("*")) if file.is_file()}  # fmt: skip
    if found:
        return found
    # zarrs writes no file for fill values alone.
    to_buffer = default_buffer_prototype().buffer.from_bytes
    contents = {f"{name}/zarr.json": to_buffer((root / name / "zarr.json").read_bytes())}
    # Set this for the array alone: zarr's own settings are global, and other threads write shards.
    array = zarr.open_array(MemoryStore(contents), path=name, mode="r+").with_config({"write_empty_chunks": True})
    array[rows] = stored
    return {key: buffer.to_bytes() for key, buffer in contents.items() if not key.endswith("zarr.json")}


def chunk_path(name: str, number: int, dimensions: int) -> str:
    """Path of the file that holds a shard's presses; the other axes are not divided."""
    return "/".join([name, "c", str(number), *["0"] * (dimensions - 1)])


def chunk_file(name: str, number: int, stored: np.ndarray, presses_per_chunk: int, fill: float) -> dict[str, bytes]:
    """Make the single file, by path, of values (presses, ...) in an array with one chunk for each shard.

    It holds little-endian numbers in C order, compressed by Blosc: the codecs of zarr v3 that `COMPRESSION` sets.
    """
    chunk = np.full((presses_per_chunk, *stored.shape[1:]), fill, stored.dtype.newbyteorder("<"))
    chunk[: len(stored)] = stored
    codec = Blosc(shuffle=Blosc.SHUFFLE, typesize=chunk.itemsize, **COMPRESSION)
    return {chunk_path(name, number, stored.ndim): codec.encode(chunk)}


def read_chunk(root: Path, name: str, number: int, array: zarr.Array, presses: range) -> np.ndarray:
    """Read a shard's presses (n, ...) of an array without shards of zarr's own. Raises `ValueError` as `check_frames`.

    Files that `chunk_file` makes are read without zarr: an audit of the paired job's 215 shards reads 8,000 of them.
    """
    whole = array.chunks[1:] == array.shape[1:] and presses.start == number * array.chunks[0]
    match array.metadata.codecs:
        case [BytesCodec(endian=Endian.little | None), BloscCodec()] if whole and len(presses) <= array.chunks[0]:
            file = chunk_path(name, number, array.ndim)
            data = (root / file).read_bytes()
            _check_length(file, data[:16], len(data))
            chunk = np.frombuffer(Blosc().decode(data), array.dtype.newbyteorder("<")).reshape(array.chunks)
            return np.array(chunk[: len(presses)], array.dtype)
    check_frames(array, root, name)
    return array[presses.start : presses.stop]


def check_frames(array: zarr.Array, root: Path, name: str) -> None:
    """Raise `ValueError` if a file of an array that Blosc has compressed is not as long as its header says.

    c-blosc would read beyond its end and end the process.
    """
    if not any(isinstance(codec, BloscCodec) for codec in array.metadata.codecs):
        return
    for file in (root / name / "c").rglob("*"):
        if file.is_file():
            with open(file, "rb") as opened:
                _check_length(file.relative_to(root).as_posix(), opened.read(16), file.stat().st_size)


def _check_length(file: str, head: bytes, size: int) -> None:
    """Compare a file's size with its header: the last four bytes of its first 16 are the compressed size."""
    if len(head) < 16 or int.from_bytes(head[12:], "little") != size:
        raise ValueError(f"{file}: not what Blosc writes")


def is_sharded(array: zarr.Array) -> bool:
    return any(isinstance(codec, ShardingCodec) for codec in array.metadata.codecs)
