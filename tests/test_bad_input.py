"""Bad input of every kind: one line on stderr that says where, what and what is allowed, exit code 2, nothing written.

A row is what is wrong, how it is made in an empty folder, the command line, and words of the line.
"""

import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import fake
import numpy as np
import pytest
from bad_files import (
    JOB,
    POINTS,
    SLAB,
    SOLID,
    TETRAHEDRA,
    array,
    attributes,
    box,
    content,
    job,
    sensor,
    tet,
    text,
    truncated,
    write,
)
from refusal import check_refusal, contents, rows, simgen

from simgen.pipeline import workers
from simgen.pipeline.run import run
from simgen.sensors import shape_cache

DRY = "run job.yaml --dry-run"
BUNDLED = "biotac, digit, gelsight_mini"  # sensors
RUN = "run job.yaml --scheduler sync"
DEPTHS, SENSOR = JOB["depths_mm"], JOB["sensors"]["digit"]
BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 10)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
TURNED = TETRAHEDRA.copy()
TURNED[0] = TURNED[0, [0, 2, 1, 3]]
FLAT = POINTS.copy()
FLAT[TETRAHEDRA[0, 3]] = FLAT[TETRAHEDRA[0, :3]].mean(axis=0)
ANNOUNCED = (
    "ply\nformat ascii 1.0\nelement vertex 1000000000\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1000000000\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n"
)
BEYOND = np.vstack([TETRAHEDRA, [0, 1, 2, 10**9]])
NAN = b"v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 4 2\nf 2 4 3\nf 3 4 1\n"


FLATTENED = b"v 0 0 0\nv 0.01 0 0\nv 0 0.01 0\nv 0.01 0.01 0\nf 1 2 3\nf 1 4 2\nf 2 4 3\nf 3 4 1\n"
PROBABLY = "its unit is probably {0}: {{file: pin.stl, unit: {0}}}\n"


def plate(**of_plane) -> dict:
    return {"held": {"back": {"plane": {"axis": "y", "at_mm": 2.0, **of_plane}}}}


def pin(data: bytes | str | None, name: str = "pin.stl") -> dict:
    """A job that presses a user's own mesh."""
    return job(indenters=[f"./{name}"]) | {name: data}


JOBS = [
    ("broken YAML", text("a: ["), DRY, "job.yaml: line 14 not YAML:"),
    ("tabs", text(whole="name:\n\tseed: 1"), DRY, "job.yaml: line 2 not YAML: found character '\\t'"),
    ("Latin-1", text(whole=b"name: caf\xe9"), DRY, "job.yaml: not a text in UTF-8"),
    ("bytes", text(whole=bytes(range(256))), DRY, "job.yaml: not a text in UTF-8"),
    ("half of UTF-16", text(whole="name: x".encode("utf-16")[:-1]), DRY, "job.yaml: not a text in UTF-8"),
    ("a byte order mark is none", text(whole="\ufeffcolour: red"), DRY, "job.yaml: "),
    ("empty", text(whole=""), DRY, "job.yaml: not a mapping of keys to values, but empty"),
    ("a list", text(whole="- name"), DRY, "not a mapping of keys to values, but a list"),
    ("a word", text(whole="smoke"), DRY, "not a mapping of keys to values, but a str"),
    ("two documents", text("---\nname: b"), DRY, "line 14 not YAML: but found another document"),
    ("alias bomb", text(BOMB), DRY, "more than 1000000 values, with all aliases written out"),
    ("alias of itself", text("a: &a [*a]"), DRY, "nested too deep; allowed: 50 levels"),
    ("unknown alias", text("a: *b"), DRY, "found undefined alias 'b'"),
    ("key twice", text("name: again"), DRY, "key 'name' is given twice"),
    ("key twice inside", text("solver: {element: P1, element: P1}"), DRY, "key 'element' is given twice"),
    ("key that is a number", text("1: x"), DRY, "1 is not a key; allowed: a text"),
    ("key that is a list", text("? [a]\n: x"), DRY, "a sequence is not a key; allowed: a text"),
    ("Python in it", text("a: !!python/name:os.system"), DRY, "python/name:os.system is not allowed"),
    ("thousands of brackets", text("a: " + "[" * 9999), DRY, "job.yaml: nested too deep"),
    ("thousands of digits", text("seed: " + "9" * 9999), DRY, "job.yaml: not YAML: Exceeds the limit"),
    ("hundreds of digits", text("seed: " + "9" * 999), DRY, "seed: 9999"),
    ("control character", text(r'solver: {element: "\e[31m"}'), DRY, "has a control character"),
    ("four megabytes", text("#" * 4_000_000), DRY, "job.yaml: too large for YAML"),
    ("a folder", {"job.yaml": None}, DRY, "job.yaml: no such job file; bundled jobs: gelsight_mini"),
    ("no file", {}, DRY, "job.yaml: no such job file; bundled jobs: gelsight_mini"),
    ("a name too long", {}, f"run {'x' * 300}.yaml --dry-run", ".yaml: no such job file"),
    ("a home of nobody", {}, "run ~nobody-at-all/job.yaml --dry-run", "no such job file"),
    ("infinity", job(), f"{DRY} depths_mm.last=.inf", "depths_mm.last: Infinity is not allowed; allowed: above 0"),
    ("no number", job(), f"{DRY} depths_mm.first=.nan", "depths_mm.first: NaN is not allowed"),
    ("name a number", job(name=3), DRY, "name: 3 is not allowed; allowed: letters"),
    ("name with a space", job(name="bad name"), DRY, 'name: "bad name" is not allowed; allowed: letters'),
    ("name a path", job(name="../up"), DRY, 'name: "../up" is not allowed'),
    ("name too long", job(name="x" * 300), DRY, "100 at most"),
    ("unknown key", job(colour="red"), DRY, "colour: unknown key; allowed: name, seed"),
    ("unknown key inside", job(depths_mm={**DEPTHS, "step": 1}), DRY, "depths_mm.step: unknown key; allowed: first"),
    *[
        (f"wrong type of {key}", job(**{key: value}), DRY, f"{key}: {said} is not allowed; allowed: ")
        for key, value, said in [
            ("seed", "one", '"one"'),
            ("sensors", [], "[]"),
            ("sensors", {}, "{}"),
            ("indenters", {}, "{}"),
            ("indenters", [], "[]"),
            ("trajectories", 3, "3"),
            ("depths_mm", [], "[]"),
            ("solver", "fast", '"fast"'),
            ("dataset", "int16", '"int16"'),
        ]
    ],
    ("sensor a word", job(sensors={"digit": "digit"}), DRY, 'sensors.digit: "digit" is not allowed'),
    ("sensor without model", job(sensors={"digit": {}}), DRY, "sensors.digit.model: missing; allowed: a bundled"),
    *[
        (f"sensor named {name!r}", job(sensors={name: SENSOR}), DRY, "cannot name a sensor; allowed: letters")
        for name in ("press", "zarr.json", "a b", "1", "", "digit\n")
    ],
    ("unknown sensor", job(sensors={"digit": {"model": "finger"}}), DRY, f"sensor 'finger': allowed: {BUNDLED}"),
    ("unknown mesh", job(), f"{DRY} sensors.digit.mesh=finest", 'digit.mesh: "finest" is not allowed'),
    ("mesh not there", sensor() | job(sensors={"s": {"model": "./s", "mesh": "fine"}}), DRY, "meshes.fine: missing"),
    ("unknown preset", job(), f"{DRY} sensors.digit.material=wood", "'wood' is not a preset; allowed: solid"),
    ("no such camera", job(), f"{DRY} sensors.digit.camera=front", "digit.camera: 'front': allowed: default, tacto"),
    ("no cavity", job(), f"{DRY} sensors.digit.fluid=incompressible", "sensor digit has no cavity; allowed: none"),
    ("MPa for Pa", job(), f"{DRY} sensors.digit.material.youngs_modulus_pa=0.5", "0.5 is not allowed; allowed: 1000"),
    ("unknown indenter", job(), f"{DRY} indenters=[pyramid]", "no indenter 'pyramid'; allowed: sphere_3.5mm"),
    ("indenter twice", job(), f"{DRY} indenters=[a,b,a]", "indenters: 'a' is listed twice"),
    ("indenter's file gone", job(indenters=["./pin.stl"]), DRY, "pin.stl: no such file; an indenter's mesh is"),
    ("indenter a folder", pin(None), DRY, "pin.stl: no such file; an indenter's mesh is"),
    ("indenter open", pin(box(scale=1e-3, faces=slice(11))), DRY, "pin.stl: the surface is not watertight"),
    ("indenter empty", pin(b""), DRY, "pin.stl: no triangle"),
    ("indenter without faces", pin("v 0 0 0\n", "pin.obj"), DRY, "pin.obj: "),
    ("indenter no mesh", pin("# a story", "pin.ply"), DRY, "pin.ply: cannot be read as a surface mesh"),
    ("indenter in mm", pin(box()), DRY, "the shape is 20 m large; allowed: 0.0001..0.5 m; " + PROBABLY.format("mm")),
    *[(f"a pin of 0.4 in mm, {command}", pin(box(scale=0.02)), command, "the shape is 0.4 m large, spacing_mm: 0.2 "
       "makes 1.8e+09 grid points; allowed: 6.4e+07; " + PROBABLY.format("mm")) for command in (DRY, RUN)],
    ("indenter in m", job(indenters=[{"file": "pin.stl", "unit": "mm"}]) | {"pin.stl": box(scale=1e-3)}, RUN,
     "the shape is 2e-05 m large; allowed: 0.0001..0.5 m; " + PROBABLY.format("m")),
    ("grid too fine", job(indenters=[{"file": "pin.stl", "unit": "mm", "spacing_mm": 0.02}]) | {"pin.stl": box()}, RUN,
     "spacing_mm: 0.02 makes 8.6e+08 grid points; allowed: 6.4e+07\n"),
    ("indenter flat", pin(FLATTENED, "pin.obj"), DRY, "pin.obj: the surface encloses no volume"),
    ("indenter not a number", pin(NAN, "pin.obj"), DRY, "pin.obj: "),
    ("indenter of tetrahedra", pin(tet(), "pin.tet"), DRY, "no indenter"),
    ("depths reversed", job(), f"{DRY} depths_mm.first=0.5", "depths_mm: first must be less than last"),
    ("depths on one spot", job(), f"{DRY} depths_mm.last=0.1000000001", "allowed: 1e-06 mm or more"),
    ("depth of nothing", job(), f"{DRY} depths_mm.first=1e-300", "allowed: 1e-06 mm or more"),
    ("too deep for int16", job(), f"{DRY} depths_mm.last=4", "allowed: displacement float32"),
    ("unknown indenter left out", job(), f"{DRY} dataset.leave_out=x", "leave_out 'x' is not allowed; allowed:"),
    ("solver out of range", job(), f"{DRY} solver.linear_tolerance=1", "solver.linear_tolerance: 1 is not allowed"),
    ("solver no integer", job(), f"{DRY} solver.krylov_size=2.5", "solver.krylov_size: 2.5 is not allowed"),
    ("output a file", job() | {"f": "x"}, f"{RUN} -o f", "f: not a dataset"),
    ("output below a file", job() | {"f": "x"}, f"{RUN} -o f/d.zarr", "f/d.zarr: cannot be written: Not a directory"),
    ("output that may not be", job(), f"{RUN} -o /proc/simgen/d.zarr", "/proc/simgen/d.zarr: cannot be written"),
    ("output of a long name", job(), f"{RUN} -o {'x' * 300}", ": File name too long"),
]

MESH = "mesh s"
CAMERA = {"position_mm": [0, 0, 0], "looks_along": [0, 1, 0], "up": [1, 0, 0], "vertical_field_of_view_deg": 60,
          "width_px": 2, "height_px": 2, "light_circle_radius_mm": 1, "light_angles_deg": {}}  # fmt: skip
SENSORS = [
    ("no sensor.yaml", {"s": None}, MESH, f"sensor 's': allowed: {BUNDLED}, or a folder with a sensor.yaml"),
    ("unknown sensor", {}, "mesh finger", f"sensor 'finger': allowed: {BUNDLED}"),
    ("broken", {"s/sensor.yaml": "a: ["}, MESH, "s/sensor.yaml: line 1 not YAML:"),
    ("empty", {"s/sensor.yaml": ""}, MESH, "s/sensor.yaml: not a mapping of keys to values, but empty"),
    ("bytes", {"s/sensor.yaml": b"\xff\x00"}, MESH, "s/sensor.yaml: not a text in UTF-8"),
    ("unknown key", sensor(colour="red"), MESH, "s/sensor.yaml: colour: unknown key; allowed: name, gel"),
    ("missing key", {"s/sensor.yaml": "name: x"}, MESH, "s/sensor.yaml: gel: missing; allowed: a mapping with"),
    ("misspelt key", {"s/sensor.yaml": "name: x\ngell: {}"}, MESH, "s/sensor.yaml: gell: unknown key; allowed: name"),
    ("wrong unit", sensor(gel={"mesh": {"file": "slab.stl", "unit": "cm"}}), MESH, 'gel.mesh.unit: "cm" is not'),
    ("nu of a fluid", sensor(materials={"solid": {**SOLID, "poisson_ratio": 0.5}}), MESH, "poisson_ratio: 0.5 is not"),
    ("region empty", sensor(**plate(at_mm=9.0)), MESH, "held.back: selects no triangle"),
    ("region unknown", sensor(held={"back": {"ball": 1}}), MESH, "held.back.ball: unknown key"),
    ("no region", sensor(held={}), MESH, "held"),
    ("region infinite", sensor(**plate(at_mm=float("inf"))), MESH, "held.back.plane.at_mm: Infinity is not"),
    ("no cavity", sensor(core={"friction": 0.0, "mesh": SLAB["gel"]["mesh"]}), MESH, "core: the gel has no cavity"),
    ("tiny edges", sensor(meshes={"default": {"edge_length_mm": 1e-6}}), MESH, "edge_length_mm = 1e-06: allowed: "),
    ("surface as given", sensor(meshes={"default": "as_given"}), MESH, "as_given needs a file of tetrahedra"),
    ("old camera", sensor(camera={}), MESH, "s/sensor.yaml: camera: unknown key; allowed: "),
    ("camera with a path", sensor(cameras={"default": CAMERA, "../x": CAMERA}), MESH,
     "cameras: '../x' cannot name a camera; allowed: letters"),
    ("no default camera", sensor(cameras={"front": CAMERA}), MESH,
     "cameras: front; allowed: one of them named default"),
    ("camera without direction", sensor(cameras={"default": {**CAMERA, "looks_along": [0, 0, 0]}}), MESH,
        "cameras.default.looks_along: [0.0, 0.0, 0.0]: a direction must have a length"),
    ("mesh file gone", {"s/sensor.yaml": sensor()["s/sensor.yaml"]}, MESH, "s/slab.stl: no such mesh file"),
    *[(f"{what} of another folder", sensor(**{what: {**about, "mesh": {"file": file, "unit": "mm"}}})
       | {"slab.stl": box()}, MESH, f"s/sensor.yaml: {what}.mesh.file: '{file}' leads out of the sensor's folder; ")
      for what, about, file in [("gel", {}, "../slab.stl"), ("gel", {}, "/slab.stl"), ("gel", {}, "a/../../slab.stl"),
                                ("core", {"friction": 0.0}, "../slab.stl")]],
    ("plate of another folder", sensor(held={"back": {"touching": {"file": "../slab.stl", "unit": "mm"}}})
     | {"slab.stl": box()}, MESH, "held.back.touching.file: '../slab.stl' leads out of the sensor's folder"),
    ("mesh of no kind", sensor("", "slab.step"), MESH, "slab.step: unknown kind of mesh '.step'"),
    ("metres for mm", sensor(box(scale=1000.0)), MESH, "the shape is 20 m large; allowed: 0.0001..0.5 m"),
    ("open", sensor(box(faces=slice(11))), MESH, "slab.stl: the surface is open"),
    ("not a number", sensor(NAN, "a.obj"), MESH, "a.obj: coordinates that are not finite numbers"),
    ("turned", sensor(tet(tetrahedra=TURNED), "a.tet"), MESH, "a.tet: 1 of 150 tetrahedra are inverted or flat"),
    ("flat", sensor(tet(FLAT), "a.tet"), MESH, "tetrahedra are inverted or flat, allowed 0"),
    ("beyond the vertices", sensor(tet(tetrahedra=BEYOND), "a.tet"), MESH, "vertices 0 to 1000000000 are named"),
    ("vertices alone", sensor(tet(tetrahedra=[]), "a.tet"), MESH, "a.tet: "),
    ("announced, not there", sensor(ANNOUNCED, "a.ply"), MESH, "a.ply: "),
    *[(f"empty {kind}", sensor(b"", f"a.{kind}"), MESH, f"s/a.{kind}: ")
        for kind in ("stl", "obj", "ply", "msh", "vtu", "mesh", "tet")],
    *[(f"garbage {kind}", sensor(bytes(range(256)) * 3, f"a.{kind}"), MESH, f"s/a.{kind}: ")
        for kind in ("stl", "obj", "ply", "msh", "vtu", "mesh", "tet")],
    *[(f"truncated {kind}", sensor(box(kind)[:-60], f"a.{kind}"), MESH, f"s/a.{kind}: ")
        for kind in ("stl", "obj", "ply")],
    *[(f"truncated {kind}", truncated(kind, **options), MESH, f"s/m{kind}: ")
        for kind, options in [(".msh", {}), (".msh", {"binary": False}), (".vtu", {}), (".mesh", {})]],
    ("truncated .tet", sensor(tet()[:-9], "a.tet"), MESH, "s/a.tet: "),
]  # fmt: skip

INDENTER = np.full(12, 9, np.int32)
DATASETS = [
    ("no folder", None, "check nothing.zarr", "nothing.zarr: not a dataset"),
    ("an empty folder", None, "status .", ".: not a dataset"),
    ("no zarr.json", content("zarr.json", None), "report d.zarr", "d.zarr: not a dataset"),
    ("broken zarr.json", content("zarr.json", "{"), "check d.zarr", "d.zarr/zarr.json: not what `simgen run` wrote"),
    ("an array", content("zarr.json", '{"zarr_format": 3, "node_type": "array"}'), "check d.zarr", "not what `simg"),
    ("a list", content("zarr.json", "[]"), "status d.zarr", "d.zarr/zarr.json: not what `simgen run` wrote"),
    ("bytes", content("zarr.json", b"\xff\xfe\x00"), "status d.zarr", "d.zarr/zarr.json: not what `simgen run` wrote"),
    ("other schema", attributes(schema=99), "check d.zarr", "schema 99; this version reads"),
    ("no job", attributes(job=None), "check d.zarr", "not what `simgen run` wrote (no job;"),
    ("no status", attributes(status=None), "status d.zarr", "not what `simgen run` wrote (no status;"),
    ("status a list", attributes(status=["ok"]), "report d.zarr", "status is a dict"),
    ("job a word", attributes(job="smoke"), "report d.zarr", "job is a dict"),
    ("job empty", attributes(job={}), "check d.zarr", "d.zarr: job: name: missing"),
    ("job of another version", attributes(job={**JOB, "colour": 1}), "status d.zarr", "job: colour: unknown key"),
    ("array missing", array("digit/force", None), "status d.zarr", "d.zarr/digit/force: "),
    ("vertices missing", array("digit/rest_positions", None), "report d.zarr", "no array digit/rest_positions"),
    ("array of other shape", array("digit/status", np.zeros((12, 9), np.int8)), "report d.zarr", "int8 (12, 4)"),
    ("array of other type", array("press/indenter", INDENTER * 1.0), "report d.zarr", "press/indenter: float64"),
    ("index beyond", array("press/indenter", INDENTER), "report d.zarr", "press/indenter: 9 to 9; allowed: 0 to 2"),
    ("pose of nothing", array("digit/pose", np.zeros((12, 4, 4))), "report d.zarr", "digit/pose: matrices that cannot"),
    ("plan rotten", content("press/indenter/c/0", b"x"), "report d.zarr", "press/indenter: cannot be read"),
    ("another job's", None, "run job.yaml --scheduler sync -o d.zarr", "d.zarr: holds another dataset (job.name"),
    ("page onto a folder", None, "report d.zarr -o d.zarr", "d.zarr: is a folder; allowed: a file"),
    ("page nowhere", None, "report d.zarr -o gone/page.html", "gone/page.html: no such folder gone"),
]
# What an audit finds, and a status code that nobody knows, are no errors of the command line.
FOUND = [
    ("manifest garbage", content("manifest/000000.json", b"\xff["), "check d.zarr", 1, "manifest/000000.json"),
    ("timings garbage", content("manifest/timings.jsonl", '{"began": "x"}\n[]\n{"sh'), "status d.zarr", 0, "12 of 12"),
    ("array missing", array("digit/force", None), "check d.zarr", 1, "FAIL"),
    ("unknown status", array("digit/status", np.full((12, 4), 77, np.int8)), "status d.zarr", 0, "Status 77, which"),
    ("unknown status", array("digit/status", np.full((12, 4), 77, np.int8)), "check d.zarr", 1, "Status 77, which"),
]

LINES = [
    ("device", job(), f"{RUN} --device gpu", "device 'gpu' is not allowed; allowed: cpu, cuda, cuda:N"),
    ("device of the dry run", job(), f"{DRY} --device cuda:x", "device 'cuda:x' is not allowed"),
    ("GPU that is not there", job(), f"{RUN} --device cuda:99", "device 'cuda:99': this machine has"),
    ("device of the validation", {}, "validate --quick --device gpu", "device 'gpu' is not allowed"),
    ("scheduler a word", job(), "run job.yaml --scheduler nowhere", "scheduler 'nowhere': missing port number"),
    ("scheduler of no kind", job(), "run job.yaml --scheduler http://x:1", "scheduler 'http://x:1': unknown address"),
    ("scheduler without key", job(), "run job.yaml --scheduler tls://localhost:1", "allowed: the address of one that"),
    ("scheduler silent", job(), "run job.yaml --scheduler tcp://127.0.0.1:1", "allowed: the address of one that"),
    ("scheduler file gone", job(), "run job.yaml --scheduler-file f.json", "f.json: No such file"),
    ("scheduler file garbage", job() | {"f": b"\xff{"}, "run job.yaml --scheduler-file f", "f: no address in it"),
    ("scheduler file a list", job() | {"f": "[]"}, "run job.yaml --scheduler-file f", "f: no address in it"),
    ("scheduler twice", job(), f"{RUN} --scheduler-file f", "allowed: one of them"),
    ("override without =", job(), f"{DRY} seed", "override seed: write it as key=value"),
    ("override of nothing", job(), [*DRY.split(), ""], "override : write it as key=value"),
    ("override without key", job(), f"{DRY} =3", "override =3: write it as key=value"),
    ("override of no section", job(), f"{DRY} speed.fast=1", "override speed.fast=1: speed: unknown key"),
    ("override of no key", job(), f"{DRY} solver.fast=1", "solver.fast: unknown key; allowed: element"),
    ("override not YAML", job(), f"{DRY} seed=[", "override seed=[: line 1 not YAML"),
    ("override too deep", job(), f"{DRY} {'a.' * 2000}b=1", "maximum recursion depth"),
    ("unknown case", {}, "validate --case nothing", "case 'nothing' is not known; allowed: "),
    ("JSON nowhere", {}, "validate --case exact-frame --json gone/v.json", "gone/v.json: no such folder gone"),
    ("page onto a folder", {"v": None}, "validate --case exact-frame --html v", "v: is a folder; allowed: a file"),
    ("published nowhere", {}, "validate --quick --published gone", "--published = gone: no such folder"),
    ("bench onto a file", {"f": "x"}, "bench --quick --output f", "--output f: no folder can be made there"),
]
USAGE = [
    ("no worker", job(), "run job.yaml --workers 0", "--workers"),
    ("workers a word", job(), "run job.yaml --workers many", "--workers"),
    ("unknown command", {}, "fly", "No such command"),
    ("unknown option", {}, "run smoke --quickly", "No such option"),
    ("no job", {}, "run", "Missing argument"),
]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "d.zarr"
    run(fake.make_plan(fake.make_job()), path, build=fake.fake_presser)
    return path


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """The current folder, empty; the cache of meshes is in it, too. Good shapes are not cached here."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIMGEN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(shape_cache, "_write", lambda *given: None)
    monkeypatch.setattr(workers, "ANSWER_S", 0.5)
    return tmp_path


def prepare(folder: Path, preparation) -> dict[str, bytes | None]:
    preparation(folder) if callable(preparation) else write(folder, preparation)
    return contents(folder)


def prepare_dataset(folder: Path, dataset: Path, change) -> dict[str, bytes | None]:
    shutil.copytree(dataset, folder / "d.zarr")
    write(folder, job())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zarr's, of consolidated metadata
        if change is not None:
            change(folder / "d.zarr")
    return contents(folder)


@pytest.mark.parametrize("preparation, command, words", rows([*JOBS, *SENSORS, *LINES]))
def test_bad_input_is_one_line_and_writes_nothing(folder, monkeypatch, capfd, preparation, command, words):
    before = prepare(folder, preparation)
    check_refusal(*simgen(command, monkeypatch, capfd), words)
    assert contents(folder) == before


@pytest.mark.parametrize("change, command, words", rows(DATASETS))
def test_bad_datasets_are_one_line_and_stay_as_they_are(folder, dataset, monkeypatch, capfd, change, command, words):
    before = prepare_dataset(folder, dataset, change)
    check_refusal(*simgen(command, monkeypatch, capfd), words)
    assert contents(folder) == before


@pytest.mark.parametrize("change, command, code, words", rows(FOUND))
def test_what_is_found_is_said(folder, dataset, monkeypatch, capfd, change, command, code, words):
    before = prepare_dataset(folder, dataset, change)
    ended, output, errors = simgen(command, monkeypatch, capfd)
    assert (ended, errors) == (code, "")
    assert words in output and "Traceback" not in output
    assert contents(folder) == before


@pytest.mark.parametrize("preparation, command, words", rows(USAGE))
def test_wrong_usage_is_told_with_exit_code_2(folder, monkeypatch, capfd, preparation, command, words):
    before = prepare(folder, preparation)
    code, output, errors = simgen(command, monkeypatch, capfd)
    assert code == 2 and words in errors and "Traceback" not in output + errors
    assert contents(folder) == before


@pytest.mark.parametrize("preparation, command, words", rows([JOBS[0], SENSORS[-1], LINES[5]]))
def test_processes_say_the_same(folder, preparation, command, words):
    before = prepare(folder, preparation)
    line = [sys.executable, "-m", "simgen.cli", *command.split()]
    done = subprocess.run(line, capture_output=True, text=True, env={**os.environ, "COLUMNS": "100"}, timeout=120)
    check_refusal(done.returncode, done.stdout, done.stderr, words)
    assert contents(folder) == before
