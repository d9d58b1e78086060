"""The references of job files: they are current, complete and true, and their examples are jobs."""

import re
from collections.abc import Callable
from dataclasses import dataclass

import job_reference
import pytest
import training_job_reference as training_reference
from pages import DOCS, code
from reference_page import ReferencePage, inner_sections

from simgen.config.job import load_job
from simgen.config.job_schema import Job
from simgen.config.strict_section import StrictSection
from simgen.learning.data.schema import TrainingJob, load_training_job


@dataclass(frozen=True)
class Case:
    """A page, where it lies, what it is about, and who reads such a file."""

    printed: ReferencePage
    file: str
    job: type[StrictSection]
    load: Callable


CASES = [
    Case(job_reference.PAGE, "job.md", Job, load_job),
    Case(training_reference.PAGE, "training_job.md", TrainingJob, load_training_job),
]
each_page = pytest.mark.parametrize("case", CASES, ids=lambda case: case.file)


def sections(section: type[StrictSection]) -> set[type[StrictSection]]:
    fields = section.model_fields.values()
    inner = {each for field in fields for each in inner_sections(field.annotation)}
    return {section}.union(*map(sections, inner))


@each_page
def test_the_page_is_what_the_schema_says(case):
    """If not, run `python docs/generate/job_reference.py > docs/job.md`, and the same for the training job."""
    assert (DOCS / case.file).read_text() == case.printed.markdown()


@each_page
def test_every_key_of_a_job_is_on_its_page(case):
    shown = case.printed.sections
    assert set(shown.values()) == sections(case.job)
    parts = re.split(r"^## ", (DOCS / case.file).read_text(), flags=re.MULTILINE)[1:]
    for section, part in zip(shown.values(), parts, strict=True):
        assert re.findall(r"^\| `(\w+)`", part, re.MULTILINE) == list(section.model_fields)


@each_page
def test_headings_are_where_the_sections_are(case):
    for heading, section in list(case.printed.sections.items())[1:]:
        for path in heading.split(", "):
            found = case.job
            for key in (key for key in path.split(".") if key != "NAME"):
                (found,) = inner_sections(found.model_fields[key].annotation)
            assert found is section, path


@each_page
def test_every_key_has_a_meaning(case):
    for section in case.printed.sections.values():
        for key, field in section.model_fields.items():
            assert re.match(r"[A-Za-z]", field.description or ""), key


@each_page
def test_the_examples_of_the_page_load(case, tmp_path):
    first, *others = code(DOCS / case.file, "yaml")
    assert len(others) == len(case.printed.sections) - 1
    (tmp_path / "job.yaml").write_text(first)
    whole = case.load(tmp_path / "job.yaml")
    for example in others:
        key, _, value = example.partition(":")
        assert case.load(tmp_path / "job.yaml", [f"{key}={value}"]).resolved()[key] != whole.resolved()[key]
