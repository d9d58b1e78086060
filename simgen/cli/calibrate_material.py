"""The command `simgen calibrate-material`."""

from pathlib import Path
from typing import Annotated

import typer

from simgen.cli.options import Device
from simgen.errors import check_output_file, writing


def calibrate_material(
    forces: Annotated[
        Path, typer.Argument(metavar="FILE", help="CSV with depth_mm, force_n and perhaps std_n, a row a measurement.")
    ],
    sensor: Annotated[
        str, typer.Option("--sensor", metavar="SENSOR", help="A bundled sensor, or a folder with a sensor.yaml.")
    ],
    indenter: Annotated[
        str | None, typer.Option("--indenter", metavar="INDENTER", help="A bundled name, or a closed mesh.")
    ] = None,
    radius_mm: Annotated[
        float | None, typer.Option("--radius-mm", metavar="R", help="A sphere of this radius, in place of --indenter.")
    ] = None,
    unit: Annotated[str, typer.Option("--unit", metavar="UNIT", help="Unit of an indenter's mesh: m or mm.")] = "m",
    fit: Annotated[
        list[str] | None,
        typer.Option("--fit", metavar="NAME",
                     help="Fit this beside E: nu, friction, offset, c20, c30. Repeat for more; all combinations of "
                     "them are compared.", show_default="a standard set of models"),
    ] = None,
    friction: Annotated[
        float | None, typer.Option("--friction", metavar="MU", help="Friction where it is not fitted.",
                                   show_default="the material's")
    ] = None,
    material: Annotated[
        str, typer.Option("--material", metavar="NAME", help="Preset of the sensor, for all that is not fitted.")
    ] = "solid",
    at: Annotated[
        str | None, typer.Option("--at", metavar="X,ARC", help="Place, mm: x, and arc from the centre line.",
                                 show_default="the middle of the touchable surface")
    ] = None,
    mesh: Annotated[str, typer.Option("--mesh", metavar="MESH", help="default, coarse or fine.")] = "default",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write all results as JSON.")
    ] = None,
    device: Device = "cpu",
):  # fmt: skip
    """Fit a gel's material to measured forces against depth, and say what the data cannot tell apart.

    Presses are simulated at some values of each parameter and interpolated. E is always fitted.

    simgen calibrate-material forces.csv --sensor digit --indenter sphere_7mm --fit nu --fit offset
    """
    if output is not None:
        check_output_file(output)
    from simgen.calibration.chosen_rig import RigChoice, place_of

    choice = RigChoice(sensor, indenter, radius_mm, unit, mesh, material, friction, place_of(at), device)
    from simgen.cli.material_view import calibrate_and_print

    found = calibrate_and_print(forces, choice, fit or [])
    if output is not None:
        import json

        with writing(output):
            output.write_text(json.dumps(found, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        typer.echo(f"wrote {output}")
