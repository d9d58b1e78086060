"""A slab of gel as a user's own sensor."""

import yaml

SOLID = {"youngs_modulus_pa": 539e3, "poisson_ratio": 0.499, "friction": 0.78}
SLAB = {
    "name": "slab",
    "gel": {"mesh": {"file": "slab.stl", "unit": "mm"}},
    "held": {"back": {"plane": {"axis": "y", "at_mm": 2.0}}},
    "meshes": {"default": {"edge_length_mm": 2.0, "held_edge_length_mm": 3.0}},
    "materials": {"solid": SOLID},
}


def write_sensor(folder, description):
    """Write a ``sensor.yaml``; returns its folder."""
    folder.mkdir(exist_ok=True, parents=True)
    (folder / "sensor.yaml").write_text(yaml.safe_dump(description))
    return folder
