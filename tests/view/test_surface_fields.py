"""Fields of the stand-in's surfaces."""

import fake
import numpy as np
import pytest

from simgen.dataset.contact_patch import ContactPatches
from simgen.errors import InputError
from simgen.pipeline.run import run
from simgen.view.colours import colours_of
from simgen.view.drawn_surface import AT_REST, PressedSurface
from simgen.view.surface_fields import CONTACT, DISPLACEMENT, PRESSURE, TRACTION, VON_MISES, SurfaceFields

PA = 3e3


def loaded_presser(job, sensor, device):
    """Everywhere a traction of 3 kPa towards the middle of the ball at the first depth, twice that at the second, ...;
    and the same in shear.
    """

    def presser(indenters, poses):
        results = fake.failing_presser(job, sensor, device)(indenters, poses)
        inward = -fake.VERTICES / fake.RADIUS_M
        for result in results:
            times = PA * np.arange(1, 5)[:, None, None]
            result.displacement[...] = 0.0 * result.displacement
            result.outputs |= {"traction": times * inward, "stress": times * np.array([0, 0, 0, 0, 0, 1.0])}
            result.outputs["stress"] = result.outputs["stress"] * np.ones((len(fake.VERTICES), 1))
            for name in ("traction", "stress"):
                result.outputs[name][result.status != 0] = np.nan
        return results

    return presser


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """A dataset with tractions and stresses of the digit."""
    job = fake.make_job(outputs={"digit": ["traction", "stress"]}, trajectories={"count": 2})
    plan = fake.make_plan(job)
    plan.arrays["digit/surface_vertices"] = np.arange(len(fake.VERTICES))
    return run(plan, tmp_path_factory.mktemp("loaded") / "d.zarr", build=loaded_presser)


@pytest.fixture(scope="module")
def fields(failing) -> SurfaceFields:
    return SurfaceFields(PressedSurface(failing, "biotac"))


def test_the_scale_is_that_of_the_whole_press(fields):
    moves = fields.pressed.displacement(3)
    for step in range(4):
        field = fields.field(DISPLACEMENT, 3, step)
        assert field.label == "displacement, mm" and field.values.dtype == np.float32
        np.testing.assert_allclose(field.values, 1e3 * np.linalg.norm(moves[step], axis=1), rtol=1e-6)
        assert field.largest == pytest.approx(1e3 * np.linalg.norm(moves[3], axis=1).max())
    np.testing.assert_array_equal(field.colours[field.values.argmax()], colours_of(np.ones(1), 1.0)[0])


def test_before_the_press_nothing_has_moved_and_nothing_touches(fields):
    for key in (DISPLACEMENT, CONTACT):
        assert not fields.field(key, 3, AT_REST).values.any()
    assert fields.field(DISPLACEMENT, 3, AT_REST).largest == fields.field(DISPLACEMENT, 3, 0).largest > 0.0


def test_a_step_that_was_not_reached_has_no_values_and_the_others_keep_theirs(fields):
    assert np.isnan(fields.field(DISPLACEMENT, 1, 3).values).all()
    assert np.isnan(fields.field(CONTACT, 1, 3).values).all()
    moves = fields.pressed.displacement(1)
    assert fields.field(DISPLACEMENT, 1, 3).largest == pytest.approx(1e3 * np.linalg.norm(moves[1], axis=1).max())


def test_the_patch_is_that_of_the_dataset(failing, fields):
    patches, press, step = ContactPatches(failing, "biotac"), 3, 3
    moved = failing.displacement("biotac", press, step)[None, patches.points]
    (expected,) = patches.touching(np.array([press]), np.array([step]), moved)
    values = fields.field(CONTACT, press, step).values
    assert set(patches.points[expected]) == set(np.flatnonzero(values == 1.0)) != set()
    np.testing.assert_array_equal(np.isnan(values), fake.HELD)


def test_tractions_and_stresses_are_those_that_are_stored(loaded):
    fields = SurfaceFields(PressedSurface(loaded, "digit"))
    assert list(fields.titles) == [DISPLACEMENT, CONTACT, PRESSURE, TRACTION, VON_MISES] and not fields.why_not
    for key, factor, close in ((TRACTION, 1.0, 1e-6), (PRESSURE, 1.0, 0.01), (VON_MISES, np.sqrt(3.0), 1e-6)):
        field = fields.field(key, 0, 1)
        assert field.unit == "kPa" and field.values.shape == (len(fake.VERTICES),)
        np.testing.assert_allclose(field.values, 2e-3 * PA * factor, rtol=close)  # facets tilt the normals a little
        assert field.largest == pytest.approx(4e-3 * PA * factor, rel=0.01)
        assert np.isnan(fields.field(key, 0, AT_REST).values).all()
        assert np.isnan(fields.field(key, 1, 3).values).all()


def test_what_is_not_stored_has_a_sentence(fields):
    assert list(fields.titles) == [DISPLACEMENT, CONTACT]
    assert fields.why_not[PRESSURE].startswith("The dataset has no biotac/traction")
    assert set(fields.why_not) == {PRESSURE, TRACTION, VON_MISES}
    with pytest.raises(InputError, match="field 'pressure': allowed: displacement, contact"):
        fields.field(PRESSURE, 0, 0)


def test_imported_files_do_not_say_what_touches(imported):
    fields = SurfaceFields(PressedSurface(imported, "digit"))
    assert list(fields.titles) == [DISPLACEMENT] and "do not say what touches" in fields.why_not[CONTACT]


def test_an_indenter_that_has_changed_costs_only_the_patch(failing, monkeypatch):
    monkeypatch.setitem(failing.attributes["indenters"]["ring_7mm"], "fillet_mm", 9.0)
    fields = SurfaceFields(PressedSurface(failing, "digit"))
    assert list(fields.titles) == [DISPLACEMENT]
    assert "ring_7mm: not the indenter that was pressed" in fields.why_not[CONTACT]
    assert fields.field(DISPLACEMENT, 0, 0).values.any()
