"""Fields of the live page: what they choose, and the job of it."""

import pytest
from nicegui import ui

from simgen.view.live_controls import LiveControls
from simgen.view.live_job import live_job
from simgen.view.live_setup import LiveSetup
from view.page_parts import elements, field, texts

PRESET = {"youngs_modulus_pa": None, "friction": None}


@pytest.fixture(scope="module")
def pair() -> LiveSetup:
    return LiveSetup.of(["digit", "biotac"], "ring_7mm", None, None)


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def controls(client, pair, told) -> LiveControls:
    return made(pair, told)


def made(setup: LiveSetup, told: list[str]) -> LiveControls:
    return LiveControls(setup, (-7.0, 0.5), lambda: told.append("press"), lambda: told.append("gel"))


def slider(client, name: str) -> ui.slider:
    [found] = elements(client, ui.slider, name)
    return found


def test_the_first_choices_are_those_of_the_base_job(pair, controls, told):
    choices = controls.choices
    assert choices.contact == {"x_mm": -7.0, "arc_mm": 0.5, "tilt_deg": 0.0, "azimuth_deg": 0.0, "roll_deg": 0.0}
    assert (choices.indenter, choices.depth_mm, choices.depths, choices.mesh) == ("ring_7mm", 1.0, 10, "coarse")
    assert choices.materials == {name: {"preset": "solid", **PRESET} for name in ("digit", "biotac")}
    job = live_job(pair.base, choices)
    assert job.sensors == pair.base.sensors and job.depths_mm == pair.base.depths_mm and not told


def test_a_place_is_chosen_in_metres(controls, told):
    controls.place(-0.002, 0.0015)
    assert controls.place_mm == (-2.0, 1.5) and told == ["press"]
    assert (controls.choices.contact["x_mm"], controls.choices.contact["arc_mm"]) == (-2.0, 1.5)


@pytest.mark.parametrize("name, key", [("tilt", "tilt_deg"), ("azimuth", "azimuth_deg"), ("turn", "roll_deg")])
def test_sliders_choose_the_direction(client, pair, controls, told, name, key):
    slider(client, f"live-{name}").value = 25
    job = live_job(pair.base, controls.choices)
    angles = job.trajectories.contacts[0].model_dump(include={"tilt_deg", "azimuth_deg", "roll_deg"})
    assert angles == {"tilt_deg": 0.0, "azimuth_deg": 0.0, "roll_deg": 0.0, key: 25.0} and told == ["press"]


@pytest.mark.parametrize("depth_mm, depths", [(0.1, 1), (0.30000000000000004, 3), (1.7, 17), (2, 20)])
def test_depths_are_a_tenth_of_a_millimetre_apart(client, pair, controls, told, depth_mm, depths):
    slider(client, "live-depth").value = depth_mm
    steps = live_job(pair.base, controls.choices).depths_m
    assert [round(1e6 * depth) for depth in steps] == [100 * (step + 1) for step in range(depths)]
    assert steps[-1] == pytest.approx(1e-3 * depth_mm, abs=1e-12) and told == ["press"]
    assert f"depth: {depth_mm:g} mm" in texts(client)


def test_a_mesh_is_chosen_for_all_sensors(client, pair, controls, told):
    field(client, "mesh").value = "fine"
    job = live_job(pair.base, controls.choices)
    assert {each.mesh for each in job.sensors.values()} == {"fine"} and told == ["gel"]


def test_a_material_is_in_the_job_where_it_differs_from_the_preset(client, pair, controls, told):
    slider(client, "stiffness-biotac").value = 300
    assert controls.choices.materials["biotac"] == {"preset": "solid", "youngs_modulus_pa": 3e5, "friction": None}
    slider(client, "friction-digit").value = 0.2
    assert controls.choices.materials["digit"] == {"preset": "solid", "youngs_modulus_pa": None, "friction": 0.2}
    assert told == ["gel", "gel"]
    sensors = live_job(pair.base, controls.choices).sensors
    assert sensors["biotac"].material.youngs_modulus_pa == 3e5 and sensors["digit"].material.youngs_modulus_pa is None
    slider(client, "stiffness-biotac").value = 539
    slider(client, "friction-digit").value = 0.78
    assert live_job(pair.base, controls.choices).sensors == pair.base.sensors


def test_a_preset_moves_its_own_sliders(client, pair, controls, told):
    slider(client, "friction-biotac").value = 0.1
    field(client, "biotac: material").value = "effective"
    effective = pair.sensors["biotac"].materials["effective"]
    stiffness, friction = (slider(client, f"{name}-biotac").value for name in ("stiffness", "friction"))
    assert (1e3 * stiffness, friction) == (effective.youngs_modulus_pa, effective.friction)
    assert slider(client, "stiffness-digit").value == 539.0 and set(told) == {"gel"}
    materials = controls.choices.materials
    assert materials == {"digit": {"preset": "solid", **PRESET}, "biotac": {"preset": "effective", **PRESET}}


def test_values_of_a_job_stay_until_the_user_changes_them(client, tmp_path):
    """They must not come back with the preset's values on the sliders."""
    (tmp_path / "own.yaml").write_text(
        "name: own\n"
        "sensors: {biotac: {model: biotac, mesh: coarse, material: {youngs_modulus_pa: 123e3, friction: 0.3}}}\n"
        "indenters: [sphere_7mm, ring_7mm]\n"
        "trajectories: {count: 5}\n"
        "depths_mm: {first: 0.2, last: 0.4, count: 2}\n"
    )
    setup = LiveSetup.of([], None, None, str(tmp_path / "own.yaml"))
    controls = made(setup, [])

    def material() -> tuple:
        chosen = live_job(setup.base, controls.choices).sensors["biotac"].material
        return chosen.preset, chosen.youngs_modulus_pa, chosen.friction

    assert slider(client, "stiffness-biotac").value == 123.0 and material() == ("solid", 123e3, 0.3)
    slider(client, "friction-biotac").value = 0.78
    assert material() == ("solid", 123e3, None)
    field(client, "biotac: material").value = "effective"
    assert material() == ("effective", None, None)
    field(client, "indenter").value = "ring_7mm"
    assert live_job(setup.base, controls.choices).indenter_names == ("ring_7mm",)
