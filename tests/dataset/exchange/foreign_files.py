"""Result files as other programs write them, without the attributes of simgen."""

import h5py


def of_others(path, layout, samples, sensor="digit"):
    """A file without any attribute; ``samples`` are (trial, env, step, coordinates, depth or None)."""
    with h5py.File(path, "w") as file:
        for trial, env, step, coordinates, depth in samples:
            head, tail = (f"trial_{trial}/step_{step}", f"_{sensor}") if layout == "across" else (f"step_{step}", "")
            file[f"{head}/nodal_coords{tail}/env_{env}"] = coordinates
            file[f"{head}/net_force_vecs{tail}/env_{env}"] = [0.0, step + 1.0, 0.0]
            if depth is not None:
                file[f"{head}/max_contact_distances/env_{env}"] = depth
    return path


def spoiled(rest, **changes):
    sample = {"trial": 0, "env": 0, "step": 0, "coordinates": rest, "depth": 1e-3}
    return tuple((sample | changes).values())
