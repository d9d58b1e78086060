"""Write the tables of outputs in docs/dataset.md: ``python docs/generate/output_reference.py``. A test compares."""

from pathlib import Path

from tables_on_page import with_tables

from simgen.config.outputs import CERTIFICATE, OUTPUTS

PAGE = Path(__file__).parents[1] / "dataset.md"
KEPT = {"always": "always", "with fluid": "with a fluid", "with legs": "with legs, or on request",
        "on request": "on request"}  # fmt: skip


def outputs() -> str:
    """A Markdown table with a row for each output that is no certificate."""
    rows = ["| `<sensor>/...` | shape of a sample | type | unit | meaning | kept |", "|---|---|---|---|---|---|"]
    for output in OUTPUTS:
        if not output.is_certificate:
            shape = ", ".join(map(str, output.shape)) or "scalar"
            dtype = "int16 or float32" if output.name == "displacement" else output.dtype
            cells = f"`{output.name}`", shape, dtype, output.unit, output.about, KEPT[output.kept]
            rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def certificates() -> str:
    """A Markdown table with a row for each certificate."""
    rows = [f"| `<sensor>/{CERTIFICATE}...` | type | meaning | what it tells |", "|---|---|---|---|"]
    for output in OUTPUTS:
        if output.is_certificate:
            about, name = output.about.replace("|", "\\|"), output.name.removeprefix(CERTIFICATE)
            only = "" if output.kept == "always" else f" (only {KEPT[output.kept]})"
            rows.append(f"| `{name}` | {output.dtype} | {about}{only} | {output.note} |")
    return "\n".join(rows)


def page_with_tables(text: str) -> str:
    """The page's text with the tables in their places."""
    return with_tables(text, (outputs, certificates), Path(__file__).name)


if __name__ == "__main__":
    PAGE.write_text(page_with_tables(PAGE.read_text()))
