"""Files of zarr arrays: what is made here is what zarr makes, and broken ones are refused before c-blosc reads them."""

import subprocess
import sys

import numpy as np
import pytest
import zarr
from zarr.codecs import BloscCodec

from simgen.dataset.chunk_files import (
    COMPRESSION,
    check_frames,
    chunk_file,
    chunk_path,
    is_sharded,
    open_sharded,
    read_chunk,
    sharded_files,
)

CODEC = BloscCodec(**COMPRESSION, shuffle="shuffle")


@pytest.fixture
def sharded(tmp_path):
    """A folder with the array ``a``: six presses, three in a shard, a chunk for each sample."""
    settings = {"shape": (6, 2, 4), "chunks": (1, 1, 4), "shards": (3, 2, 4), "dtype": "int16", "compressors": CODEC}
    zarr.open_group(tmp_path).create_array("a", fill_value=-1, **settings)
    return tmp_path


@pytest.mark.parametrize("presses", [3, 2])
def test_a_chunk_has_the_bytes_that_zarr_writes(tmp_path, presses):
    """Also if the last shard is short."""
    array = zarr.open_group(tmp_path).create_array(
        "force", shape=(3 + presses, 4), chunks=(3, 4), dtype="float64", fill_value=np.nan, compressors=CODEC
    )
    values = np.random.default_rng(0).normal(size=(presses, 4))
    array[3:] = values
    ((path, data),) = chunk_file("force", 1, values, 3, np.nan).items()
    assert path == chunk_path("force", 1, 2) == "force/c/1/0"
    assert data == (tmp_path / path).read_bytes()


@pytest.mark.parametrize("value", [7, -1])
def test_a_shard_is_read_back_also_if_it_holds_fill_values_alone(sharded, value):
    aside = sharded / "aside"
    aside.mkdir()
    files = sharded_files(sharded, "a", range(3, 6), np.full((3, 2, 4), value, np.int16), aside)
    assert list(files) == ["a/c/1/0/0"] and not list(aside.iterdir())
    (sharded / "a/c/1/0").mkdir(parents=True)
    (sharded / "a/c/1/0/0").write_bytes(files["a/c/1/0/0"])
    array = open_sharded(sharded, "a")
    assert is_sharded(array) and (array[3:] == value).all() and (array[:3] == -1).all()


@pytest.mark.parametrize("spoil", [lambda data: data[:-1], lambda data: b"", lambda data: data + b"x"])
def test_a_file_of_another_length_than_it_says_is_refused(tmp_path, spoil):
    array = zarr.open_group(tmp_path).create_array(
        "force", shape=(4, 4), chunks=(2, 4), dtype="float64", compressors=CODEC
    )
    array[:] = 1.0
    file = tmp_path / chunk_path("force", 1, 2)
    file.write_bytes(spoil(file.read_bytes()))
    last = tmp_path, "force", 1, array, range(2, 4)
    for read in (lambda: check_frames(array, tmp_path, "force"), lambda: read_chunk(*last)):
        with pytest.raises(ValueError, match="force/c/1/0: not what Blosc writes"):
            read()
    assert (read_chunk(tmp_path, "force", 0, array, range(2)) == 1.0).all()


@pytest.mark.parametrize("compressors", [CODEC, None])
@pytest.mark.parametrize("chunks", [(3, 4), (1, 4), (3, 2), (5, 4)])
@pytest.mark.parametrize("dtype", ["float64", "int8"])
def test_a_chunk_is_read_as_zarr_reads_it(tmp_path, compressors, chunks, dtype):
    """Also if the last shard is short, with other codecs, and with chunks that are not shards."""
    array = zarr.open_group(tmp_path).create_array(
        "force", shape=(5, 4), chunks=chunks, dtype=dtype, compressors=compressors
    )
    array[:] = 100.0 * np.random.default_rng(0).random((5, 4))
    for number, presses in enumerate((range(3), range(3, 5))):
        found = read_chunk(tmp_path, "force", number, array, presses)
        assert found.dtype == dtype
        np.testing.assert_array_equal(found, array[presses.start : presses.stop])


def test_shards_do_not_wait_for_each_others_threads():
    """zarr calls zarrs in the threads of its loop: in a new process there are several, not the pipeline's one.

    Two calls that wait for each other end only if both are under way.
    """
    code = """
import asyncio, tempfile, threading
from pathlib import Path
import zarr
from simgen.dataset.chunk_files import open_sharded
with tempfile.TemporaryDirectory() as folder:
    zarr.create_array(Path(folder) / "a", shape=(4, 4), chunks=(1, 4), shards=(4, 4), dtype="int16")
    array = open_sharded(Path(folder), "a", mode="r+")
    array[:] = 1
    both = threading.Barrier(2)
    async def meet():
        await asyncio.gather(*(asyncio.to_thread(both.wait, 20.0) for _ in range(2)))
    asyncio.run_coroutine_threadsafe(meet(), zarr.core.sync.loop[0]).result(30.0)
"""
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
