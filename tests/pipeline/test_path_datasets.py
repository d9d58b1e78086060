"""A dataset whose indenters press, shear, twist and let go: solved once, and read in every way that there is."""

import json

import numpy as np
import pytest

from simgen import load_dataset
from simgen.config.job import job_from_dict
from simgen.dataset.audit import check, passes
from simgen.dataset.contact_patch import ContactPatches
from simgen.dataset.exchange.across import export_across
from simgen.dataset.exchange.paraview import export_vtk
from simgen.dataset.exchange.selection import select, untracked
from simgen.dataset.exchange.training_arrays import export_npy
from simgen.fem.nonlinear.status import Status, has_values
from simgen.pipeline.plan import make_plan
from simgen.pipeline.run import run
from simgen.report import write_report
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, SolverSettings, follow

LEGS = [
    {"move_mm": [0.2, 0.0, -0.1], "steps": 2},
    {"turn_deg": 12.0, "steps": 2},
    {"move_mm": [0.0, -0.6, 0.0], "steps": 2},
]
PRESSED, SHEARED, TURNED, RELEASED = 2, 4, 6, 8  # steps, when each leg has ended


def make_job(legs, **changes):
    return job_from_dict({
        "name": "paths", "seed": 5,
        "sensors": {"digit": {"model": "digit", "mesh": "coarse"}},
        "indenters": ["sphere_7mm", "cylinder_short_7mm"],
        "trajectories": {"count": 1, "path": legs},
        "depths_mm": {"first": 0.2, "last": 0.4, "count": 2},
        **changes,
    })  # fmt: skip


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return run(make_plan(make_job(LEGS)), tmp_path_factory.mktemp("paths") / "paths.zarr")


def test_all_converges_and_passes_its_audit(dataset):
    assert (dataset["digit/status"] == 0).all()
    findings = check(dataset)
    assert passes(findings), [finding for finding in findings if finding.failed]
    assert "steps of the path" in {finding.what for finding in findings}


def test_a_force_limit_of_the_job_ends_presses(dataset, tmp_path):
    """The largest force of the job without a limit, less a little: presses that had it end there."""
    axis = np.linalg.inv(dataset["digit/pose"]) @ dataset["press/contact_pose"]
    axial = np.abs(np.einsum("pdi,pi->pd", dataset["digit/force"], axis[:, :3, 1]))
    limit = 0.999 * axial.max()
    trajectories = {"count": 1, "path": LEGS, "max_force_n": float(limit)}
    limited = run(make_plan(make_job(LEGS, trajectories=trajectories)), tmp_path / "limited.zarr")
    ended = np.logical_or.accumulate(axial > limit, axis=1)
    assert ended.any() and not ended.all()
    np.testing.assert_array_equal(limited["digit/status"], np.where(ended, Status.FORCE_LIMIT, Status.CONVERGED))
    np.testing.assert_array_equal(limited["digit/force"], np.where(ended[..., None], np.nan, dataset["digit/force"]))
    assert passes(check(limited))


def test_forces_follow_the_legs(dataset):
    force, shear, slip = (dataset[f"digit/{name}"] for name in ("force", "shear_force", "slip_share"))
    pose = dataset["press/contact_pose"]
    own = np.einsum("pij,pdi->pdj", pose[:, :3, :3], force)  # the DIGIT's frame is the shared one
    np.testing.assert_allclose(shear, own[..., [0, 2]], atol=1e-12)
    # Friction drags the gel the way that the indenter goes: 0.2 along x, -0.1 along z.
    dragged = shear[:, SHEARED - 1] - shear[:, PRESSED - 1]
    assert (dragged[:, 0] > 0.1).all() and (dragged[:, 1] < 0.0).all()
    assert not force[:, RELEASED - 1].any() and not slip[:, RELEASED - 1].any()
    assert ((slip[:, :RELEASED] >= 0.0) & (slip[:, :RELEASED] <= 1.0)).all()
    assert (slip[:, SHEARED - 1] > slip[:, PRESSED - 1]).all()


def test_the_turn_twists_the_sensor(dataset):
    """The moment about the press axis, through the tip, grows with the turn and has its sense."""
    tip = dataset["press/pose"][:, :3, 3][:, None] + np.einsum(
        "pij,dj->pdi", dataset["press/pose"][:, :3, :3], dataset.indenter_path.offsets_m
    )
    moment = dataset["digit/moment"] - np.cross(tip, dataset["digit/force"])
    about_axis = np.einsum("pdi,pi->pd", moment, dataset["press/pose"][:, :3, 1])
    assert (about_axis[:, TURNED - 1] > about_axis[:, SHEARED - 1]).all()


def test_a_press_is_the_special_case(dataset, tmp_path):
    """Legs change nothing of the press before them, to the bit, and a job without legs has none of their arrays."""
    straight = [{"turn_deg": 5.0, "steps": 1}]  # legs that stay on the press axis leave the contacts as they are
    one = {"indenters": ["cylinder_short_7mm"]}
    path = run(make_plan(make_job(straight, **one)), tmp_path / "path.zarr")
    plain = run(make_plan(make_job([], **one)), tmp_path / "plain.zarr")
    np.testing.assert_array_equal(path["press/contact_pose"], plain["press/contact_pose"])
    for name in ("displacement", "force", "moment"):
        np.testing.assert_array_equal(path[f"digit/{name}"][:, :PRESSED], plain[f"digit/{name}"])
    assert "path" not in plain.root and "slip_share" not in plain.root["digit"]
    assert (path["path/leg"] == [0, 0, 1]).all()


def test_a_long_leg_leaves_the_press_its_load_steps():
    """A press with few Newton iterations needs sub-steps; a leg of a turn in one step must not make them coarser."""
    digit = load_sensor("digit", "coarse")
    pose = np.eye(4)[None].copy()
    pose[0, :3, 3] = [-4e-3, -8.3e-3, 3e-3]
    path = 1e-3 * np.array([[0.0, depth, 0.0] for depth in (0.4, 0.8, 1.2)])
    cube = [load_indenter("cube_14mm").shape()]
    scene = Scene(digit, digit.materials["solid"], settings=SolverSettings(max_newton_iterations=8))
    alone = follow(scene, cube, pose, path)[0]
    turned = follow(scene, cube, pose, np.vstack([path, path[-1:]]), np.radians([0.0, 0.0, 0.0, 20.0]))[0]
    assert has_values(alone.status).all() and alone.certificate["substeps"].max() > 1
    np.testing.assert_array_equal(turned.force[:3], alone.force)


def test_a_skin_that_is_let_go_passes_its_audit(tmp_path):
    """Nothing is in balance with a contact force where there is none."""
    legs = [{"move_mm": [0.3, 0.0, 0.0], "steps": 1}, {"move_mm": [0.0, -1.3, 0.0], "steps": 2}]
    sensors = {"biotac": {"model": "biotac", "mesh": "coarse", "material": "effective"}}
    depths = {"first": 0.5, "last": 1.0, "count": 2}
    job = make_job(legs, sensors=sensors, indenters=["sphere_7mm"], depths_mm=depths, seed=0)
    released = run(make_plan(job), tmp_path / "b.zarr")
    assert (released["biotac/status"] == 0).all() and not released["biotac/force"][:, -1].any()
    findings = check(released)
    assert passes(findings), [finding for finding in findings if finding.failed]


def test_samples_say_where_the_indenter_is(dataset):
    samples = load_dataset(dataset.path)
    last = samples[TURNED - 1]
    np.testing.assert_allclose(last["offset"], [2e-4, 4e-4, -1e-4], rtol=1e-6)
    assert last["turn"] == pytest.approx(np.radians(12.0)) and last["leg"] == 2 and last["depth"] == np.float32(4e-4)
    np.testing.assert_allclose(last["digit/shear_force"], dataset["digit/shear_force"][0, TURNED - 1], rtol=1e-6)
    assert 0.0 < last["digit/slip_share"] <= 1.0
    assert set(load_dataset(dataset.path, split="train").rows[:, 0]) == {0, 1}  # one trajectory, whole


def test_patches_lie_under_the_moved_indenter(dataset):
    patches = ContactPatches(dataset, "digit")
    steps = np.array([PRESSED - 1, TURNED - 1, RELEASED - 1])
    moved = dataset.displacement("digit", 0)[steps][:, patches.points]
    touching = patches.touching(np.zeros(3, int), steps, moved)
    assert touching[0].any() and touching[1].any() and not touching[2].any()


def test_exports_know_the_path(dataset, tmp_path):
    selection, path = select(dataset), dataset.indenter_path
    for name in ("npy", "across", "vtk"):
        (tmp_path / name).mkdir()
    export_npy(selection, tmp_path / "npy", untracked)
    index = json.loads((tmp_path / "npy" / "index.json").read_text())["arrays"]
    for name in ("sample/offset", "sample/turn", "sample/leg", "digit/shear_force", "digit/slip_share"):
        assert index[f"{name}.npy"]["shape"][0] == 2 * RELEASED
    np.testing.assert_array_equal(np.load(tmp_path / "npy/sample/offset.npy"), np.tile(path.offsets_m, (2, 1)))
    export_across(selection, tmp_path / "across", untracked)
    export_vtk(selection, tmp_path / "vtk", untracked)
    times = (tmp_path / "vtk/trajectory_0/sphere_7mm/digit.pvd").read_text()
    assert all(f'timestep="{step}"' in times for step in range(RELEASED))


def test_the_report_and_the_card_tell_of_the_path(dataset, tmp_path):
    write_report(dataset, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "Forces along the path" in page and "2 depths (0.2 to 0.4 mm) + 6 steps on 3 legs" in page
    card = (dataset.path / "README.md").read_text()
    assert "path of straight legs and turns" in card and "6 steps on 3 legs" in card
