"""Montages, animations and stages made of a dataset's images."""

import cv2
import pytest
from PIL import Image

from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.montages import write_gif, write_montages, write_stages

pytestmark = pytest.mark.usefixtures("made")


def test_a_montage_of_each_indenter(images, chosen):
    files = list(write_montages(images, chosen))
    assert [file.name for file in files] == [f"montage_{name}.png" for name in chosen.dataset.indenters]
    assert read_image(files[0]).shape == (3 * 64, 5 * 48, 3)


def test_a_press_in_motion(seen, images, renderer):
    folder = images.of_press(seen, 2)
    file = write_gif(folder, renderer.background)
    with Image.open(file) as gif:
        assert (gif.n_frames, gif.size) == (5, (48, 64))
    before = file.read_bytes()
    assert write_gif(folder, 255 - renderer.background) == file and file.read_bytes() == before
    assert write_gif(images.folder / "nothing", renderer.background) is None


def test_stages_of_an_image(seen, renderer, tmp_path):
    displacement = seen.displacement("digit", 0)[-1]
    write_stages(tmp_path / "stages.png", renderer, displacement, displacement, "a press")
    assert cv2.imread(str(tmp_path / "stages.png")).shape[0] > 800
