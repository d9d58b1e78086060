"""The table of outputs: every quantity that a dataset keeps of a press, with shape, type, unit and meaning.

Measurements, arrays of a dataset, audit, loader, card and docs follow from this table. To add an output, add an entry
here and a function of the same name in `simgen.simulation.measurements` (docs/tasks/add_an_output.md).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

VERTEX, SURFACE_VERTEX = "vertex", "surface vertex"  # axes whose length depends on the sensor
CERTIFICATE = "certificate/"


@dataclass(frozen=True)
class Output:
    """One quantity at every step of a press, on one sensor.

    name : name of the dataset's array ``<sensor>/<name>``; a certificate's begins with ``certificate/``
    shape : shape of one sample; `VERTEX` and `SURFACE_VERTEX` stand for the number of vertices
    dtype : type in the dataset
    unit : unit in the dataset; empty for pure numbers
    about : meaning
    kept : always; with a fluid in the cavity; with legs, or on request; on request only
    """

    name: str
    shape: tuple[int | str, ...]
    dtype: str
    unit: str
    about: str
    kept: Literal["always", "with fluid", "with legs", "on request"] = "always"

    @property
    def is_optional(self) -> bool:
        """True if a job may ask for it."""
        return self.kept in ("with legs", "on request")

    @property
    def is_certificate(self) -> bool:
        """True if it measures the accuracy of a sample."""
        return self.name.startswith(CERTIFICATE)

    @property
    def at_surface(self) -> bool:
        """True if it has values at surface vertices."""
        return SURFACE_VERTEX in self.shape

    @property
    def is_mesh(self) -> bool:
        """True if it has values at vertices."""
        return self.at_surface or VERTEX in self.shape

    @property
    def is_measured(self) -> bool:
        """True for a number or vector of the whole sensor: no mesh, status or certificate."""
        return not (self.is_mesh or self.is_certificate or self.name == "status")

    def shape_of(self, vertices: int, surface_vertices: int) -> tuple[int, ...]:
        """The shape of one sample, for a sensor with these numbers of output vertices."""
        lengths = {VERTEX: vertices, SURFACE_VERTEX: surface_vertices}
        return tuple(lengths.get(axis, axis) for axis in self.shape)


OUTPUTS = (
    Output("displacement", (VERTEX, 3), "int16", "m", "of output vertices"),
    Output("force", (3,), "float64", "N", "on the sensor, in its frame"),
    Output("moment", (3,), "float64", "N m", "about the origin of the sensor frame"),
    Output("status", (), "int8", "", "0 converged; names in the root attributes"),
    Output("shear_force", (2,), "float64", "N", "force on the sensor along x and z of the contact frame", "with legs"),
    Output("slip_share", (), "float64", "",
           "share of the contact area where friction is at its limit, so that the surface slides", "with legs"),
    Output("stress", (SURFACE_VERTEX, 6), "float32", "Pa",
           "Cauchy stress at surface_vertices, as xx, yy, zz, yz, xz, xy in the sensor's frame", "on request"),
    Output("traction", (SURFACE_VERTEX, 3), "float32", "Pa",
           "force of the indenter on the sensor per rest area, at surface_vertices, in the sensor's frame",
           "on request"),
    Output("contact_area", (), "float64", "mm2",
           "area of the surface, as it is at rest, that the indenter presses on", "on request"),
    Output("cavity_pressure", (), "float64", "Pa", "of the fluid in the cavity, above ambient", "with fluid"),
    Output("certificate/residual", (), "float64", "",
           "out-of-balance forces over contact forces, Euclidean norms over the nodes"),
    Output("certificate/contact_error", (), "float64", "",
           "relative change (L2, weighted by edges) that one more multiplier update would make"),
    Output("certificate/force_balance", (), "float64", "",
           "|contact force + reaction of what is held| / |contact force|"),
    Output("certificate/min_det_F", (), "float64", "", "least det F over the elements' quadrature points"),
    Output("certificate/inverted_elements", (), "int32", "",
           "elements that are inside out somewhere, by a bound over each (conservative)"),
    Output("certificate/stabilised_elements", (), "int32", "",
           "elements that are kept open by a strain gradient and more bulk stiffness"),
    Output("certificate/rms_penetration_m", (), "float64", "",
           "root mean square pointwise penetration over the contact area, m"),
    Output("certificate/max_penetration_m", (), "float64", "", "largest pointwise penetration, m"),
    Output("certificate/newton_iterations", (), "int32", "", "Newton iterations of this depth, all sub-steps"),
    Output("certificate/krylov_iterations", (), "int32", "", "iterations of the linear solver of this depth"),
    Output("certificate/substeps", (), "int32", "",
           "load increments attempted from the depth before, failed ones included"),
    Output("certificate/damping", (), "float64", "",
           "largest damping of the tangent, over mu: forces and displacements are not damped"),
    Output("certificate/liquid_volume_error", (), "float64", "",
           "change of the fluid's volume / volume of the cavity", "with fluid"),
)  # fmt: skip

BY_NAME = {output.name: output for output in OUTPUTS}
OPTIONAL = tuple(output.name for output in OUTPUTS if output.is_optional)  # a job may ask for these
AT_SURFACE = tuple(output.name for output in OUTPUTS if output.at_surface)
MEASURED = tuple(output.name for output in OUTPUTS if output.is_measured)


def kept_outputs(fluid: bool, legs: bool, asked: tuple[str, ...] = ()) -> Iterator[Output]:
    """The outputs that a dataset keeps for a sensor.

    fluid : a fluid fills the cavity; legs : the path has legs; asked : names that the job asks for
    """
    always = {"always": True, "with fluid": fluid, "with legs": legs, "on request": False}
    return (output for output in OUTPUTS if always[output.kept] or output.name in asked)
