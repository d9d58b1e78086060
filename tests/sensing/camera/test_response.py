"""Tables are read in the published layout, and their response to flat gel is subtracted."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.response import CHANNELS, Placement, Response


@pytest.fixture
def arrays() -> dict[str, np.ndarray]:
    random = np.random.default_rng(0)
    return {"bins": np.array([9]), **{name: random.normal(size=(9, 9, 6)) for name in CHANNELS}}


def saved(tmp_path, arrays) -> str:
    np.savez(tmp_path / "table.npz", **arrays)
    return tmp_path / "table.npz"


RED_FIRST, BLUE_FIRST = CHANNELS, CHANNELS[::-1]


@pytest.mark.parametrize(
    ("about", "red_green_blue"),
    [
        ({}, BLUE_FIRST),  # as published: channels of a picture as OpenCV reads it
        ({"source": "photometric model"}, RED_FIRST),  # our first files, which do not state an order
        ({"source": "photometric model", "channels": "bgr"}, BLUE_FIRST),
        ({"channels": "rgb"}, RED_FIRST),
    ],
)
def test_tables_are_read_in_the_order_of_their_channels(tmp_path, arrays, about, red_green_blue):
    table = Response.load(saved(tmp_path, arrays | about))
    assert (table.bins, table.width, table.height) == (9, 640, 480)
    for channel, name in enumerate(red_green_blue):
        np.testing.assert_array_equal(table.coefficients[channel], arrays[name])


def test_tables_are_written_as_published(tmp_path, arrays):
    table = Response(np.stack([arrays[name] for name in CHANNELS]))
    table.save(tmp_path / "own.npz")
    with np.load(tmp_path / "own.npz") as file:
        assert file["channels"] == "bgr"
        for channel, name in enumerate(BLUE_FIRST):
            np.testing.assert_array_equal(file[name], table.coefficients[channel].astype(np.float32))


def test_what_is_saved_is_loaded(tmp_path, arrays):
    table = Response(np.stack([arrays[name] for name in CHANNELS]), 320, 240)
    table.save(tmp_path / "own.npz")
    again = Response.load(tmp_path / "own.npz")
    assert (again.width, again.height) == (320, 240)
    np.testing.assert_array_equal(again.coefficients, table.coefficients.astype(np.float32))


def test_no_tilt_changes_nothing_in_any_direction(tmp_path, arrays):
    table = Response.load(saved(tmp_path, arrays)).from_flat()
    assert table.shape == (10, 8, 18)
    np.testing.assert_allclose(table[0], 0.0, atol=1e-15)
    green = table[4, 5, 6:12]  # the tilt of bin 3
    flat = arrays["grad_g"][0, :-1].mean(axis=0)
    np.testing.assert_allclose(green, arrays["grad_g"][3, 5] - flat, atol=1e-14)


def test_an_image_that_stands_is_turned_clockwise():
    standing, lying = Placement.of(640, 480, 480, 640), Placement.of(240, 320, 480, 640)
    assert (standing.turned, standing.scale, lying.turned, lying.scale) == (True, 1.0, False, 2.0)
    image = np.arange(640 * 480).reshape(640, 480)
    rows, columns = np.array([0, 639, 100]), np.array([0, 0, 30])
    x, y = standing.position(rows, columns)
    np.testing.assert_array_equal(np.rot90(image, -1)[y.astype(int), x.astype(int)], image[rows, columns])
    height = np.add.outer(3.0 * np.arange(640), 5.0 * np.arange(480))  # 3 from row to row, 5 from column to column
    down, right = np.gradient(np.rot90(height, -1))
    assert standing.slope(3.0, 5.0) == pytest.approx((right.mean(), down.mean()))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"grad_g": None}, "grad_g is missing; a table holds bins, grad_r, grad_g, grad_b"),
        ({"grad_b": np.zeros((9, 9, 5))}, "grad_b (9, 9, 5): allowed: (9, 9, 6) finite numbers"),
        ({"grad_r": np.full((9, 9, 6), np.nan)}, "grad_r (9, 9, 6): allowed: (9, 9, 6) finite numbers"),
        ({"bins": np.array([1])}, "bins 1: allowed: 3 to 10000"),
        ({"bins": np.array(["many"])}, "bins many: allowed: 3 to 10000"),
        ({"width": np.array([0])}, "width 0: allowed: 1 to 8192"),
        ({"grad_r": np.array([[None]])}, "not a file of numpy.savez"),
        ({"channels": np.array("grb")}, "channels 'grb': allowed: bgr, rgb"),
        ({"grad_r": np.full((9, 9, 6), "red")}, "grad_r (9, 9, 6): allowed: (9, 9, 6) finite numbers"),
    ],
)
def test_another_file_is_one_line(tmp_path, arrays, change, complaint):
    file = saved(tmp_path, {name: value for name, value in (arrays | change).items() if value is not None})
    with pytest.raises(InputError) as raised:
        Response.load(file)
    assert str(raised.value).startswith(f"{file}: {complaint}") and "\n" not in str(raised.value)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 and no more", b"a text"])
def test_no_archive_is_one_line(tmp_path, content):
    (tmp_path / "table.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"table\.npz: not a file of numpy\.savez"):
        Response.load(tmp_path / "table.npz")
    with pytest.raises(InputError, match=r"nowhere\.npz: cannot be read"):
        Response.load(tmp_path / "nowhere.npz")
