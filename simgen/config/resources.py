"""Locations of the bundled data: sensor models, indenters, jobs."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def resource(kind: str) -> Path:
    """The folder of the bundled ``"sensor_models"``, ``"indenters"`` or ``"jobs"``.

    A wheel has it inside the package; a checkout or an editable install has it beside the package.
    """
    inside = PACKAGE / kind
    return inside if inside.is_dir() else PACKAGE.parent / kind


def bundled_jobs(training: bool = False) -> list[Path]:
    """The bundled job files, sorted: jobs of datasets, or training jobs (``training*.yaml``)."""
    files = resource("jobs").glob("*.yaml")
    return sorted(file for file in files if file.stem.startswith("training") == training)
