"""The reference of job files: it is current, complete and true, and its examples are jobs."""

import re
from dataclasses import astuple

from annotated_types import Ge, Gt, Le, Lt
from pages import DOCS, code

from simgen import job_reference
from simgen.job import load_job
from simgen.job_schema import Section


def sections(section: type[Section]) -> set[type[Section]]:
    fields = section.model_fields.values()
    inner = {each for field in fields for each in job_reference._sections(field.annotation)}
    return {section}.union(*map(sections, inner))


def test_the_page_of_job_files_is_what_the_schema_says():
    """Else: python -m simgen.job_reference > docs/job.md"""
    assert (DOCS / "job.md").read_text() == job_reference.job_reference()


def test_every_key_of_a_job_is_on_its_page():
    shown = job_reference.SECTIONS
    assert set(shown.values()) == sections(job_reference.Job)
    parts = re.split(r"^## ", (DOCS / "job.md").read_text(), flags=re.MULTILINE)[1:]
    for section, part in zip(shown.values(), parts, strict=True):
        assert re.findall(r"^\| `(\w+)`", part, re.MULTILINE) == list(section.model_fields)


def test_nothing_is_said_of_keys_that_are_not_there():
    for section, said in job_reference.MEANINGS.items():
        assert set(said) <= set(section.model_fields)
    assert set(job_reference.solver_meanings()) == set(job_reference.Solver.model_fields) - {"element"}
    assert set(job_reference.contact_meanings()) == set(job_reference.Trajectories.model_fields) - {"count"}


def test_what_is_allowed_names_the_bounds():
    checked = 0
    for section in job_reference.SECTIONS.values():
        for key, field in section.model_fields.items():
            named = {float(text) for text in re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", field.description or "")}
            for bound in field.metadata:
                if isinstance(bound, Ge | Gt | Le | Lt):
                    (value,) = astuple(bound)
                    assert {value, value - 1} & named, (key, bound)
                    checked += 1
    assert checked > 30


def test_the_examples_of_the_page_of_job_files_load(tmp_path):
    first, *others = code(DOCS / "job.md", "yaml")
    assert len(others) == len(job_reference.SECTIONS) - 1
    (tmp_path / "job.yaml").write_text(first)
    whole = load_job(tmp_path / "job.yaml")
    for example in others:
        key, _, value = example.partition(":")
        assert load_job(tmp_path / "job.yaml", [f"{key}={value}"]).resolved()[key] != whole.resolved()[key]
