"""Write the tables of networks in docs/training.md and docs/translation.md: ``python docs/generate/sitting_tables.py``.

They come from the record of ``benchmarks/one_sitting.py``, from later ones of RMB, S2RM and PT, and from that of
``benchmarks/signal_limit.py``. A test compares.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tables_on_page import with_tables

from simgen.learning.data.registry import NETWORKS

DOCS = Path(__file__).parents[1]
SITTING, LENGTHS, MEMBERS, SIGNALS = (
    json.loads((DOCS / "benchmarks" / name).read_text(encoding="utf-8"))
    for name in ("sitting_h200.json", "training_length_h200.json", "two_members_h200.json", "signal_limit_cpu.json")
)
# Task, what the reader calls it, the paper's model, ours.
MESHES = (
    ("biotac mesh", "BioTac's mesh, there and back", "MVB", "RMB"),
    ("digit mesh", "DIGIT's mesh, there and back", "MVD", "RMD"),
)
BIOTAC = (("electrode signals -> biotac mesh", "electrodes to BioTac", "S2MPN", "S2RM"),)
TRANSLATORS = (
    ("biotac mesh -> digit mesh", "BioTac to DIGIT", "M2MPN", "PT"),
    ("electrode signals -> digit mesh", "electrodes to DIGIT", "S2MPN, M2MPN", "S2RM, PT"),
)
BY_LATENTS = (
    ("biotac mesh -> digit mesh", "BioTac to DIGIT, by latents", "M2MPN", "RM2RM"),
    ("electrode signals -> digit mesh", "electrodes to DIGIT, by latents", "S2MPN, M2MPN", "S2RM, RM2RM"),
)
DEPTHS = "0.1", "0.5", "1.0", "1.5", "2.0"
LEFT_OUT = "sphere_7mm", "cube_14mm"
# Versions of PT: the record, the folder of its networks, and whether its images were measured.
VERSIONS = {
    "epoch 15 of 30 kept, c540a67": (SITTING, "ours", True),
    "epoch 30 kept, cb0a1a2": (LENGTHS, "ours", True),
    "10 epochs, cb0a1a2": (LENGTHS, "ten_epochs", False),
    "**two members**, 39dcf67": (MEMBERS, "ours", True),
    "the same, 7,740 places": (MEMBERS, "one_indenter_each", False),
}
STEPS = {"points": "S2RM, PT, from electrodes", "true_mesh": "PT, from the true BioTac mesh",
         "ours": "S2RM, RM2RM, from electrodes", "paper": "the paper's networks, from electrodes"}  # fmt: skip
ABSENT = ""

Group = Mapping[str, Any]


def summary() -> str:
    """Errors of all networks over all test samples."""
    rows = []
    for task, title, paper, ours in (*MESHES, *BIOTAC, *TRANSLATORS, *BY_LATENTS):
        models = SITTING["errors"]["ours"][task]
        name, best = _best_baseline(models)
        floor = _um(models["floor"]["all"]["rmse_um"]) if "floor" in models else ABSENT
        stated = NETWORKS[paper.lower()].published if paper.lower() in NETWORKS else None
        published = f"{stated['rmse_um']:.2f} / {stated['region_rmse_um']:.2f}" if stated else ABSENT
        theirs, own = SITTING["errors"]["paper"][task][paper], models[f"{ours} (ours)"]
        cells = f"{_both(best)}, {name}", f"{paper} {_both(theirs)}", f"{ours} **{_both(own)}**", floor, published
        rows.append((title, *cells))
    return _table(("", "best baseline", "the paper's network", "ours", "floor", "as published"), rows)


def contacts() -> str:
    """Errors and found contacts of the translators, by indenter and by depth, beside the floors."""
    head = "", *(f"{source}: {model}" for source in ("BioTac's mesh", "electrodes")
                 for model in ("floor", "the paper's", "ours, one member", "ours, two members"))  # fmt: skip
    sitting = SITTING["errors"]
    floor = sitting["ours"][TRANSLATORS[0][0]]["floor"]
    groups = [("by_indenter", name, name) for name in floor["by_indenter"]]
    groups += [("by_depth_mm", depth, f"at {depth} mm") for depth in DEPTHS]
    rows = []
    for kind, key, title in [("all", None, "all"), *groups]:
        cells = []
        for task, _, paper, ours in TRANSLATORS:
            own = f"{ours} (ours)"
            for errors, model in ((sitting["ours"], "floor"), (sitting["paper"], paper), (sitting["ours"], own),
                                  (MEMBERS["errors"]["ours"], own)):  # fmt: skip
                found = errors[task][model][kind]
                cells.append(_found(found if key is None else found[key]))
        rows.append((title, *cells))
    return _table(head, rows)


def from_mesh() -> str:
    """Figures of each of `VERSIONS` of PT from the BioTac's mesh, beside our targets."""
    return _answers(TRANSLATORS[0], "true_mesh", "at most 16 um")


def from_electrodes() -> str:
    """Figures of each of `VERSIONS` of PT from electrodes, beside our targets."""
    return _answers(TRANSLATORS[1], "points", "at most 22 um")


def _answers(translator: Sequence[str], step: str, error: str) -> str:
    """Figures of a chain: one of `TRANSLATORS`, the step of its images, and the target of its RMSE."""
    task, _, _, ours = translator
    found = VERSIONS.values()
    models = [record["errors"][folder][task][f"{ours} (ours)"] for record, folder, _ in found]
    images = [_edge(record["edges"][step]["all"]) if drawn else ABSENT for record, _, drawn in found]
    edge = "edges of images, energy over that of true ones", "0.9 to 1.1", *images
    return _table(("", "target", *VERSIONS), [*_answer_rows(models, error), edge])


def _answer_rows(models: Sequence[Group], error: str) -> Sequence[Sequence[str]]:
    """Rows of figures, each with its target and a column for each model. ``error`` is the target of the RMSE."""
    single, drawn = [own["all"] for own in models], [own["answers"]["all"] for own in models]

    def row(
        title: str, figure: Callable[[Group], str], found: Sequence[Group] = drawn, target: str = ABSENT
    ) -> Sequence[str]:
        return title, target, *(figure(own) for own in found)

    def overlap(own: Group) -> str:
        return f"{own['contact_overlap']:.2f}"

    return [
        row("error of the single answer", lambda own: f"{_um(own['rmse_um'])} um", single, error),
        row("contacts that the single answer finds", lambda own: _percent(own["near"]), single),
        row("the same, of those that the floor allows", lambda own: _percent(own["near_allowed"]), single, "95 %"),
        row("found by the likeliest hypothesis", lambda own: _percent(own["near"])),
        row("found by the best of 2, of 4", lambda own: f"{_percent(own['near_of_2'])}, {_percent(own['near_of_4'])}"),
        row("90 % sets that hold the true centroid", lambda own: _percent(own["covered"]), target="88 to 92 %"),
        row("mean radius of a set", lambda own: f"{own['radius_mm']:.2f} mm"),
        row("energy score of the draws", lambda own: f"{_um(own['energy_um'])} um"),
        row("overlap of true and predicted contact", overlap, target="at least 0.8"),
    ]


def left_out() -> str:
    """Errors under an indenter that the networks have not seen, beside those of networks that have."""
    rows = []
    for indenter in LEFT_OUT:
        for task, title, _, ours in (*BIOTAC, *TRANSLATORS):
            models, known = (SITTING["errors"][name][task] for name in (f"without_{indenter}", "ours"))
            name, best = _best_baseline(models)
            own, seen = models[f"{ours} (ours)"]["all"], known[f"{ours} (ours)"]["by_indenter"][indenter]
            cells = _um(models["rest"]["all"]["rmse_um"]), f"{_found(best['all'])}, {name}", _found(own), _found(seen)
            rows.append((f"{indenter}: {title}", *cells))
    return _table(("RMSE, um; contacts found", "rest", "best baseline", "ours", "ours, trained with it"), rows)


def networks() -> str:
    """Epochs and seconds of each training."""
    trained = SITTING["networks"]["paper"] | SITTING["networks"]["ours"]
    rows = []
    for name, spec in NETWORKS.items():
        own = trained[name]
        seconds, speed = f"{own['seconds']:,.0f}", f"{own['samples_per_second']:,.0f}"
        rows.append((spec.label, f"{own['epochs']}, {own['best_epoch']}", seconds, speed))
    return _table(("network", "epochs, the best one", "seconds", "samples/s"), rows)


def edges() -> str:
    """Energy of the gradients of translated images over that of true images, of sums over images."""
    steps = SITTING["edges"] | MEMBERS["edges"]  # PT's images of the later record
    names = sorted(steps["points"], key=lambda name: name != "all")  # all first
    rows = [(title, *(_edge(steps[step][name]) for name in names)) for step, title in STEPS.items()]
    return _table(("sum over images, ratio to true images", *names), rows)


def translated() -> str:
    """Contacts of the samples that `simgen translate` made images of."""
    rows = []
    for name, own in MEMBERS["translated"].items():
        found = _percent(own["near"]), _percent(own["any_near"]), f"{own['off_mm']:.2f} mm"
        rows.append((name, f"{own['samples']:,}", *found, _percent(own["in_order"]), f"{_um(own['rmse_um'])} um"))
    head = "indenter", "samples", "within 1 mm", "any of four hypotheses", "median", "in order", "RMSE"
    return _table(head, rows)


def signal_limits() -> str:
    """Limits of signals, beside what PT reaches from them for the same samples."""
    rows, below = [], 0.0
    for row in SIGNALS["rows"]:
        if "depth_mm" in row:
            title = f"at {row['depth_mm']} mm"
        elif "indenter" in row:
            title = row["indenter"]
        else:
            title = f"mesh changes by {100.0 * below:g} to {100.0 * row['mesh_change_below']:g} %"
            below = row["mesh_change_below"]
        near = _percent(row["near"]), _percent(row["network_near"])
        error = f"{_um(row['digit_um'])} um", f"{_um(row['network_um'])} um"
        rows.append((title, str(row["samples"]), *near, *error, f"{row['contact_overlap']:.2f}"))
    head = "samples", "within 1 mm: signals", "PT", "RMSE: signals", "PT", "overlap, at most"
    return _table(("", *head), rows)


PAGES = {
    "training.md": (summary, contacts, from_mesh, from_electrodes, left_out, networks),
    "translation.md": (edges, translated, signal_limits),
}


def page_with_tables(page: str) -> str:
    """The page's text with the tables in their places."""
    return with_tables((DOCS / page).read_text(encoding="utf-8"), PAGES[page], Path(__file__).name)


def _best_baseline(models: Mapping[str, Group]) -> tuple[str, Group]:
    return next((name, own) for name, own in models.items() if own["best_baseline"])


def _found(means: Group) -> str:
    """RMSE in um, and the share of contacts within 1 mm where it is known."""
    near = means.get("near")
    return _um(means["rmse_um"]) + (f", {_percent(near)}" if near is not None else "")


def _both(model: Group) -> str:
    return f"{_um(model['all']['rmse_um'])} / {_um(model['all']['region_rmse_um'])}"


def _um(value: float) -> str:
    return f"{value:.2f}" if value < 10.0 else f"{value:.1f}"


def _edge(images: Group) -> str:
    return f"{images['ratio_of_sums']:.3f}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    for page in PAGES:
        text = page_with_tables(page)
        (DOCS / page).write_text(text, encoding="utf-8")
