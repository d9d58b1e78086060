"""Images under drawn optics: bytes follow from seed and press, and untouched gel is the drawn background."""

import json

import cv2
import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.drawn_optics import DrawnOptics
from simgen.sensing.camera.images import Images, render
from simgen.sensing.camera.renderer import Look, Renderer
from simgen.sensing.camera.varied_renderer import VariedRenderer, pictures_in, renderer_of

LOOK = Look(height=64, width=48, vary=7)


def made(seen, chosen, folder, workers: int = 1, look: Look = LOOK) -> dict[str, bytes]:
    images = Images(seen.path, "digit", folder, look)
    assert sum(render(images, chosen, renderer_of(seen, "digit", look), workers)) == 4 * seen.presses
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*.*") if file.is_file()}


@pytest.fixture(scope="module")
def own(seen, chosen, tmp_path_factory) -> dict[str, bytes]:
    return made(seen, chosen, tmp_path_factory.mktemp("varied") / "own")


def test_two_workers_make_the_same_bytes(seen, chosen, own, tmp_path):
    assert made(seen, chosen, tmp_path / "two", workers=2) == own


def test_a_press_alone_has_the_same_bytes(seen, own):
    renderer = renderer_of(seen, "digit", LOOK)
    alone = renderer.of_press(5)(seen.displacement("digit", 5))
    files = sorted(name for name in own if name.startswith("t0001_texture_14mm") and name.endswith(".png"))
    for name, image in zip(files, alone, strict=True):
        np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(own[name], np.uint8), 1)[..., ::-1], image)


def test_another_seed_makes_other_images_and_is_refused_in_the_same_folder(seen, chosen, own, tmp_path):
    other = Look(height=64, width=48, vary=8)
    new = made(seen, chosen, tmp_path / "other", look=other)
    assert new.keys() == own.keys() and all(new[name] != own[name] for name in new if name.startswith("t"))
    with pytest.raises(InputError, match="holds other images: vary: 8 -> 7; choose another --output"):
        made(seen, chosen, tmp_path / "other")


def test_drawn_values_are_beside_the_images(own):
    record = json.loads(own["t0001_texture_14mm/optics.json"])
    drawn = json.loads(json.dumps(DrawnOptics.draw(7, 5).record()))
    assert record.items() >= drawn.items() and np.shape(record["lights_m"]) == (3, 3)
    record = json.loads(own["render.json"])
    assert record["vary"] == 7 and record["ranges"]["noise"] == [0.8, 1.8]


def test_untouched_gel_is_the_drawn_background_up_to_noise(seen):
    renderer = renderer_of(seen, "digit", Look(height=128, width=96, vary=7)).of_press(3)
    off = renderer(np.zeros((2, *seen["digit/rest_positions"].shape))).astype(float) - renderer.background
    lit = (renderer.background > 8) & (renderer.background < 247)  # noise is cut at 0 and 255
    noise = DrawnOptics.draw(7, 3).noise
    assert abs(off[:, lit].mean()) < 0.02 and off[:, lit].std() == pytest.approx(np.hypot(noise, 12**-0.5), rel=0.05)


def test_a_press_changes_the_image_where_it_changes_it_for_one_sensor(seen):
    moved = seen.displacement("digit", 0)[-1:]
    plain = Renderer.of_dataset(seen, "digit", Look(height=64, width=48))
    varied = renderer_of(seen, "digit", LOOK).of_press(0)
    changed = np.abs(plain(moved)[0] - plain.background.astype(float)).max(axis=2) > 4.0
    change = np.abs(varied(moved)[0] - varied(np.zeros_like(moved))[0].astype(float)).max(axis=2)  # of equal noise
    assert changed.any() and change[changed].mean() > 3.0 * change[~changed].mean()


def test_shadows_take_the_drawn_lights(seen):
    moved = seen.displacement("digit", 0)[-1:]
    plain, dark = (renderer_of(seen, "digit", Look(height=64, width=48, vary=0, shadows=on)).of_press(0)(moved)
                   for on in (False, True))  # fmt: skip
    assert (dark <= plain).all() and (dark < plain).any()


def test_a_folder_with_a_bad_picture_is_refused_before_any_image(seen, tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.full((32, 24, 3), 60, np.uint8))
    (tmp_path / "b.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"b\.png"):
        renderer_of(seen, "digit", Look(height=64, width=48, vary=7, background=tmp_path))


def test_pictures_of_a_folder_are_the_backgrounds(seen, tmp_path):
    for level in (60, 120):
        cv2.imwrite(str(tmp_path / f"{level}.png"), np.full((32, 24, 3), level, np.uint8))
    (tmp_path / "README.md").write_text("two pictures")
    renderer = renderer_of(seen, "digit", Look(height=64, width=48, vary=7, background=tmp_path))
    presses = [renderer.of_press(press) for press in range(12)]
    for each in presses:
        record = json.loads(each.files["optics.json"])
        assert (each.background == int(record["background"].removesuffix(".png"))).all()
    assert {each.background.max() for each in presses} == {60, 120}
    assert renderer.record()["backgrounds"].startswith("2 pictures, sha256 ")


def test_a_picture_is_the_background_of_all(seen, tmp_path):
    cv2.imwrite(str(tmp_path / "one.png"), np.full((64, 48, 3), 77, np.uint8))
    renderer = renderer_of(seen, "digit", Look(height=64, width=48, vary=7, background=tmp_path / "one.png"))
    assert all((renderer.of_press(press).background == 77).all() for press in (0, 4))


def test_bad_input_is_one_line(seen, tmp_path):
    with pytest.raises(InputError, match=r"no picture in this folder; allowed: files that end in \.bmp, "):
        pictures_in(tmp_path)
    with pytest.raises(InputError, match="nowhere: cannot be read: No such file or directory"):
        VariedRenderer.of_dataset(seen, "digit", Look(vary=1, background=tmp_path / "nowhere"))
    with pytest.raises(InputError, match="--vary -1: allowed: 0 or more"):
        Look(vary=-1)
    with pytest.raises(InputError, match=r"--calibration a\.npz: contradicts --vary, which needs no table"):
        Look(table="a.npz", vary=1)
