"""Sliders and fields of the live page: place, depth, tilt, turn, indenter, mesh and material of a press."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from nicegui import ui

from simgen.sensors.material import Material
from simgen.sensors.sensor import Sensor
from simgen.sensors.sensor_meshes import NAMES as MESHES
from simgen.units import MM_PER_M
from simgen.view.colours import PA_PER_KPA
from simgen.view.live_job import PressChoices
from simgen.view.live_setup import LiveSetup
from simgen.view.page_style import CHOSEN, keys_stay_with_the_page

DEEPEST_MM, STEP_MM = 2.0, 0.1  # of the depth slider, which goes further for a job that does


@dataclass
class MaterialFields:
    """The fields of one sensor's material."""

    sensor: Sensor
    preset: ui.select
    stiffness_kpa: ui.slider
    friction: ui.slider

    def use_preset(self) -> None:
        """Set the sliders to the values of the chosen preset."""
        self.stiffness_kpa.value, self.friction.value = _values(self.sensor.materials[self.preset.value])

    @property
    def choices(self) -> dict[str, Any]:
        """Keys of `simgen.config.choices.MaterialChoice`: the preset, and values that differ from it, others None."""
        stiffness, friction = _values(self.sensor.materials[self.preset.value])
        own_stiffness, own_friction = float(self.stiffness_kpa.value), float(self.friction.value)
        return {
            "preset": self.preset.value,
            "youngs_modulus_pa": PA_PER_KPA * own_stiffness if own_stiffness != stiffness else None,
            "friction": own_friction if own_friction != friction else None,
        }


class LiveControls:
    """Fields that choose a press.

    place_mm : x and arc of the contact on the unrolled skin of the first sensor
    on_change : is called when another press is chosen: its place, indenter, direction or depth
    on_gel : is called when another gel is chosen: a mesh or a material
    """

    def __init__(
        self,
        setup: LiveSetup,
        place_mm: tuple[float, float],
        on_change: Callable[[], None],
        on_gel: Callable[[], None],
    ):
        self.place_mm, self._on_change, self._on_gel = place_mm, on_change, on_gel
        base = setup.base
        with ui.element("div").classes("row-line"):
            names, mesh = base.indenter_names, next(iter(base.sensors.values())).mesh
            self._indenter = self._select("indenter", names, names[0], on_change).classes("live-indenter")
            self._mesh = self._select("mesh", MESHES, mesh, on_gel)
            depth = max(round(base.depths_mm.last / STEP_MM) * STEP_MM, STEP_MM)
            range_mm = STEP_MM, max(DEEPEST_MM, depth), STEP_MM
            self._depth = self._slider("depth", "mm", range_mm, depth, on_change, "live-depth")
            self._tilt = self._slider("tilt", "deg", (0, 30, 1), 0, on_change, "live-tilt")
            self._azimuth = self._slider("tilts towards", "deg", (0, 360, 5), 0, on_change, "live-azimuth")
            self._roll = self._slider("turn", "deg", (-180, 180, 5), 0, on_change, "live-turn")
        self._materials = {
            name: self._material(name, sensor, base.sensors[name].material.preset, setup.materials[name])
            for name, sensor in setup.sensors.items()
        }

    def _material(self, name: str, sensor: Sensor, preset: str, own: Material) -> MaterialFields:
        stiffness, friction = _values(own)
        with ui.element("div").classes("row-line"):
            fields = MaterialFields(
                sensor,
                self._select(f"{name}: material", list(sensor.materials), preset, self._on_gel),
                self._slider("E", "kPa", (20, 2000, 1), stiffness, self._on_gel, f"stiffness-{name}"),
                self._slider("friction", "", (0, 1.5, 0.01), friction, self._on_gel, f"friction-{name}"),
            )
        fields.preset.on_value_change(lambda: fields.use_preset())
        return fields

    @staticmethod
    def _select(label: str, options: Sequence[str], value: str, on_change: Callable[[], None]) -> ui.select:
        field = ui.select(list(options), value=value, label=label, on_change=lambda: on_change())
        return keys_stay_with_the_page(field, CHOSEN).props("dense outlined").style("min-width: 130px")

    @staticmethod
    def _slider(
        label: str,
        unit: str,
        range_: tuple[float, float, float],
        value: float,
        on_change: Callable[[], None],
        name: str,
    ) -> ui.slider:
        """A slider with its value above it; the range is the least value, the largest, and the step."""
        low, high, step = range_
        with ui.element("div").classes("fill"):
            title = ui.label().classes("small")
            slider = ui.slider(min=low, max=high, step=step, value=value, on_change=lambda: on_change()).classes(name)
            title.bind_text_from(slider, "value", lambda number: f"{label}: {number:g} {unit}".strip())
        return keys_stay_with_the_page(slider)

    def place(self, x: float, arc: float) -> None:
        """Choose the place of the contact, m."""
        self.place_mm = MM_PER_M * x, MM_PER_M * arc
        self._on_change()

    @property
    def choices(self) -> PressChoices:
        """The press that the fields choose. Its depths are `STEP_MM` apart."""
        x, arc = self.place_mm
        tilt, azimuth, roll = (float(field.value) for field in (self._tilt, self._azimuth, self._roll))
        contact = {"x_mm": x, "arc_mm": arc, "tilt_deg": tilt, "azimuth_deg": azimuth, "roll_deg": roll}
        steps = round(float(self._depth.value) / STEP_MM)
        materials = {name: fields.choices for name, fields in self._materials.items()}
        return PressChoices(
            contact, self._indenter.value, round(steps * STEP_MM, 6), steps, self._mesh.value, materials
        )


def _values(material: Material) -> tuple[float, float]:
    """Young's modulus, kPa, and friction of a material."""
    return material.youngs_modulus_pa / PA_PER_KPA, material.friction
