"""Where the data that travels with the package lies: sensor models, indenters, jobs."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


def resource(kind: str) -> Path:
    """The folder of the bundled ``"sensor_models"``, ``"indenters"`` or ``"jobs"``.

    In an installed wheel it lies inside the package, in a checkout (or an editable install) beside it.
    """
    inside = PACKAGE / kind
    return inside if inside.is_dir() else PACKAGE.parent / kind
