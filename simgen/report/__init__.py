"""Report: one self-contained HTML page about a dataset.

A section is a function of the dataset that yields lines of HTML, or none to be left out. Sections read displacements of
a bounded number of presses, because a dataset can have a terabyte of them.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from simgen.dataset.reader import Dataset
from simgen.plotting.html import contents, heading, write_page
from simgen.report.coverage import coverage_section
from simgen.report.curves import force_section, pressure_section
from simgen.report.effort import effort_section
from simgen.report.estimated_errors import estimated_errors_section
from simgen.report.meshes import meshes_section
from simgen.report.motion import motion_section
from simgen.report.outcomes import outcomes_section
from simgen.report.overview import audit_section, head, job_section
from simgen.report.patches import patches_section
from simgen.report.path import path_section
from simgen.report.solid_view import solid_view_section

Section = Callable[[Dataset], Iterable[str]]
SECTIONS: dict[str, Section] = {
    "Audit": audit_section,
    "Contacts and coverage": coverage_section,
    "Outcomes of presses": outcomes_section,
    "Animated press": motion_section,
    "3D view": solid_view_section,
    "Contact patches": patches_section,
    "Deformed meshes": meshes_section,
    "Force against depth": force_section,
    "Cavity pressure against depth": pressure_section,
    "Forces along the path": path_section,
    "Solver effort and certificates": effort_section,
    "Estimated errors of the mesh": estimated_errors_section,
    "Job": job_section,
}


def write_report(dataset: Dataset, output: Path, more: Mapping[str, Section] | None = None) -> None:
    """Write the page, with ``more`` sections before the last one. A dataset may be unfinished."""
    *most, last = SECTIONS.items()
    sections = {title: list(section(dataset)) for title, section in (*most, *(more or {}).items(), last)}
    sections = {title: lines for title, lines in sections.items() if lines}
    lines = [*head(dataset), contents(sections)]
    for title, own in sections.items():
        lines += [heading(title), *own]
    write_page(dataset.job.name, lines, output)
