"""`simgen calibrate-optics --positions` from end to end: simulated presses under another camera give that camera."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from refusal import check_refusal, contents, rows, simgen

from simgen.config.resources import resource
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensing.camera.calibrate_camera import fit_to_positions
from simgen.sensing.camera.image_files import png
from simgen.sensing.camera.photometric_gel import PhotometricGel, photometry_of
from simgen.sensing.camera.undeformed_gel import undeformed_depth
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import load_sensor
from simgen.sensors.sensor_geometry import load_geometry
from simgen.simulation.press import Scene, press
from simgen.units import MM, MM_PER_M

RADIUS_MM = 3.0
TRUE_VIEW, AWAY_MM = 55.0, np.array([0.8, 0.0, 0.6])  # degrees; the sensor.yaml has 48.3 and no such offset
TURN, ZERO_MM = 92.0, 1.0 + 0.5j  # degrees of the stage's x from the image's right; its zero, right + i up
NAMES = [f"{number:02}.png" for number in range(12)]


def ball_poses(surface, places: np.ndarray) -> np.ndarray:
    """Poses (n, 4, 4) of a ball that just touches the gel over places (n, 2) m, x and z, and presses along y."""
    points = np.concatenate([surface.vertices, surface.triangles_center])
    radius, found = RADIUS_MM * MM, []
    for x, z in places:
        square = (points[:, 0] - x) ** 2 + (points[:, 2] - z) ** 2
        near = (square < radius**2) & (points[:, 1] < -4.5 * MM)
        middle = (points[near, 1] - np.sqrt(radius**2 - square[near])).min()
        pose = np.eye(4)
        pose[:3, 3] = x, middle + radius, z
        found.append(pose)
    return np.array(found)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Pictures of presses of a ball with friction, and the stage's positions. In ``noisy``, with noise."""
    sensor = load_sensor("digit", "coarse")
    own = sensor.cameras["default"]
    camera = replace(own, vertical_field_of_view_deg=TRUE_VIEW, position=own.position + MM * AWAY_MM)
    grid = np.stack(np.meshgrid([-12.5, -9.0, -6.0, -3.0], [-4.0, 0.2, 4.0]), axis=-1).reshape(-1, 2)
    random = np.random.default_rng(0)
    places = grid + random.normal(0.0, 0.3, grid.shape)
    scene = Scene(sensor, sensor.materials["solid"], batch=6, outputs=("height_map",), camera=camera)
    ball = rigid_shape(Kind.SPHERE, RADIUS_MM)
    results = press(scene, [ball] * len(places), ball_poses(sensor.surface, MM * places), np.array([0.3, 0.5]) * MM)
    pinhole = Pinhole.of(camera)
    gel = PhotometricGel(undeformed_depth(load_geometry("digit"), pinhole), pinhole, photometry_of(camera))
    folder = tmp_path_factory.mktemp("pressed")
    (folder / "noisy").mkdir()
    lines = ["file,x_mm,y_mm"]
    for number, (name, place, result) in enumerate(zip(NAMES, places, results, strict=True)):
        height = result.height_map[number % 2] * scene.height_step_m
        levels = np.nan_to_num(gel.picture(gel.rest_depth - height))
        for file, noise in ((folder / name, 0.0), (folder / "noisy" / name, 1.5)):
            picture = np.clip(levels + random.normal(0.0, 1.0, levels.shape) * noise, 0.0, 255.0)
            file.write_bytes(png(np.rint(picture).astype(np.uint8)))
        right, up, _ = pinhole.in_view(MM * np.array([place[0], 0.0, place[1]])) * MM_PER_M
        stage = np.conj((right + 1j * up - ZERO_MM) * np.exp(-1j * np.radians(TURN)))  # mirrored
        lines.append(f"{name},{stage.real:.4f},{stage.imag:.4f}")
    for where in (folder, folder / "noisy"):
        (where / "positions.csv").write_text("\n".join(lines) + "\n")
        (where / "nothing.png").write_bytes(png(np.rint(gel.background).astype(np.uint8)))
    zero = pinhole.position * MM_PER_M + np.array([ZERO_MM.real, ZERO_MM.imag, 0.0]) @ pinhole.axes
    (folder / "origin.txt").write_text(",".join(f"{each:.4f}" for each in zero))
    return folder


def fitted(folder: Path, origin: str | None = None) -> tuple[str, dict]:
    pictures = [folder / name for name in NAMES]
    lines = list(
        fit_to_positions(pictures, folder / "nothing.png", RADIUS_MM, "digit", folder / "positions.csv", origin)
    )
    return "\n".join(lines[:-1]), yaml.safe_load(lines[-1])["cameras"]["default"]


def numbers(pattern: str, said: str) -> list[float]:
    return [float(each) for each in re.search(pattern, said).groups()]


@pytest.mark.parametrize("where", [".", "noisy"])
@pytest.mark.parametrize("is_placed", [False, True])
def test_simulated_presses_give_their_camera_back(folder, where, is_placed):
    """Scale to 1 %, centre to 0.1 mm, rotation to half a degree."""
    said, camera = fitted(folder / where, (folder / "origin.txt").read_text() if is_placed else None)
    true_focal, own_focal = (160.0 / np.tan(0.5 * np.radians(view)) for view in (TRUE_VIEW, 48.3))
    (apex,) = numbers(r"is for ([\d.]+) mm from the gel's apex", said)
    (scale,), own = numbers(r"apex: ([\d.]+) \+- [\d.]+ pixels per mm", said), own_focal / apex
    assert scale == pytest.approx(true_focal / apex, rel=0.01)
    assert numbers(r"the sensor.yaml's camera has ([\d.]+) pixels per mm", said) == pytest.approx([own], abs=0.01)
    centre = np.conj(-ZERO_MM * np.exp(-1j * np.radians(TURN)))
    assert numbers(r"stage at x = (\S+) \+- \S+ mm, y = (\S+) ", said) == pytest.approx(
        [centre.real, centre.imag], abs=0.1
    )
    assert numbers(r"runs ([\d.]+) \+-", said) == pytest.approx([TURN], abs=0.5) and "axes are mirrored" in said
    own = load_sensor("digit", "coarse").cameras["default"].position * MM_PER_M
    expected = own + AWAY_MM if is_placed else own
    assert camera["position_mm"] == pytest.approx(expected, abs=0.1 if is_placed else 1e-4)
    assert camera["vertical_field_of_view_deg"] == pytest.approx(TRUE_VIEW, abs=0.5)


def test_the_section_is_a_sensor_s(folder, tmp_path, monkeypatch, capfd):
    """With it in place, the same pictures agree with the sensor.yaml, and nothing is said of a wrong camera."""
    model = tmp_path / "mine"
    shutil.copytree(resource("sensor_models") / "digit", model)
    _, camera = fitted(folder, (folder / "origin.txt").read_text())
    description = yaml.safe_load((model / "sensor.yaml").read_text())
    description["cameras"]["default"] = camera
    (model / "sensor.yaml").write_text(yaml.safe_dump(description))
    monkeypatch.chdir(folder)
    command = f"calibrate-optics {' '.join(NAMES)} --background nothing.png --radius-mm 3 --positions positions.csv"
    before = contents(folder)
    code, output, errors = simgen(f"{command} --sensor {model}", monkeypatch, capfd)
    assert (code, errors) == (0, "") and contents(folder) == before
    again = yaml.safe_load(output[output.index("cameras:") :])["cameras"]["default"]
    assert "is wrong" not in output and "kept over the place of the sensor.yaml" in output
    assert again["vertical_field_of_view_deg"] == pytest.approx(camera["vertical_field_of_view_deg"], abs=0.02)


ALL = "a.png b.png c.png --background nothing.png --radius-mm 3"
GOOD = "a.png,0,0\nb.png,1,0\nc.png,0,1\n"
BAD = rows([
    ("a stranger", ALL, GOOD + "d.png,2,2\n", "d.png is none of the pictures; allowed: their names"),
    ("no number", ALL, "a.png,0,0\nb.png,1,x\nc.png,0,1\n", "p.csv: line 3: y_mm 'x': allowed: a number of mm"),
    ("twice", ALL, GOOD + "a.png,2,2\n", "p.csv: line 5: file 'a.png': allowed: each picture once"),
    ("columns", ALL, "file,x,y\na.png,0,0\n", "p.csv: first line 'file,x,y': allowed: file,x_mm,y_mm"),
    ("no file", f"{ALL} --positions q.csv", GOOD, "q.csv: cannot be read: No such file"),
    ("two places", ALL, "a.png,0,0\nb.png,1,0\nc.png,1,0\n", "p.csv: 2 different places; allowed: 3 and more, not on"),
    ("a line", ALL, "a.png,0,0\nb.png,1,1\nc.png,2,2.01\n", "p.csv: all places lie on one line, to "),
    ("no position", ALL, "a.png,0,0\nb.png,1,0\n", "p.csv: no position of c.png; allowed: a line for each picture"),
    ("no picture", "--background nothing.png --radius-mm 3", GOOD, "PICTURE is missing; allowed with --positions: "),
    ("no background", "a.png --radius-mm 3", GOOD, "--background is missing; allowed with --positions: PICTURE... "),
    ("no radius", "a.png --background nothing.png", GOOD, "--radius-mm is missing; allowed with --positions: "),
    ("radius", ALL.replace("mm 3", "mm 0"), GOOD, "--radius-mm 0: allowed: more than 0, at most 1000"),
    ("an output", f"{ALL} -o t.npz", GOOD, "-o t.npz: fits colours; allowed with --positions: neither -o nor --simu"),
    ("simulate", f"{ALL} --simulate", GOOD, "--simulate: fits colours; allowed with --positions: neither"),
    ("origin", f"{ALL} --origin=1,2", GOOD, "--origin '1,2': write it as X,Y,Z in mm, such as -7.56,-8.3,0"),
    ("origin", f"{ALL} --origin=1,2,nan", GOOD, "--origin '1,2,nan': write it as X,Y,Z in mm"),
    ("no contact", ALL, GOOD, "3 of 3 pictures left out; allowed: at most half; the first: a.png: no contact"),
    ("no camera", f"{ALL} --sensor biotac", GOOD, "biotac/sensor.yaml: no camera; allowed: a sensor with one"),
    ("aspect", ALL.replace("nothing", "wide"), GOOD, "picture of 320 x 240 pixels: allowed: sides in the ratio"),
    ("circles", f"{ALL} --circles c.csv", GOOD, "c.csv: cannot be read: No such file"),
])  # fmt: skip


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    for name in ("a.png", "b.png", "c.png", "nothing.png"):
        (tmp_path / name).write_bytes(png(np.full((320, 240, 3), 90, np.uint8)))
    (tmp_path / "wide.png").write_bytes(png(np.full((240, 320, 3), 90, np.uint8)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("command", "positions", "words"), BAD)
def test_bad_input_is_one_line_and_nothing_is_written(workplace, monkeypatch, capfd, command, positions, words):
    header = "" if positions.startswith("file") else "file,x_mm,y_mm\n"
    (workplace / "p.csv").write_text(header + positions)
    before = contents(workplace)
    # Of an option that is given twice, the last counts.
    check_refusal(*simgen(f"calibrate-optics --positions p.csv {command}", monkeypatch, capfd), words)
    assert contents(workplace) == before


def test_an_origin_needs_positions(workplace, monkeypatch, capfd):
    words = "--origin 0,0,0: no --positions; allowed: with --positions FILE"
    check_refusal(*simgen(f"calibrate-optics {ALL} -o t.npz --origin 0,0,0", monkeypatch, capfd), words)


def test_given_imprints_count(workplace, monkeypatch, capfd):
    """Four imprints at the corners of a square; the pictures themselves show nothing."""
    corners = {"a.png": (80, 120), "b.png": (160, 120), "c.png": (80, 200), "nothing.png": (160, 200)}
    lines = [f"{name},{column},{row},15" for name, (column, row) in corners.items()]
    (workplace / "c.csv").write_text("\n".join(["file,column,row,radius", *lines]) + "\n")
    (workplace / "p.csv").write_text("file,x_mm,y_mm\na.png,-2,2\nb.png,2,2\nc.png,-2,-2\nnothing.png,2,-2\n")
    command = f"calibrate-optics nothing.png {ALL} --positions p.csv --circles c.csv"
    code, output, errors = simgen(command, monkeypatch, capfd)
    assert (code, errors) == (0, "") and "p.csv: of 4 pictures; " in output
    assert numbers(r"x = (\S+) \+- \S+ mm", output) == pytest.approx([0.0], abs=0.1)
    assert "axes are not mirrored" in output
    assert numbers(r"runs (\S+) \+-", output) == pytest.approx([0.0], abs=1.0)


@pytest.mark.parametrize("origin", ["100,0,0", "-7.56,0,1e6"])
def test_an_origin_beside_the_gel_is_refused(workplace, monkeypatch, capfd, origin):
    (workplace / "c.csv").write_text("file,column,row,radius\na.png,80,120,15\nb.png,160,120,15\nc.png,80,200,15\n")
    (workplace / "p.csv").write_text("file,x_mm,y_mm\na.png,-2,2\nb.png,2,2\nc.png,-2,-2\n")
    command = f"calibrate-optics {ALL} --positions p.csv --circles c.csv --origin={origin}"
    check_refusal(
        *simgen(command, monkeypatch, capfd), "p.csv: the camera finds no place over the gel; allowed: an --or"
    )


def test_a_picture_off_its_position_is_named(workplace, monkeypatch, capfd):
    names = [f"{number}.png" for number in range(6)]
    for name in names:
        shutil.copy(workplace / "a.png", workplace / name)
    places = np.array([[-2, 2], [2, 2], [-2, -2], [2, -2], [0, 0], [1, -1]], float)
    imprints = np.array([119.5, 159.5]) + 20.0 * places * [1.0, -1.0]
    places[4] += 1.5
    for file, header, values in (("c.csv", "column,row,radius", np.column_stack([imprints, np.full(6, 15.0)])),
                                 ("p.csv", "x_mm,y_mm", places)):  # fmt: skip
        lines = [",".join([name, *map(str, each)]) for name, each in zip(names, values, strict=True)]
        (workplace / file).write_text("\n".join([f"file,{header}", *lines]) + "\n")
    command = f"{' '.join(names)} --background nothing.png --radius-mm 3 --positions p.csv --circles c.csv"
    code, output, errors = simgen(f"calibrate-optics {command}", monkeypatch, capfd)
    assert (code, errors) == (0, "")
    said = output.splitlines()
    assert re.fullmatch(r"outlier: 4\.png: [\d.]+ pixels from its position; not used", said[0])
    assert said[1].startswith("p.csv: of 5 of 6 pictures; ")
