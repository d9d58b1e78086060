"""Generator of the table in docs/dataset.md: ``python docs/generate/output_reference.py``. A test compares."""

from pathlib import Path

from simgen.config.outputs import OUTPUTS, SURFACE_VERTEX, VERTEX

PAGE = Path(__file__).parents[1] / "dataset.md"
BEGIN, END = "<!-- printed by docs/generate/output_reference.py -->\n", "<!-- end of what is printed -->\n"
KEPT = {"always": "always", "with fluid": "with a fluid", "with legs": "with legs, or on request",
        "on request": "on request"}  # fmt: skip
AXES = {VERTEX: "vertex", SURFACE_VERTEX: "surface vertex"}


def table() -> str:
    """A Markdown table with one row for each output."""
    rows = ["| `<sensor>/...` | shape of a sample | type | unit | meaning | kept |", "|---|---|---|---|---|---|"]
    for output in OUTPUTS:
        shape = ", ".join(AXES.get(axis, str(axis)) for axis in output.shape) or "scalar"
        dtype = "int16 or float32" if output.name == "displacement" else output.dtype
        about = output.about.replace("|", "\\|")
        rows.append(f"| `{output.name}` | {shape} | {dtype} | {output.unit} | {about} | {KEPT[output.kept]} |")
    return "\n".join(rows) + "\n"


def page_with_table(text: str) -> str:
    """Replace the table in the page's text."""
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n{table()}\n{END}{rest.partition(END)[2]}"


if __name__ == "__main__":
    PAGE.write_text(page_with_table(PAGE.read_text()))
