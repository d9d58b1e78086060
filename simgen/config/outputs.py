"""The table of outputs: every quantity that a dataset keeps of a press, with shape, type, unit and meaning.

Measurements, arrays of a dataset, audit, loader, card and docs follow from this table. To add an output, add an entry
here and a function of the same name in `simgen.simulation.measurements` (docs/tasks/add_an_output.md).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

# Axes whose length depends on the sensor: its output mesh, or the image of its camera.
VERTEX, SURFACE_VERTEX, PIXEL_ROW, PIXEL_COLUMN = "vertex", "surface vertex", "pixel row", "pixel column"
CERTIFICATE = "certificate/"
NOT_REACHED = -(2**15)  # int16 value of a missing sample; other integers have -1, floats NaN


@dataclass(frozen=True)
class Output:
    """One quantity at every step of a press, on one sensor.

    name : name of the dataset's array ``<sensor>/<name>``; a certificate's begins with ``certificate/``
    shape : shape of one sample; `VERTEX`, `SURFACE_VERTEX`, `PIXEL_ROW` and `PIXEL_COLUMN` stand for numbers of them
    dtype : type in the dataset
    unit : unit in the dataset; empty for pure numbers, and if ``about`` states it
    about : meaning
    kept : "always"; "with fluid": if a fluid fills the cavity; "with legs": if the path has legs, or if the job asks;
        "on request": if the job asks
    note : interpretation of a value; for the docs
    needs : what an estimated error is computed from after a press: "coarser mesh" for the same press on a coarser mesh,
        or the name of another output along the path
    is_slow : it is measured only if a job asks for it, or for an estimate that needs it
    """

    name: str
    shape: tuple[int | str, ...]
    dtype: str
    unit: str
    about: str
    kept: Literal["always", "with fluid", "with legs", "on request"] = "always"
    note: str = ""
    needs: Literal["", "coarser mesh", "error_energy"] = ""
    is_slow: bool = False

    @property
    def is_optional(self) -> bool:
        """True if a job may ask for it."""
        return self.kept in ("with legs", "on request")

    @property
    def is_estimate(self) -> bool:
        """True if it is an estimated error, computed after a press."""
        return bool(self.needs)

    @property
    def is_certificate(self) -> bool:
        """True if it measures how well the equations of a sample are solved."""
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
    def is_image(self) -> bool:
        """True if it has values at the pixels of the sensor's camera."""
        return PIXEL_ROW in self.shape

    @property
    def is_sensor_value(self) -> bool:
        """True for a number or vector of the whole sensor: no mesh, image, status or certificate."""
        return not (self.is_mesh or self.is_image or self.is_certificate or self.name == "status")

    @property
    def is_read_by_sample(self) -> bool:
        """True if each sample is a chunk of its own, as training reads it."""
        return self.is_mesh or self.is_image

    def shape_of(self, lengths: Mapping[str, int]) -> tuple[int, ...]:
        """The shape of one sample, for a sensor with these lengths of the axes."""
        return tuple(lengths[axis] if isinstance(axis, str) else axis for axis in self.shape)


OUTPUTS = (
    Output("displacement", (VERTEX, 3), "int16", "m", "displacement of the output vertices"),
    Output("force", (3,), "float64", "N", "force on the sensor, in its frame"),
    Output("moment", (3,), "float64", "N m", "moment on the sensor about the origin of its frame"),
    Output("status", (), "int8", "", "0 converged; the root attribute `status` explains the others"),
    Output("shear_force", (2,), "float64", "N", "force on the sensor along x and z of the contact frame", "with legs"),
    Output("slip_share", (), "float64", "",
           "share of the contact area where friction is at its limit, so that the surface slides", "with legs"),
    Output("stress", (SURFACE_VERTEX, 6), "float32", "Pa",
           "Cauchy stress at surface_vertices, as xx, yy, zz, yz, xz, xy in the sensor's frame", "on request",
           is_slow=True),
    Output("traction", (SURFACE_VERTEX, 3), "float32", "Pa",
           "force of the indenter on the sensor per rest area, at surface_vertices, in the sensor's frame",
           "on request", is_slow=True),
    Output("height_map", (PIXEL_ROW, PIXEL_COLUMN), "int16", "m",
           "height of the gel's surface above its surface at rest, towards the camera, at the camera's pixels",
           "on request",
           note="rays meet the curved faces of the solution, not the output mesh; `simgen render` uses it. In memory: "
           "int16 steps of the scene's `height_step_m`, -32768 for a missing sample",
           is_slow=True),
    Output("contact_area", (), "float64", "mm2",
           "area of the surface, as it is at rest, that the indenter presses on", "on request"),
    Output("error_energy", (), "float64", "J",
           "energy of the difference between the strain and its smoothed field, an indicator of the mesh's error",
           "on request", is_slow=True),
    Output("surface_error_estimate_m", (), "float32", "m",
           "estimated error of the mesh: root mean square over the vertices that move by 10 um or more", "on request",
           needs="coarser mesh"),
    Output("force_error_estimate", (), "float32", "",
           "estimated error of the mesh: share of the force", "on request", needs="error_energy"),
    Output("cavity_pressure", (), "float64", "Pa", "pressure of the fluid in the cavity, above ambient", "with fluid"),
    Output("certificate/residual", (), "float64", "",
           "out-of-balance forces over contact forces, Euclidean norms over the nodes",
           note="how well the equations are solved; at most `residual_tolerance`"),
    Output("certificate/contact_error", (), "float64", "",
           "relative change (L2, weighted by edges) that one more multiplier update would make",
           note="how well the contact constraint holds; at most `contact_tolerance`"),
    Output("certificate/force_balance", (), "float64", "",
           "|contact force + reaction of the fixed nodes| / |contact force|",
           note="Newton's third law from end to end; the audit allows 1e-3"),
    Output("certificate/min_det_F", (), "float64", "", "least det F over the elements' quadrature points",
           note="above 0 nothing is inverted there; far from 1 means large strains, or a mesh too coarse"),
    Output("certificate/least_det_F", (), "float64", "", "lower bound of det F over all of every element",
           note="above 0 no element is inverted anywhere, also between its quadrature points"),
    Output("certificate/inverted_elements", (), "int32", "",
           "elements that are inverted somewhere, by a bound over each (conservative)",
           note="0: det F > 0 everywhere. Otherwise the sample has status 9: be careful with its strains"),
    Output("certificate/stabilised_elements", (), "int32", "",
           "elements that a strain gradient and more bulk stiffness keep from inverting",
           note="0: the plain equations. Some hundreds: a deep press under an edge; see [physics](physics.md#solver)"),
    Output("certificate/rms_penetration_m", (), "float64", "",
           "root mean square pointwise penetration over the contact area, m",
           note="distance between the surfaces of gel and indenter, in both directions"),
    Output("certificate/max_penetration_m", (), "float64", "", "largest pointwise penetration, m",
           note="contact that the mesh does not resolve"),
    Output("certificate/newton_iterations", (), "int32", "", "Newton iterations of this depth, all sub-steps",
           note="effort"),
    Output("certificate/krylov_iterations", (), "int32", "", "iterations of the linear solver of this depth",
           note="effort"),
    Output("certificate/substeps", (), "int32", "",
           "increments attempted since the depth before, failed ones included",
           note="more than one for each 0.25 mm: this depth was hard"),
    Output("certificate/damping", (), "float64", "",
           "largest damping of the tangent, over mu: forces and displacements are not damped",
           note="above 0: this depth was hard"),
    Output("certificate/liquid_volume_error", (), "float64", "",
           "change of the fluid's volume / volume of the cavity", "with fluid",
           note="the audit allows 1e-6"),
)  # fmt: skip

BY_NAME = {output.name: output for output in OUTPUTS}
OPTIONAL = tuple(output.name for output in OUTPUTS if output.is_optional)  # a job may ask for these
BY_COARSER_MESH = tuple(output.name for output in OUTPUTS if output.needs == "coarser mesh")
AT_SURFACE = tuple(output.name for output in OUTPUTS if output.at_surface)
READ_BY_SAMPLE = tuple(output.name for output in OUTPUTS if output.is_read_by_sample and output.is_optional)
SENSOR_VALUES = tuple(output.name for output in OUTPUTS if output.is_sensor_value)


def kept_outputs(fluid: bool, legs: bool, asked: tuple[str, ...] = ()) -> Iterator[Output]:
    """The outputs that a dataset keeps for a sensor.

    fluid : a fluid fills the cavity; legs : the path has legs; asked : names that the job asks for
    """
    always = {"always": True, "with fluid": fluid, "with legs": legs, "on request": False}
    return (output for output in OUTPUTS if always[output.kept] or output.name in asked)
