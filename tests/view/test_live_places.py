"""Places of live presses on the bundled sensors."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.geometry.developed_skin import skin_of
from simgen.pipeline.plan import chosen_sensor, first_contacts, gel_under_indenters
from simgen.sensors.indenter import chosen_indenters
from simgen.sensors.room import Room
from simgen.sensors.sensor_geometry import bundled_sensors
from simgen.units import MM
from simgen.view.live_job import PressChoices, base_job, live_job
from simgen.view.live_places import contact_poses, first_place
from view.live import job_at

PAIRS = [("digit", "biotac"), ("biotac", "digit")]


def loaded(job) -> dict:
    return {name: chosen_sensor(job, name) for name in job.sensors}


@pytest.mark.parametrize("names", [*((name,) for name in bundled_sensors()), *PAIRS], ids=" and ".join)
def test_the_first_place_has_room_for_a_press_to_1_mm(names):
    base = base_job(names, ["sphere_7mm"])
    sensors = loaded(base)
    first = next(iter(sensors.values()))
    x, arc = first_place(first)
    job = live_job(base, PressChoices({"x_mm": x, "arc_mm": arc}, "sphere_7mm", 1.0, 10))
    [point], _ = skin_of(first.surface).points(MM * x, np.array([MM * arc]))
    assert Room(first, 1e-3, job.trajectories).is_touchable(point[None]).all()
    indented = gel_under_indenters(job, sensors, chosen_indenters(job))
    assert set(indented) == set(names)
    assert len(first_contacts(job, sensors, 1, indented).kept.points) == 1


@pytest.mark.parametrize("names", PAIRS, ids=" and ".join)
@pytest.mark.parametrize("tilt", [0.0, 12.0])
def test_a_pair_is_touched_at_the_same_place_with_aligned_normals(names, tilt):
    """The press axis is at the same angle to both normals, and the indenter's tip at the same x and arc."""
    x_mm, arc_mm = -6.0, 1.5
    contact = {"x_mm": x_mm, "arc_mm": arc_mm, "tilt_deg": tilt, "azimuth_deg": 50.0, "roll_deg": 20.0}
    job = live_job(base_job(names, ["ring_7mm"]), PressChoices(contact, "ring_7mm", 0.3, 3))
    sensors = loaded(job)
    poses = contact_poses(job, sensors)
    assert tuple(poses) == names
    seen = []
    for name, pose in poses.items():
        [point], [normal] = skin_of(sensors[name].surface).points(MM * x_mm, np.array([MM * arc_mm]))
        np.testing.assert_allclose(pose[:3, 3], point, atol=1e-9)
        assert -pose[:3, 1] @ normal == pytest.approx(np.cos(np.radians(tilt)), abs=1e-9)
        seen.append(normal @ pose[:3, :3])  # in the indenter's frame
    np.testing.assert_allclose(*seen, atol=1e-9)


def test_a_place_without_room_is_one_sentence():
    sensors = loaded(job_at())
    with pytest.raises(InputError, match=r"x_mm -30, arc_mm 0.*the skin of digit does not reach there; allowed: x_mm"):
        contact_poses(job_at(-30.0), sensors)
    with pytest.raises(
        InputError, match=r"a side wall of digit is nearer than 1\.5 mm .*; choose a place further from"
    ):
        contact_poses(job_at(4.0, depth_mm=1.0), sensors)
