"""The Python lines that load a sample, to copy from the page."""

import numpy as np

from simgen.dataset.reader import Dataset
from simgen.dataset.splits import IN_NONE
from simgen.fem.nonlinear.status import is_valid
from simgen.view.drawn_surface import AT_REST


def python_lines(dataset: Dataset, press: int, step: int) -> str:
    """Lines that load the rest positions ``rest`` and displacements ``u`` of every sensor: (vertex, 3) m, by sensor.

    They use `simgen.load_dataset` for a sample that it gives: valid on all sensors, and in a split. Other samples are
    read from the arrays, and the lines say so. Raises `InputError` if the dataset cannot be read.
    """
    path, names = str(dataset.path.resolve()), list(dataset.sensors)
    if step != AT_REST and _is_loaded(dataset, press, step):
        return (
            "from simgen import load_dataset\n\n"
            f"samples = load_dataset({path!r})\n"
            f"sample = samples[samples.rows.tolist().index([{press}, {step}])]  # press, index of the depth\n"
            "rest = samples.rest_positions  # m, by sensor\n"
            'u = {sensor: sample[f"{sensor}/displacement"] for sensor in samples.sensors}\n'
        )
    opened = (
        "from simgen.dataset.reader import Dataset\n\n"
        f"dataset = Dataset({path!r})\n"
        'rest = {sensor: dataset[f"{sensor}/rest_positions"] for sensor in dataset.sensors}  # m\n'
    )
    if step == AT_REST:
        return (
            opened
            + "u = {sensor: 0.0 * rest[sensor] for sensor in dataset.sensors}  # first touch: the gel is at rest\n"
        )
    status = ", ".join(f"{name} {int(dataset.of_press(f'{name}/status', press)[step])}" for name in names)
    return (
        f"{opened}# load_dataset leaves this sample out (status: {status}; NaN where it was not reached)\n"
        f"u = {{sensor: dataset.displacement(sensor, {press}, {step}) for sensor in dataset.sensors}}\n"
    )


def _is_loaded(dataset: Dataset, press: int, step: int) -> bool:
    """True if `simgen.load_dataset` gives a sample."""
    codes = np.array([dataset.of_press(f"{sensor}/status", press)[step] for sensor in dataset.sensors])
    return bool(is_valid(codes).all()) and dataset["press/split"][press] != IN_NONE
