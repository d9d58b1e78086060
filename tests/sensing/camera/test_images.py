"""Images on disk: files, continuation, and one kind of images in a folder."""

import json
import shutil

import fake
import numpy as np
import pytest

from simgen.dataset.folder_lock import locked
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status
from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.images import Images, StoredSurfaces, render, unmade
from simgen.sensing.camera.renderer import Look, Renderer
from tests.sensing.camera.scenes import SMALL, dots_on_ball

pytestmark = pytest.mark.usefixtures("made")


def test_every_sample_has_the_image_that_the_renderer_makes(seen, images, renderer, made):
    assert made == [4] * seen.presses
    for press in (0, 5, 11):
        folder = images.of_press(seen, press)
        files = sorted(folder.iterdir())
        assert [file.name for file in files] == [f"{k:02d}_0.{k + 1}mm.png" for k in range(4)]
        for file, image in zip(files, renderer(seen.displacement("digit", press)), strict=True):
            np.testing.assert_array_equal(read_image(file), image)
    assert images.of_press(seen, 5).name == "t0001_texture_14mm"


def test_a_sample_inside_out_gets_no_image(seen, tmp_path):
    shutil.copytree(seen.path, tmp_path / "d.zarr")
    fake.change(Dataset(tmp_path / "d.zarr"), "digit/status", (0, 1), Status.INSIDE_OUT)
    steps, displacement, _ = StoredSurfaces(Dataset(tmp_path / "d.zarr"), "digit").of_press(0)
    expected = np.delete(np.arange(len(seen["depth"])), 1)
    assert steps.tolist() == expected.tolist() and len(displacement) == len(expected)


def test_workers_make_the_same_bytes(seen, images, chosen, renderer, tmp_path):
    other = Images(seen.path, "digit", tmp_path / "other.images", SMALL)
    assert sum(render(other, chosen, renderer, workers=2)) == 4 * seen.presses
    for file in images.folder.rglob("*mm.png"):
        assert (other.folder / file.relative_to(images.folder)).read_bytes() == file.read_bytes()


def test_dots_are_stored_beside_the_images_by_any_number_of_workers(seen, chosen, tmp_path):
    """A run that was stopped ends with the same bytes."""
    look = Look(height=64, width=48, markers=dots_on_ball(tmp_path / "dots.csv"), dot_mm=0.8)
    renderer = Renderer.of_dataset(seen, "digit", look)
    one, two = (Images(seen.path, "digit", tmp_path / name, look) for name in "ab")
    assert sum(render(one, chosen, renderer, workers=1)) == 4 * seen.presses
    some = render(two, chosen, renderer, workers=1)
    next(some)
    some.close()  # stopped
    assert len(list(render(two, chosen, renderer, workers=2))) == seen.presses - 1
    written = {file.relative_to(one.folder): file.read_bytes() for file in one.folder.rglob("*.*")}
    assert written == {file.relative_to(two.folder): file.read_bytes() for file in two.folder.rglob("*.*")}
    assert sum(file.name == "markers.npz" for file in written) == seen.presses
    np.testing.assert_array_equal(read_image(one.folder / "rest.png"), renderer.untouched)
    displacement = seen.displacement("digit", 3)
    stored = np.load(one.of_press(seen, 3) / "markers.npz")
    images, tracks = renderer.images_and_tracks(displacement)
    np.testing.assert_allclose(stored["displacement_px"], tracks.at - stored["rest_px"], atol=1e-5)
    np.testing.assert_array_equal(read_image(sorted(one.of_press(seen, 3).glob("*.png"))[-1]), images[-1])


def test_what_is_there_is_not_made_again(seen, chosen, renderer, tmp_path):
    images = Images(seen.path, "digit", tmp_path / "seen.images", SMALL)
    some = render(images, chosen, renderer, workers=1)
    assert [next(some), next(some)] == [4, 4]
    some.close()  # stopped
    before = {file: file.stat().st_mtime_ns for file in images.folder.rglob("*.png")}
    assert len(unmade(images, chosen)) == seen.presses - 2
    assert len(list(render(images, chosen, renderer, workers=1))) == seen.presses - 2
    assert len(before) == 8 and all(file.stat().st_mtime_ns == when for file, when in before.items())


@pytest.mark.parametrize(
    ("look", "complaint"),
    [
        (Look(height=32, width=24), r"holds other images: size: \[48, 64\] -> \[24, 32\]; choose another --output"),
        (Look(height=64, width=48, camera="tacto"), r"holds other images: camera\.field_of_view_deg: 48\.3 -> 60\.0"),
        (Look(height=64, width=48, blur=None), "holds other images: kernels: "),
        (Look(height=64, width=48, blur="across"), "holds other images: kernels_around_contact: "),
    ],
)
def test_a_folder_holds_one_kind_of_images(seen, images, chosen, look, complaint):
    other = Images(seen.path, "digit", images.folder, look)
    with pytest.raises(InputError, match=complaint):
        list(render(other, chosen, Renderer.of_dataset(seen, "digit", look), workers=1))


@pytest.mark.parametrize("content", [None, "", "[]", '{"size": 1}'])
def test_another_folder_is_one_line_and_stays(seen, chosen, renderer, tmp_path, content):
    (tmp_path / "own.txt").write_text("mine")
    if content is not None:
        (tmp_path / "render.json").write_text(content)
    with pytest.raises(InputError, match="choose another --output"):
        list(render(Images(seen.path, "digit", tmp_path, SMALL), chosen, renderer, workers=1))
    assert (tmp_path / "own.txt").read_text() == "mine" and not list(tmp_path.rglob("*.png"))


def test_two_processes_do_not_write_into_one_folder(images, chosen, renderer):
    with locked(images.folder), pytest.raises(InputError, match="is being written by process"):
        list(render(images, chosen, renderer, workers=1))


def test_the_record_says_what_decides_the_images(seen, images, renderer):
    record = json.loads((images.folder / "render.json").read_text())
    assert record["dataset"] == seen.attributes["job_hash"] and record["size"] == [48, 64]
    assert record["kernels"] == list(renderer.blur.sizes) and record["response"] == renderer.shading.response.hash
