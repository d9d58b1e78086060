"""Recordings translated: which samples, from which signals, into which files."""

import h5py
import numpy as np
import pytest
import torch

from simgen.dataset.folder_lock import locked
from simgen.errors import InputError
from simgen.learning.data.schema import RecordingFiles
from simgen.learning.evaluation.contact import ContactGauge
from simgen.learning.translation.hypothesis_files import FILE, table
from simgen.learning.translation.presses import STEPS
from simgen.learning.translation.recordings import (
    AT_ONCE,
    Recording,
    Several,
    translate_block,
    translate_recordings,
)
from simgen.learning.translation.translator import Translator
from simgen.sensing.camera.image_files import read_image
from tests.learning import touched

PLAIN = RecordingFiles(files=("any",))
COUNT = 230  # samples of a file, of which every fifth is free: number 4, 9, 14, ...
FELT = np.flatnonzero(np.arange(COUNT) % 5 != 4)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return touched.record(tmp_path_factory.mktemp("recorded") / "monday.h5", COUNT, meshes=False)


@pytest.fixture(scope="module")
def stored(file) -> np.ndarray:
    with h5py.File(file) as opened:
        return opened["electrode_vals/data"][()]


@pytest.fixture(scope="module")
def translator(networks) -> Translator:
    return Translator.load(networks, "ours")


@pytest.fixture(scope="module")
def made(file, translator, renderer, tmp_path_factory):
    """The folder of all images of a file, and how many there were in each block."""
    folder = tmp_path_factory.mktemp("images")
    return folder, list(translate_recordings([Recording.read(file, PLAIN)], folder, translator, renderer, True))


def test_samples_in_contact_alone_are_translated(file, stored):
    found = Recording.read(file, PLAIN)
    assert np.array_equal(found.samples, FELT) and np.array_equal(found.signals, stored[FELT])
    free = np.setdiff1d(np.arange(COUNT), FELT)
    np.testing.assert_allclose(found.at_rest, stored[free].mean(axis=0), rtol=1e-12)


def test_contact_begins_at_the_force_that_the_job_says(file):
    with h5py.File(file) as opened:
        force = np.linalg.norm(opened["force_vec/data"][()], axis=1)
    least = float(np.median(force))
    found = Recording.read(file, RecordingFiles(files=("any",), least_force_n=least))
    assert np.array_equal(found.samples, np.flatnonzero(force >= least)) and 0 < len(found.samples) < len(FELT)


def test_drift_is_taken_off_if_the_job_says_so(file, stored):
    """The free samples drift in a straight line, from 0 to 50 times the electrode's number, and by nothing else."""
    found = Recording.read(file, RecordingFiles(files=("any",), remove_drift=True))
    drift = np.linspace(0.0, 50.0, COUNT)[:, None] * np.arange(19)
    np.testing.assert_allclose(found.signals, (stored - drift)[FELT], rtol=1e-9)
    np.testing.assert_allclose(found.at_rest, 2000.0, rtol=1e-9)


def test_without_a_free_sample_rest_is_the_mean_of_all(file, tmp_path):
    with h5py.File(file) as old, h5py.File(tmp_path / "all.h5", "w") as new:
        for key in ("electrode_vals/data", "contact_loc/data", "force_vec/data"):
            new[key] = old[key][()][FELT]
    found = Recording.read(tmp_path / "all.h5", PLAIN)
    assert len(found.samples) == len(FELT)
    np.testing.assert_allclose(found.at_rest, found.signals.mean(axis=0), rtol=1e-12)


@pytest.mark.parametrize("chosen", [range(0, 10), range(3, 6), range(220, 999_999_999)])
def test_chosen_samples_are_numbers_in_the_file(file, stored, chosen):
    """The end excluded; free ones among them are left out. An end beyond the file's is the file's."""
    found = Recording.read(file, PLAIN, chosen)
    expected = [number for number in FELT.tolist() if chosen.start <= number < chosen.stop]
    assert found.samples.tolist() == expected and np.array_equal(found.signals, stored[expected])
    assert np.array_equal(found.at_rest, Recording.read(file, PLAIN).at_rest)  # of all of the file


@pytest.mark.parametrize("chosen", [range(4, 5), range(COUNT, COUNT + 5)])
def test_chosen_samples_without_contact_are_one_line(file, chosen):
    words = rf"monday\.h5: --samples {chosen.start}:{chosen.stop}: none of them is in contact; the file has {COUNT}$"
    with pytest.raises(InputError, match=words):
        Recording.read(file, PLAIN, chosen)


def test_a_file_without_contact_is_one_line(file):
    with pytest.raises(InputError, match=r"monday\.h5: no sample has a force of 50 N; allowed: some contact"):
        Recording.read(file, RecordingFiles(files=("any",), least_force_n=50.0))


def test_a_folder_for_each_hundred_samples(made):
    folder, counts = made
    assert AT_ONCE == 100 and counts == [80, 80, 24]
    names = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()} - {".lock"}
    blocks = ("000000", "000100", "000200")
    images = {f"monday/{sample // 100 * 100:06d}/{sample:06d}.png" for sample in FELT}
    assert names == images | {f"monday/{block}/{STEPS}" for block in blocks}


def test_an_image_is_what_the_camera_sees_of_the_translated_mesh(made, stored, translator, renderer):
    """Networks are asked a block at a time, so that what they say is the same to the bit."""
    folder, _ = made
    block = FELT[FELT < 100]
    expected = renderer(translator(stored[block]).target)
    for sample, image in zip(block, expected, strict=True):
        assert np.array_equal(read_image(folder / "monday" / "000000" / f"{sample:06d}.png"), image)


def test_what_lies_between_is_kept(made, stored, translator):
    folder, _ = made
    block = FELT[(FELT >= 100) & (FELT < 200)]
    expected = translator(stored[block])
    with np.load(folder / "monday" / "000100" / STEPS) as found:
        assert np.array_equal(found["signals"], stored[block])
        assert np.array_equal(found["latent_rm2rm"], expected.latents["rm2rm"])
        assert np.array_equal(found["source_displacement"], expected.source)
        assert np.array_equal(found["target_displacement"], expected.target)


def test_steps_are_written_if_they_are_asked_for(file, translator, renderer, tmp_path):
    recording = Recording.read(file, PLAIN, range(0, 10))
    assert list(translate_recordings([recording], tmp_path, translator, renderer, False)) == [8]
    assert not list(tmp_path.rglob(STEPS)) and len(list(tmp_path.rglob("*.png"))) == 8


def test_a_sample_has_an_image_of_each_hypothesis(file, with_electrodes, networks, renderer, tmp_path):
    several = Several(3, ContactGauge.of_dataset(with_electrodes, "digit"))
    translator = Translator.load(touched.spread(networks, tmp_path / "networks"), "points")
    recording = Recording.read(file, PLAIN, range(0, 10))
    assert list(translate_recordings([recording], tmp_path, translator, renderer, True, several)) == [8]
    folder, found = tmp_path / "monday" / "000000", translator(recording.signals, 3)
    assert len(list(folder.glob("*.png"))) == np.count_nonzero(found.probability) > 8
    row = int(found.probability[:, 1].argmax())
    for k, end in enumerate((".png", ".hypothesis2.png")):
        image = read_image(folder / f"{recording.samples[row]:06d}{end}")
        assert np.array_equal(image, renderer(found.hypotheses[[row], k])[0])
    places = several.contact.centroids(torch.from_numpy(found.hypotheses)).numpy()
    expected = table(recording.samples, found.probability, places)
    assert (folder / FILE).read_bytes() == expected
    with np.load(folder / STEPS) as steps:
        assert np.array_equal(steps["hypotheses"], found.hypotheses, equal_nan=True)


def test_blocks_that_are_there_are_not_made_again(file, translator, renderer, tmp_path):
    recording = Recording.read(file, PLAIN)
    some = translate_recordings([recording], tmp_path, translator, renderer, False)
    assert next(some) == 80
    some.close()  # stopped
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.png")}
    assert list(translate_recordings([recording], tmp_path, translator, renderer, False)) == [0, 80, 24]
    assert len(before) == 80 and all(path.stat().st_mtime_ns == when for path, when in before.items())


def test_one_process_at_a_time(file, translator, renderer, tmp_path):
    recording = Recording.read(file, PLAIN, range(0, 10))
    with locked(tmp_path), pytest.raises(InputError, match="is being written by process "):
        list(translate_recordings([recording], tmp_path, translator, renderer, False))
    assert not (tmp_path / "monday").exists()


def test_meshes_beside_the_signals_are_not_read(tmp_path):
    """A recording may hold more of them than memory does."""
    path = touched.record(tmp_path / "meshes.h5", 10)
    plain = Recording.read(path, PLAIN)
    with h5py.File(path, "a") as opened:
        del opened["nodal_res"]
        opened["nodal_res"] = np.zeros(3)  # which would be one line
    assert np.array_equal(Recording.read(path, PLAIN).signals, plain.signals)


def test_a_million_samples_are_shared_out(tmp_path):
    recording = Recording(tmp_path / "long.h5", np.zeros((0, 19)), np.arange(7, 10**6 + 7), np.zeros(19))
    blocks = recording.blocks(tmp_path)
    assert len(blocks) == 10_001 and np.array_equal(np.concatenate(list(blocks.values())), np.arange(10**6))
    assert len(blocks[tmp_path / "long" / "000000"]) == 93


def test_files_do_not_mix(file, translator, renderer, tmp_path):
    other = touched.record(tmp_path / "tuesday.h5", 12, meshes=False, seed=1)
    recordings = [Recording.read(path, PLAIN, range(0, 12)) for path in (file, other)]
    (tmp_path / "images").mkdir()
    assert list(translate_recordings(recordings, tmp_path / "images", translator, renderer, False)) == [10, 10]
    first, second = (tmp_path / "images" / name / "000000" / "000003.png" for name in ("monday", "tuesday"))
    expected = renderer(translator(recordings[1].signals).target)
    assert np.array_equal(read_image(second), expected[3]) and first.exists()


def test_what_cannot_be_written_is_one_line(file, translator, renderer, tmp_path):
    (tmp_path / "monday").write_text("mine")
    recording = Recording.read(file, PLAIN, range(0, 10))
    ((folder, rows),) = recording.blocks(tmp_path).items()
    with pytest.raises(InputError, match="monday/000000: cannot be written: "):
        translate_block(recording, rows, folder, translator, renderer, False)
    assert (tmp_path / "monday").read_text() == "mine"
