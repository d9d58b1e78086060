"""``README.md`` of a dataset: its contents, accuracy, origin, and how to read it."""

import re
from collections.abc import Iterator

import numpy as np
import yaml

from simgen.dataset.audit import estimated_error
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import SPLITS, split_names
from simgen.fem.nonlinear.status import in_words, is_planned_end, is_valid

READING = """```python
import torch
from simgen import load_dataset

samples = load_dataset("{path}", split="train")  # this folder; samples that are valid on all sensors
sample = samples[0]                         # arrays by name, float32, SI units
u = sample["{sensor}/displacement"]         # (vertex, 3) m; rest positions are in samples.rest_positions
loader = torch.utils.data.DataLoader(samples.torch(), batch_size=32, shuffle=True)
```"""

LIMITS = (
    "Presses are quasi-static: no inertia, no viscosity, no wear, no temperature.",
    "Indenters are rigid and move along a {way}, one indenter at a time, from first touch on.",
    "Numbers come from a model of the sensors, not from a measurement of one.",
)

SHAPES = {
    "biotac": "The BioTac's shape was measured on a public mesh of its skin (NVlabs/biotac_sim, MIT), which is no part "
              "of simgen or of this dataset.",
    "digit": "The DIGIT's shape was measured on a public mesh of its gel (wzaielamri/across_framework, MIT), which is "
             "no part of simgen or of this dataset.",
    "gelsight_mini": "The GelSight Mini's gel has figures of its maker's CAD (gelsightinc/gsrobotics), which is no "
                     "part of simgen or of this dataset.",
}  # fmt: skip
METHOD = (
    "simgen makes pairs as ACROSS does: A Deformation-Based Cross-Modal Representation for Robotic Tactile Perception "
    "(ICRA 2025, arXiv:2411.08533)."
)


def readme(dataset: Dataset) -> str:
    """Make the text in Markdown, with the front matter that dataset hubs read."""
    sections = {"What is in it": _contents, "What its samples are worth": _worth, "How it was made": _making,
                "How to read it": _reading, "Limits, licence, sources": _terms}  # fmt: skip
    parts = [_front_matter(dataset), _head(dataset)]
    parts += [(f"## {title}", "", *section(dataset)) for title, section in sections.items()]
    return "\n\n".join(map("\n".join, parts)) + "\n"


def summary(dataset: Dataset) -> str:
    """Describe the dataset in one sentence."""
    job = dataset.job
    counts = f"{job.trajectories.count:,} contacts x {job.indenters_in_words} x {job.steps_in_words}"
    kept = "displacement of every vertex, force, moment, and a certificate of accuracy"
    return f"Simulated touch: {counts} on {' and '.join(dataset.sensors)}: {kept}."


def _front_matter(dataset: Dataset) -> Iterator[str]:
    known = {"pretty_name": dataset.job.name, "tags": ["tactile", "simulation", "finite-elements", "robotics"]}
    if dataset.job.dataset.license:
        known["license"] = dataset.job.dataset.license
    yield from ("---", yaml.safe_dump(known, sort_keys=False).rstrip(), "---")


def _head(dataset: Dataset) -> Iterator[str]:
    yield f"# {dataset.job.name}"
    yield ""
    yield summary(dataset)
    if len(dataset.sensors) > 1:
        yield "The same contact is pressed into each sensor, so that samples are pairs."


def _contents(dataset: Dataset) -> Iterator[str]:
    indenter, split = dataset["press/indenter"], split_names(dataset["press/split"])
    kinds = [*SPLITS, *(["none"] if "none" in split else [])]
    header = ["presses of", *kinds, *(f"valid samples of {sensor}" for sensor in dataset.sensors)]
    yield from _row(header)
    yield from _row(["---"] * len(header))
    status = {sensor: dataset[f"{sensor}/status"] for sensor in dataset.sensors}
    for index, name in enumerate(dataset.indenters):
        own = indenter == index
        counts = [np.count_nonzero(own & (split == kind)) for kind in kinds]
        valid = [f"{np.count_nonzero(is_valid(each[own]))} of {np.count_nonzero(~is_planned_end(each[own]))}"
                 for each in status.values()]  # fmt: skip
        yield from _row([_plain(name), *counts, *valid])
    yield ""
    yield "No contact (trajectory) is in two splits. `presses.csv` lists the presses, `croissant.json` describes table"
    yield "and arrays, and the folder itself is a zarr v3 group."
    if (left_out := dataset.job.dataset.leave_out) is not None:
        yield f"The test split has {_plain(left_out)} alone, and the others have all other indenters. The rest of the"
        yield "presses is in no split (none)."


def _worth(dataset: Dataset) -> Iterator[str]:
    yield "A sample is valid if its forces balance and no element is inverted anywhere."
    yield "The worst values over the valid samples; every sample has its own."
    yield ""
    keys = _certificate_formats(dataset)
    yield from _row(["sensor", *keys])
    yield from _row(["---"] * (1 + len(keys)))
    for sensor in dataset.sensors:
        good = is_valid(dataset[f"{sensor}/status"])
        worst = []
        for key, form in keys.items():
            values = dataset[f"{sensor}/certificate/{key}"][good]
            pick = np.min if key.endswith("det_F") else np.max
            worst.append(form.format(pick(values)) if len(values) else "")
        yield from _row([sensor, *worst])
    yield from _estimates(dataset)
    yield from _others(dataset)


def _certificate_formats(dataset: Dataset) -> dict[str, str]:
    """Formats of the worst values of certificates, by key."""
    least = "least_det_F" if f"{dataset.sensors[0]}/certificate/least_det_F" in dataset.arrays else "min_det_F"
    return {"residual": "{:.1e}", "contact_error": "{:.1e}", "force_balance": "{:.1e}", least: "{:.3f}",
            "inverted_elements": "{:.0f}", "max_penetration_m": "{:.1e}"}  # fmt: skip


def arrays_read(dataset: Dataset) -> list[str]:
    """Names of the arrays that tasks write and this text needs."""
    keys = ["status", *(f"certificate/{key}" for key in _certificate_formats(dataset))]
    return [f"{sensor}/{key}" for sensor in dataset.sensors for key in keys]


def _estimates(dataset: Dataset) -> Iterator[str]:
    """Estimated errors of the mesh; nothing where the job did not ask for them."""
    asked = [(sensor, output) for sensor in dataset.sensors for output in dataset.job.kept_outputs(sensor)
             if output.is_estimate]  # fmt: skip
    if asked:
        yield ""
        yield "Estimated errors of the mesh (`load_dataset(..., max_error_um=5)` selects by the surface's):"
    for sensor, output in asked:
        valid = is_valid(dataset[f"{sensor}/status"])
        finding = estimated_error(sensor, output, dataset[f"{sensor}/{output.name}"][valid])
        yield f"- {sensor}, {output.name.partition('_')[0]}: {finding.found}"


def _others(dataset: Dataset) -> Iterator[str]:
    status = np.concatenate([dataset[f"{sensor}/status"].ravel() for sensor in dataset.sensors])
    codes, counts = np.unique(status[~is_valid(status)], return_counts=True)
    yield ""
    yield "Samples that are not valid, with their reason:" if len(codes) else "All samples are valid."
    for code, count in zip(codes, counts, strict=True):
        yield f"- {count} {in_words(code)}: {dataset.attributes['status'].get(str(code), 'not there')}"


def _making(dataset: Dataset) -> Iterator[str]:
    code, packages = dataset.attributes.get("code", {}), dataset.attributes.get("packages", {})
    commit = f", commit {code['commit'][:12]}" if code.get("commit") else ""
    changed = " with changes" if code.get("dirty") else ""
    yield f"simgen {code.get('version', '')}{commit}{changed}, on {dataset.attributes.get('device', 'cpu')};"
    yield ", ".join(f"{name} {version}" for name, version in packages.items()) + "."
    yield ""
    for sensor, known in dataset.attributes.get("sensors", {}).items():
        material, mesh = known["material"], known["simulation_mesh"][:12]
        source = _plain(material["source"] or "no source given")
        yield (f"- {sensor}: E = {material['youngs_modulus_pa']:g} Pa, nu = {material['poisson_ratio']:g}, friction "
               f"{material['friction']:g} ({source}); fluid: {known['fluid']}; mesh {mesh}")  # fmt: skip
    yield ""
    yield "Save this job as `job.yaml`; then `simgen run job.yaml` makes the dataset again."
    yield ""
    job = yaml.safe_dump(dataset.attributes["job"], sort_keys=False).rstrip()
    fence = max(["```", *(f"{run}`" for run in re.findall("`+", job))], key=len)  # longer than any in the job
    yield f"{fence}yaml"
    yield job
    yield fence


def _reading(dataset: Dataset) -> Iterator[str]:
    yield READING.format(path=f"{dataset.job.name}.zarr", sensor=dataset.sensors[0])
    yield ""
    yield "`simgen check` verifies it, `simgen report` shows it, `simgen export` writes it for other readers."


def _terms(dataset: Dataset) -> Iterator[str]:
    way = "straight line" if dataset.indenter_path.is_a_press else "path of straight legs and turns"
    yield from (f"- {limit.format(way=way)}" for limit in LIMITS)
    yield f"- Licence of this dataset: {_plain(dataset.job.dataset.license or 'its maker has stated none')}."
    models = sorted({choice.model for choice in dataset.job.sensors.values()})
    yield from (f"- {SHAPES[model]}" for model in models if model in SHAPES)
    yield f"- {METHOD}"


def _plain(text: str) -> str:
    """Escape a user's text so that no character counts as Markdown or HTML."""
    return re.sub(r"[^\w .,;:'=()/%+-]", lambda found: f"&#{ord(found[0])};", text)


def _row(cells: list) -> Iterator[str]:
    yield f"| {' | '.join(map(str, cells))} |"
