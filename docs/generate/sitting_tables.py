"""Write the tables of networks in docs/training.md and docs/translation.md: ``python docs/generate/sitting_tables.py``.

They come from the record of ``benchmarks/one_sitting.py``. A test compares.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from simgen.learning.data.registry import NETWORKS

DOCS = Path(__file__).parents[1]
RECORD = json.loads((DOCS / "benchmarks" / "sitting_h200.json").read_text(encoding="utf-8"))
MESH, SIGNALS = "biotac mesh -> digit mesh", "electrode signals -> digit mesh"
# Task, what the reader calls it, the paper's model, ours.
SUMMARY = (
    ("biotac mesh", "BioTac's mesh, there and back", "MVB", "RMB"),
    ("digit mesh", "DIGIT's mesh, there and back", "MVD", "RMD"),
    ("electrode signals -> biotac mesh", "electrodes to BioTac", "S2MPN", "S2RM"),
    (MESH, "BioTac to DIGIT", "M2MPN", "PT"),
    (SIGNALS, "electrodes to DIGIT", "S2MPN, M2MPN", "S2RM, PT"),
)
DEPTHS = "0.1", "0.5", "1.0", "1.5", "2.0"
LEFT_OUT = "sphere_7mm", "cube_14mm"
STEPS = {"points": "S2RM, PT, from electrodes", "true_mesh": "PT, from the true BioTac mesh",
         "ours": "S2RM, RM2RM, from electrodes", "paper": "the paper's networks, from electrodes"}  # fmt: skip

Group = Mapping[str, Any]


def summary() -> str:
    """Errors of all networks over all test samples."""
    rows = []
    for task, title, paper, ours in SUMMARY:
        models = RECORD["errors"]["ours"][task]
        name, best = _best_baseline(models)
        floor = _um(models["floor"]["all"]["rmse_um"]) if "floor" in models else ""
        stated = NETWORKS[paper.lower()].published if paper.lower() in NETWORKS else None
        published = f"{stated['rmse_um']:.2f} / {stated['region_rmse_um']:.2f}" if stated else ""
        theirs, own = RECORD["errors"]["paper"][task][paper], models[f"{ours} (ours)"]
        cells = f"{_both(best)}, {name}", f"{paper} {_both(theirs)}", f"{ours} **{_both(own)}**", floor, published
        rows.append((title, *cells))
    return _table(("", "best baseline", "the paper's network", "ours", "floor", "as published"), rows)


def contacts() -> str:
    """Errors and found contacts of the translators, by indenter and by depth, beside the floors."""
    head = "", *(f"{source}: {model}" for source in ("BioTac's mesh", "electrodes")
                 for model in ("floor", "the paper's", "ours"))  # fmt: skip
    groups = [("by_indenter", name, name) for name in RECORD["errors"]["ours"][MESH]["floor"]["by_indenter"]]
    groups += [("by_depth_mm", depth, f"at {depth} mm") for depth in DEPTHS]
    rows = []
    for kind, key, title in [("all", None, "all"), *groups]:
        cells = []
        for task, _, paper, ours in SUMMARY[3:]:
            for folder, model in (("ours", "floor"), ("paper", paper), ("ours", f"{ours} (ours)")):
                found = RECORD["errors"][folder][task][model][kind]
                cells.append(_found(found if key is None else found[key]))
        rows.append((title, *cells))
    return _table(head, rows)


def answers() -> str:
    """Figures of the single answers of PT, and of its draws."""
    models = [RECORD["errors"]["ours"][task][f"{ours} (ours)"] for task, _, _, ours in SUMMARY[3:]]
    single, drawn = [own["all"] for own in models], [own["answers"]["all"] for own in models]

    def row(title: str, figure: Callable[[Group], str], found: Sequence[Group] = drawn) -> Sequence[str]:
        return title, *(figure(own) for own in found)

    rows = [
        row("contacts found by the single answer", lambda own: _percent(own["near"]), single),
        row("the same, of those that the floor allows", lambda own: _percent(own["near_allowed"]), single),
        row("found by the likeliest hypothesis", lambda own: _percent(own["near"])),
        row("found by the best of 2, of 4", lambda own: f"{_percent(own['near_of_2'])}, {_percent(own['near_of_4'])}"),
        row("90 % sets that hold the true centroid", lambda own: _percent(own["covered"])),
        row("mean radius of a set", lambda own: f"{own['radius_mm']:.2f} mm"),
        row("energy score of the draws", lambda own: f"{_um(own['energy_um'])} um"),
        row("error of the single answer", lambda own: f"{_um(own['rmse_um'])} um"),
        row("overlap of true and predicted contact", lambda own: f"{own['contact_overlap']:.2f}"),
    ]
    return _table(("", "from the BioTac's mesh", "from electrodes"), rows)


def left_out() -> str:
    """Errors under an indenter that the networks have not seen, beside those of networks that have."""
    rows = []
    for indenter in LEFT_OUT:
        for task, title, _, ours in SUMMARY[2:]:
            models, known = (RECORD["errors"][name][task] for name in (f"without_{indenter}", "ours"))
            name, best = _best_baseline(models)
            own, seen = models[f"{ours} (ours)"]["all"], known[f"{ours} (ours)"]["by_indenter"][indenter]
            cells = _um(models["rest"]["all"]["rmse_um"]), f"{_found(best['all'])}, {name}", _found(own), _found(seen)
            rows.append((f"{indenter}: {title}", *cells))
    return _table(("RMSE, um; contacts found", "rest", "best baseline", "ours", "ours, trained with it"), rows)


def networks() -> str:
    """Epochs and seconds of each training."""
    trained = RECORD["networks"]["paper"] | RECORD["networks"]["ours"]
    rows = []
    for name, spec in NETWORKS.items():
        own = trained[name]
        seconds, speed = f"{own['seconds']:,.0f}", f"{own['samples_per_second']:,.0f}"
        rows.append((spec.label, f"{own['epochs']}, {own['best_epoch']}", seconds, speed))
    return _table(("network", "epochs, the best one", "seconds", "samples/s"), rows)


def edges() -> str:
    """Energy of the gradients of translated images over that of true images, of sums over images."""
    names = sorted(RECORD["edges"]["true_mesh"], key=lambda name: name != "all")  # all first
    rows = []
    for step, title in STEPS.items():
        own = RECORD["edges"][step]
        rows.append((title, *(f"{own[name]['ratio_of_sums']:.2f}" if name in own else "" for name in names)))
    return _table(("sum over images, ratio to true images", *names), rows)


def translated() -> str:
    """Contacts of the samples that `simgen translate` made images of."""
    rows = []
    for name, own in RECORD["translated"].items():
        found = _percent(own["near"]), _percent(own["any_near"]), f"{own['off_mm']:.2f} mm"
        rows.append((name, f"{own['samples']:,}", *found, _percent(own["in_order"]), f"{_um(own['rmse_um'])} um"))
    head = "indenter", "samples", "within 1 mm", "any of four hypotheses", "median", "in order", "RMSE"
    return _table(head, rows)


PAGES = {"training.md": (summary, contacts, answers, left_out, networks), "translation.md": (edges, translated)}


def page_with_tables(page: str) -> str:
    """The page's text with the tables in their places."""
    text = (DOCS / page).read_text(encoding="utf-8")
    for table in PAGES[page]:
        name = table.__name__
        first, last = f"<!-- {name}: printed by docs/generate/sitting_tables.py -->", f"<!-- /{name} -->"
        before, found, rest = text.partition(first)
        if not found:
            raise ValueError(f"{page}: no line {first}")
        text = f"{before}{first}\n\n{table()}\n\n{last}{rest.partition(last)[2]}"
    return text


def _best_baseline(models: Mapping[str, Group]) -> tuple[str, Group]:
    baselines = {name: own for name, own in models.items() if "(ours)" not in name and name not in ("rest", "floor")}
    return min(baselines.items(), key=lambda item: item[1]["all"]["rmse_um"])


def _found(means: Group) -> str:
    """RMSE in um, and the share of contacts within 1 mm where it is known."""
    near = means.get("near")
    return _um(means["rmse_um"]) + (f", {_percent(near)}" if near is not None else "")


def _both(model: Group) -> str:
    return f"{_um(model['all']['rmse_um'])} / {_um(model['all']['region_rmse_um'])}"


def _um(value: float) -> str:
    return f"{value:.2f}" if value < 10.0 else f"{value:.1f}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f} %"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    for page in PAGES:
        text = page_with_tables(page)
        (DOCS / page).write_text(text, encoding="utf-8")
