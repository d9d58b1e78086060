"""Where the data that travels with the package lies: sensor models, indenters, jobs."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def resource(kind: str) -> Path:
    """The folder of the bundled ``"sensor_models"``, ``"indenters"`` or ``"jobs"``.

    In an installed wheel it lies inside the package, in a checkout (or an editable install) beside it.
    """
    inside = PACKAGE / kind
    return inside if inside.is_dir() else PACKAGE.parent / kind


def bundled_jobs(training: bool = False) -> list[Path]:
    """The bundled job files by name: those of datasets, or those of trainings (``training*.yaml``)."""
    files = resource("jobs").glob("*.yaml")
    return sorted(file for file in files if file.stem.startswith("training") == training)
