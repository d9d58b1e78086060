"""Shared options: defaults, and one line for what they do not allow."""

from pathlib import Path

import pytest

from simgen.cli.options import (
    height_and_width,
    named_after,
    process_count,
    sample_range,
    scheduler_address,
    smoothing,
)
from simgen.errors import InputError
from simgen.pipeline.workers import cores


def test_outputs_are_named_after_the_dataset():
    assert named_after(Path("folder/paired.zarr/"), ".html") == Path("paired.html")
    assert named_after(Path("folder/paired"), ".images") == Path("paired.images")


def test_a_gpu_is_fed_by_one_process_and_each_core_has_one():
    assert process_count(3, "cuda") == process_count(3, "cpu") == 3
    assert process_count(None, "cuda:0") == 1 and process_count(None, "cpu") == cores()


def test_an_address_comes_from_one_of_two_options(tmp_path):
    assert scheduler_address(None, None) is None and scheduler_address("tcp://host:1", None) == "tcp://host:1"
    file = tmp_path / "scheduler.json"
    file.write_text('{"address": "tcp://host:2"}')
    assert scheduler_address(None, file) == "tcp://host:2"
    with pytest.raises(InputError, match=r"--scheduler sync and --scheduler-file .*: allowed: one of them"):
        scheduler_address("sync", file)


def test_a_size_is_width_by_height():
    assert height_and_width(None) == (None, None) and height_and_width("480x640") == (640, 480)
    for size in ("480", "480x", "480x640x3", "-1x2"):
        with pytest.raises(InputError, match="write it as WIDTHxHEIGHT"):
            height_and_width(size)


def test_samples_are_a_range_that_is_not_empty():
    assert sample_range(None) is None and sample_range("3:7") == range(3, 7)
    for samples in ("7", "7:7", "7:3", "a:b"):
        with pytest.raises(InputError, match="write it as 0:200"):
            sample_range(samples)


def test_how_height_maps_are_smoothed_depends_on_their_source_unless_the_user_says():
    assert (smoothing(None, False), smoothing("across", False), smoothing(None, True)) == ("auto", "across", None)
    with pytest.raises(InputError, match="--no-blur: contradicts --blur across"):
        smoothing("across", True)
