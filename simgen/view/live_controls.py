"""Sliders and fields of the live page: place, depth, tilt, turn, indenter, mesh and material of a press."""

from collections.abc import Callable, Mapping, Sequence

from nicegui import ui

from simgen.config.job_schema import Job
from simgen.sensors.material import Material
from simgen.sensors.sensor import Sensor
from simgen.sensors.sensor_meshes import NAMES as MESHES
from simgen.view.live_job import PressChoices

DEEPEST_MM = 2.0
FRICTION_MOST = 1.5


class LiveControls:
    """Fields that choose a press.

    on_change : is called when what is pressed changes: the place, or the indenter and its direction
    on_setup : is called when the gel changes: mesh or material
    """

    def __init__(
        self, base: Job, sensors: Mapping[str, Sensor], materials: Mapping[str, Material], place: tuple[float, float],
        on_change: Callable[[], None], on_setup: Callable[[], None],
    ):  # fmt: skip
        self._on_change = on_change
        self.x_mm, self.arc_mm = place
        with ui.element("div").classes("row-line"):
            self._indenter = self._select("indenter", base.indenter_names, base.indenter_names[0], on_change)
            self._indenter.classes("live-indenter")
            mesh = next(iter(base.sensors.values())).mesh
            self._mesh = self._select("mesh", MESHES, mesh, on_setup)
            self._depth = self._slider("depth", "mm", 0.1, DEEPEST_MM, 0.1, base.depths_mm.last, on_change, "live-depth")
            self._tilt = self._slider("tilt", "deg", 0, 30, 1, 0, on_change, "live-tilt")
            self._azimuth = self._slider("tilts towards", "deg", 0, 360, 5, 0, on_change, "live-azimuth")
            self._roll = self._slider("turn", "deg", -180, 180, 5, 0, on_change, "live-turn")
        self._sensors, self._on_setup, self._materials = sensors, on_setup, {}
        for name, sensor in sensors.items():
            with ui.element("div").classes("row-line"):
                self._materials[name] = self._build_material(name, sensor, base.sensors[name].material.preset, materials[name])

    def _build_material(self, name: str, sensor: Sensor, chosen: str, own: Material) -> tuple:
        def use_preset() -> None:
            stiffness.value, friction.value = _numbers(sensor.materials[preset.value])
            self._on_setup()

        preset = self._select(f"{name}: material", list(sensor.materials), chosen, use_preset)
        modulus, coefficient = _numbers(own)
        stiffness = self._slider("E", "kPa", 20, 2000, 1, modulus, self._on_setup, f"stiffness-{name}")
        friction = self._slider("friction", "", 0, FRICTION_MOST, 0.01, coefficient, self._on_setup, f"friction-{name}")
        return preset, stiffness, friction

    def _select(self, label: str, options: Sequence[str], value: str, on_change: Callable) -> ui.select:
        field = ui.select(list(options), value=value, label=label, on_change=lambda: on_change())
        return field.props("dense outlined").style("min-width: 130px")

    def _slider(
        self, label: str, unit: str, low: float, high: float, step: float, value: float, on_change: Callable, name: str
    ) -> ui.slider:
        with ui.element("div").classes("fill"):
            title = ui.label().classes("small")
            slider = ui.slider(min=low, max=high, step=step, value=value, on_change=lambda: on_change()).classes(name)
            slider.on("change", js_handler="() => document.activeElement?.blur()")
            title.bind_text_from(slider, "value", lambda number: f"{label}: {number:g} {unit}".strip())
        return slider

    def place(self, x_m: float, arc_m: float) -> None:
        """Choose the place of the contact on the unrolled skin of the first sensor, m."""
        self.x_mm, self.arc_mm = 1e3 * x_m, 1e3 * arc_m
        self._on_change()

    @property
    def choices(self) -> PressChoices:
        """The press that the fields choose."""
        contact = {
            "x_mm": self.x_mm, "arc_mm": self.arc_mm, "tilt_deg": float(self._tilt.value),
            "azimuth_deg": float(self._azimuth.value), "roll_deg": float(self._roll.value),
        }  # fmt: skip
        depth = round(float(self._depth.value), 3)
        materials = {name: self._material(name) for name in self._materials}
        steps = max(1, round(10 * depth))  # of 0.1 mm
        return PressChoices(contact, self._indenter.value, depth, steps, self._mesh.value, materials)

    def _material(self, name: str) -> dict:
        preset, stiffness, friction = self._materials[name]
        modulus, coefficient = _numbers(self._sensors[name].materials[preset.value])
        chosen = {"preset": preset.value}
        if stiffness.value != modulus:
            chosen["youngs_modulus_pa"] = 1e3 * float(stiffness.value)
        if friction.value != coefficient:
            chosen["friction"] = float(friction.value)
        return chosen


def _numbers(material: Material) -> tuple[float, float]:
    """Young's modulus, kPa, and friction of a material."""
    return material.youngs_modulus_pa / 1e3, material.friction
