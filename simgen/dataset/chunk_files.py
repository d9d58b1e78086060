"""The files that hold some presses of an array, and arrays of thousands of chunks read fast.

zarr works in one thread of the process, however many shards are written or audited side by side, and spends 0.3 to
0.7 ms of Python on each chunk, 2 to 3 ms on an array. Displacements have a chunk for every sample, 720 in a shard of
36 presses: zarrs writes and reads them without Python in between. The other arrays, thirty of them, have a single
chunk in a shard, which is made here.
"""

import os
import shutil
import tempfile
import threading
from collections.abc import Collection
from functools import cache
from pathlib import Path

import numpy as np
import zarr
from numcodecs import Blosc
from zarr.codecs import BloscCodec, ShardingCodec
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import LocalStore, MemoryStore

from simgen.errors import system_errors

# Level 5 makes samples 2.4 % smaller in five times the time: more than four threads of a GPU's machine had.
COMPRESSION = {"cname": "zstd", "clevel": 2}  # and byte shuffle

# With one thread the chunks of a file are in the same order every time; shards are what is done side by side. What
# zarrs cannot do it refuses, or the bytes would depend on who wrote them.
PIPELINE = {
    "codec_pipeline.path": "zarrs.ZarrsCodecPipeline",
    "codec_pipeline.strict": True,
    "threading.max_workers": 1,
}
# Settings are the process's, and an array keeps those that it was opened with. Arrays that others open meanwhile get
# them, too: those in a folder are then read by zarrs, those in memory by zarr as ever.
OPENING = threading.Lock()


@cache
def make_threads():
    """Have zarr make the threads in which it calls zarrs: once in a process, as many as it has cores.

    The pipeline's single thread would be all that a process has, and shards would wait for each other.
    """
    with zarr.config.set({"threading.max_workers": max(4, os.cpu_count() or 1)}):
        zarr.open_group(MemoryStore(), mode="w")


def open_sharded(root: Path, name: str, mode: str = "r") -> zarr.Array:
    """A sharded array of the zarr group in a folder."""
    with OPENING:
        make_threads()
        with zarr.config.set(PIPELINE):
            return zarr.open_array(LocalStore(root), path=name, mode=mode)


def sharded_files(root: Path, name: str, presses: range, stored: np.ndarray, aside: Path) -> dict[str, bytes]:
    """Files, by path below ``root``, that hold ``stored`` (presses, ...) at these presses of a sharded array.

    They are made in a folder below ``aside``, which is removed.
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
    # zarrs makes none for fill values alone.
    to_buffer = default_buffer_prototype().buffer.from_bytes
    contents = {f"{name}/zarr.json": to_buffer((root / name / "zarr.json").read_bytes())}
    # A setting of this array alone: zarr's own are the process's, and shards are written side by side.
    array = zarr.open_array(MemoryStore(contents), path=name, mode="r+").with_config({"write_empty_chunks": True})
    array[rows] = stored
    return {key: buffer.to_bytes() for key, buffer in contents.items() if not key.endswith("zarr.json")}


def chunk_path(name: str, number: int, dimensions: int) -> str:
    """Path of the file that holds the presses of a shard, by its number; no other axis is divided."""
    return "/".join([name, "c", str(number), *["0"] * (dimensions - 1)])


def chunk_file(
    name: str, number: int, stored: np.ndarray, presses_per_chunk: int, fill: float
) -> dict[str, bytes]:
    """The one file, by path, that holds ``stored`` (presses, ...) in an array of which a chunk is all of some presses.

    Little-endian numbers in C order, then Blosc: the codecs of zarr v3 that ``COMPRESSION`` stands for.
    """
    chunk = np.full((presses_per_chunk, *stored.shape[1:]), fill, stored.dtype.newbyteorder("<"))
    chunk[: len(stored)] = stored
    codec = Blosc(shuffle=Blosc.SHUFFLE, typesize=chunk.itemsize, **COMPRESSION)
    return {chunk_path(name, number, stored.ndim): codec.encode(chunk)}


def check_frames(array: zarr.Array, root: Path, name: str, not_read: Collection[str]) -> None:
    """Raises `ValueError` where a file of an array that Blosc has compressed is not as long as it says.

    c-blosc would read beyond its end, and the process would end there. Files at the paths ``not_read`` are left out.
    """
    if not any(isinstance(codec, BloscCodec) for codec in array.metadata.codecs):
        return
    for file in (root / name / "c").rglob("*"):
        if file.is_file() and file.relative_to(root).as_posix() not in not_read:
            with open(file, "rb") as opened:
                head = opened.read(16)  # version, version of the codec, flags, item, length, block, compressed length
            if len(head) < 16 or int.from_bytes(head[12:], "little") != file.stat().st_size:
                raise ValueError(f"{file.relative_to(root)}: not what Blosc writes")


def is_sharded(array: zarr.Array) -> bool:
    return any(isinstance(codec, ShardingCodec) for codec in array.metadata.codecs)
