"""The plan: the job's settings are those of the modules that use them; bundled sensors make a sound plan."""

from types import SimpleNamespace

import meshio
import numpy as np
import pytest
import trimesh
import yaml

from simgen.config.job import load_job
from simgen.config.resources import resource
from simgen.dataset.provenance import difference
from simgen.errors import InputError
from simgen.geometry.rigid_shape import mesh_distance
from simgen.pipeline.plan import (
    chosen_fluid,
    chosen_material,
    chosen_sensor,
    first_contacts,
    gel_under_indenters,
    indenter_identities,
    make_plan,
    sensor_identity,
)
from simgen.sensors.indenter import chosen_indenters
from simgen.sensors.material import Material
from simgen.sensors.sensor import load_sensor
from simgen.sensors.sensor_meshes import output_settings


def test_contacts_are_drawn_by_the_job_s_own_values():
    job = load_job("smoke", ["trajectories.max_tilt_deg=0", "trajectories.least_thickness_left=0"])
    sensors = {name: chosen_sensor(job, name) for name in job.sensors}
    drawn = first_contacts(job, sensors, 2, {}).kept
    np.testing.assert_allclose(drawn.axes, -drawn.normals, atol=1e-12)


@pytest.fixture(scope="module")
def plan():
    return make_plan(load_job("smoke.yaml"))


def test_a_plan_records_its_sensors_and_indenters(plan):
    assert plan.attributes["indenters"] == indenter_identities(chosen_indenters(plan.job))
    for name in plan.job.sensors:
        expected = sensor_identity(plan.job, name, chosen_sensor(plan.job, name))
        assert plan.attributes["sensors"][name] == expected


def test_presses_run_through_the_indenters_of_each_trajectory(plan):
    np.testing.assert_array_equal(plan.arrays["press/trajectory"], [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(plan.arrays["press/indenter"], [0, 1, 2, 0, 1, 2])


def test_the_reference_sensor_stays_where_it_is(plan):
    np.testing.assert_array_equal(plan.arrays["digit/pose"], np.tile(np.eye(4), (6, 1, 1)))
    assert not np.allclose(plan.arrays["biotac/pose"], np.eye(4))


def test_the_same_job_makes_the_same_plan(plan):
    again = make_plan(load_job("smoke.yaml"))
    assert again.attributes == plan.attributes
    for name, values in plan.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], values, err_msg=name)


def test_more_trajectories_leave_the_first_ones_alone(plan):
    more = make_plan(load_job("smoke.yaml", ["trajectories.count=5"]))
    np.testing.assert_array_equal(more.arrays["press/contact_pose"][:6], plan.arrays["press/contact_pose"])


def test_refused_contacts_are_part_of_the_plan():
    """They lie on the gel of the reference sensor. Those of fewer trajectories are the first of more."""
    few, more = (make_plan(load_job("paired", [f"trajectories.count={count}"])) for count in (6, 9))
    points, normals = more.arrays["refused/points"], more.arrays["refused/normals"]
    assert points.shape == normals.shape and len(points) >= 2
    assert np.abs(mesh_distance(load_sensor("digit").surface, 1e3 * points)).max() < 1e-4  # mm
    np.testing.assert_array_equal(few.arrays["refused/points"], points[: len(few.arrays["refused/points"])])
    off = make_plan(load_job("paired", ["trajectories.count=9", "trajectories.least_thickness_left=0"]))
    assert not [name for name in off.arrays if name.startswith("refused/") or name.endswith("/pressable_steps")]


def test_presses_that_stop_early_keep_their_contacts_and_say_after_which_step():
    changes = ["trajectories.count=6", "indenters=[sphere_7mm, ring_7mm]"]
    job = load_job("paired", [*changes, "trajectories.too_thin=stop", "trajectories.least_thickness_left=0.4"])
    plan, off = make_plan(job), make_plan(load_job("paired", [*changes, "trajectories.least_thickness_left=0"]))
    np.testing.assert_array_equal(plan.arrays["press/contact_pose"], off.arrays["press/contact_pose"])
    assert "refused/points" not in plan.arrays
    for name in job.sensors:
        steps = plan.arrays[f"{name}/pressable_steps"].reshape(6, 2)
        assert steps.min() < steps.max() == 20
        measure = gel_under_indenters(job, {name: chosen_sensor(job, name)}, chosen_indenters(job))[name]
        poses = np.linalg.inv(plan.arrays[f"{name}/pose"][::2]) @ plan.arrays["press/contact_pose"][::2]
        deepest = measure.depths_that_leave(poses, job.trajectories.least_thickness_left)[:, :, 0]
        np.testing.assert_array_equal(steps, (job.depths_m <= deepest[:, :, None]).sum(axis=2))
    one = make_plan(load_job("paired", [*changes, "trajectories.too_thin=stop", "trajectories.least_thickness_left=0.4",
                                        "trajectories.indenters_each=1"]))  # fmt: skip
    own = np.arange(6), one.arrays["press/indenter"]
    for name in job.sensors:
        expected = plan.arrays[f"{name}/pressable_steps"].reshape(6, 2)[own]
        np.testing.assert_array_equal(one.arrays[f"{name}/pressable_steps"], expected)
        np.testing.assert_array_equal(one.arrays[f"{name}/pose"], plan.arrays[f"{name}/pose"][::2])


def test_a_material_is_a_preset_with_the_values_of_the_job_in_its_place():
    job = load_job("smoke.yaml", ["sensors.digit.material.friction=0.3"])
    material = chosen_material(job, "digit", chosen_sensor(job, "digit"))
    assert (material.youngs_modulus_pa, material.poisson_ratio, material.friction) == (539e3, 0.499, 0.3)


def test_an_unknown_preset_names_those_that_there_are():
    job = load_job("smoke.yaml", ["sensors.biotac.material=fluid"])
    with pytest.raises(InputError, match=r"sensors\.biotac\.material: 'fluid' .*allowed: .*effective"):
        chosen_material(job, "biotac", chosen_sensor(job, "biotac"))


def test_a_preset_of_another_law_keeps_its_constants_and_must_suit_the_values_of_the_job():
    values = {"law": "yeoh", "youngs_modulus_pa": 539e3, "poisson_ratio": 0.499, "c20_pa": 2e4, "friction": 0.7}
    sensor = SimpleNamespace(materials={"solid": Material(**values)})
    job = load_job("smoke.yaml", ["sensors.digit.material.youngs_modulus_pa=400e3"])
    material = chosen_material(job, "digit", sensor)
    assert (material.law, material.youngs_modulus_pa, material.c20_pa) == ("yeoh", 400e3, 2e4)
    assert material.source == "youngs_modulus_pa by the job, the rest of preset solid"
    job = load_job("smoke.yaml", ["sensors.digit.material.youngs_modulus_pa=100e3"])
    with pytest.raises(InputError, match=r"^sensors\.digit\.material: c20_pa = 20000 is not allowed; .*c30_pa$"):
        chosen_material(job, "digit", sensor)


def test_a_fluid_needs_a_cavity_and_is_recorded():
    job = load_job("smoke.yaml", ["sensors.biotac.fluid=incompressible"])
    assert sensor_identity(job, "biotac", chosen_sensor(job, "biotac"))["fluid"] == "incompressible"
    job = load_job("smoke.yaml", ["sensors.digit.fluid=incompressible"])
    with pytest.raises(InputError, match=r"sensors\.digit\.fluid: 'incompressible': .*no cavity; allowed: none"):
        chosen_fluid(job, "digit", chosen_sensor(job, "digit"))


@pytest.fixture
def fewer_vertices(tmp_path):
    """A job on the DIGIT and the BioTac whose output is the tetrahedra of the DIGIT's tip, in mm; returns its file."""
    mesh = load_sensor("digit", "coarse").output_mesh
    tip = mesh.tetrahedra[(mesh.vertices[mesh.tetrahedra, 0] < -8e-3).all(axis=1)]
    used, tetrahedra = np.unique(tip, return_inverse=True)
    points, cells = mesh.vertices[used] * 1e3, tetrahedra.reshape(-1, 4)
    meshio.write(tmp_path / "tip.vtu", meshio.Mesh(points, {"tetra": cells}))
    job = yaml.safe_load((resource("jobs") / "smoke.yaml").read_text())
    job["sensors"]["digit"]["output"] = {"file": "tip.vtu", "unit": "mm"}
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job, sort_keys=False))
    return tmp_path / "job.yaml"


def test_a_jobs_own_output_mesh_changes_the_vertices_and_not_the_contacts(plan, fewer_vertices):
    own = make_plan(load_job(fewer_vertices))
    file = meshio.read(fewer_vertices.parent / "tip.vtu")
    np.testing.assert_array_equal(own.arrays["digit/rest_positions"], file.points * 1e-3)
    np.testing.assert_array_equal(own.arrays["digit/tetrahedra"], file.cells_dict["tetra"])
    for name in ("press/contact_pose", "biotac/pose", "biotac/rest_positions"):
        np.testing.assert_array_equal(own.arrays[name], plan.arrays[name], err_msg=name)
    changes = difference(plan.attributes["sensors"], own.attributes["sensors"])
    assert [change.split(":")[0] for change in changes] == ["digit.output_mesh"]


SLAB = {
    "name": "slab",
    "gel": {"mesh": {"file": "slab.stl", "unit": "mm"}},
    "core": {"mesh": {"file": "core.stl", "unit": "mm"}, "friction": 0.0},
    "held": {"back": {"plane": {"axis": "y", "at_mm": 4.0}}},
    "meshes": {"default": {"edge_length_mm": 4.0}},
    "materials": {"solid": {"youngs_modulus_pa": 539e3, "poisson_ratio": 0.499, "friction": 0.78}},
}


@pytest.fixture
def own_inputs(tmp_path, monkeypatch):
    """A job on a hollow slab with a core and an indenter, all from files; returns its folder.

    No mesh is made: the hash of what it would be made from, which is part of its own, stands for it.
    """
    monkeypatch.setattr(
        "simgen.sensors.sensor_meshes.simulation_mesh",
        lambda shape, mesh: SimpleNamespace(hash=shape.mesh_source(getattr(shape.description.meshes, mesh))),
    )
    monkeypatch.setattr(
        "simgen.sensors.sensor_meshes.output_mesh",
        lambda shape: SimpleNamespace(hash=shape.mesh_source(output_settings(shape))),
    )
    cavity = trimesh.creation.box([8.0, 3.0, 8.0])
    cavity.invert()
    gel = trimesh.util.concatenate([trimesh.creation.box([20.0, 8.0, 20.0]), cavity])
    gel.export(tmp_path / "slab.stl")
    trimesh.creation.box([7.0, 2.0, 7.0]).export(tmp_path / "core.stl")
    trimesh.creation.box([8e-3, 4e-3, 6e-3]).export(tmp_path / "block.stl")
    (tmp_path / "sensor.yaml").write_text(yaml.safe_dump(SLAB))
    job = {
        "name": "own",
        "sensors": {"slab": {"model": "./"}},
        "indenters": ["block.stl"],
        "trajectories": {"count": 1},
        "depths_mm": {"first": 0.1, "last": 0.2, "count": 2},
    }
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job))
    return tmp_path


def inputs(folder):
    """What a plan of the folder's job records of its sensor and its indenter."""
    job = load_job(folder / "job.yaml")
    sensor = sensor_identity(job, "slab", chosen_sensor(job, "slab"))
    return {"sensors": {"slab": sensor}, "indenters": indenter_identities(chosen_indenters(job))}


def test_an_edit_of_what_a_user_brings_makes_another_dataset(own_inputs):
    """Indenter file, core friction, core file, held region and material, one after the other."""
    before = inputs(own_inputs)
    assert difference(before, inputs(own_inputs)) == []
    assert str(own_inputs) not in str(before), "a dataset does not tell where its inputs lay"

    def edit_sensor(**changes):
        (own_inputs / "sensor.yaml").write_text(yaml.safe_dump({**SLAB, **changes}))

    def edit_mesh(name, size):
        trimesh.creation.box(size).export(own_inputs / name)

    slippery, sticky = SLAB["core"], {**SLAB["core"], "friction": 0.5}
    moved = {"back": {"box": {"y_mm": [3.9, 4.1]}}}
    softer = {"solid": {**SLAB["materials"]["solid"], "youngs_modulus_pa": 400e3}}
    mesh = ["sensors.slab.simulation_mesh", "sensors.slab.output_mesh"]
    for edit, expected in (
        (lambda: edit_mesh("block.stl", [8e-3, 4e-3, 7e-3]), ["indenters.block.sha256"]),
        (lambda: edit_sensor(core=sticky), ["sensors.slab.core_friction"]),
        (lambda: edit_mesh("core.stl", [6.0, 2.0, 7.0]), mesh),
        (lambda: edit_sensor(core=sticky, held=moved), mesh),
        (lambda: edit_sensor(core=slippery, held=moved, materials=softer),
         ["sensors.slab.core_friction", "sensors.slab.material.youngs_modulus_pa"]),
    ):  # fmt: skip
        edit()
        after = inputs(own_inputs)
        assert [change.split(":")[0] for change in difference(before, after)] == expected
        before = after


def test_given_contacts_take_the_place_of_drawn_ones(plan):
    """Rolled contacts of the DIGIT's middle, by the plan of a whole job; the first of two is that of one."""
    places = "[{x_mm: -6, arc_mm: 0}, {x_mm: -8, arc_mm: 2, tilt_deg: 3, azimuth_deg: 90, roll_deg: 30}]"
    given = make_plan(load_job("smoke", [f"trajectories={{contacts: {places}}}"]))
    poses = given.arrays["press/contact_pose"]
    np.testing.assert_allclose(poses[[0, 3], 0, 3], [-6e-3, -8e-3])
    assert len(poses) == 6 and "refused/points" not in given.arrays
    assert given.attributes["job"]["trajectories"]["count"] == 2
    for name, values in given.arrays.items():
        assert values.shape == plan.arrays[name].shape, name
    [first] = first_contacts(given.job, {n: chosen_sensor(given.job, n) for n in given.job.sensors}, 1, {}).kept.points
    np.testing.assert_array_equal(first, poses[0, :3, 3])


def test_a_given_contact_that_does_not_fit_is_refused():
    with pytest.raises(InputError, match=r"trajectories\.contacts\[0\] \(x_mm 4, arc_mm 0\): a side wall of digit"):
        make_plan(load_job("smoke", ["trajectories={contacts: [{x_mm: 4, arc_mm: 0}]}"]))


def test_another_gpu_continues_a_dataset():
    job = load_job("smoke", [])
    first, second, cpu = (make_plan(job, device) for device in ("cuda", "cuda:1", "cpu"))
    assert first.attributes == second.attributes and (first.device, second.device) == ("cuda", "cuda:1")
    assert difference(first.attributes, cpu.attributes) == ["device: cuda -> cpu"]
