"""Functions that read a job: YAML in, a frozen and checked `simgen.config.job_schema.Job` out.

A job holds all settings that decide the bytes of a dataset. It holds no host, date or number of workers.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from simgen.config.job_schema import Job
from simgen.config.resources import bundled_jobs
from simgen.config.strict_section import find_file, load_section, section_from_dict


def load_job(path: str | Path, overrides: Iterable[str] = ()) -> Job:
    """Read a job file. `overrides` are ``key.sub=value`` texts with YAML values.

    If the file does not exist, ``smoke``, ``smoke.yaml`` and ``jobs/smoke.yaml`` name a bundled job.
    Raises `InputError` with one line that names the file, the key, the value and what is allowed.
    """
    file = find_job(path)
    job = load_section(Job, file, str(path), overrides)
    job._folder = file.parent.resolve()
    return job


def find_job(path: str | Path) -> Path:
    """Find a job file: at ``path``, or among the bundled jobs for ``NAME`` and ``jobs/NAME``.

    Raises `InputError` if neither exists.
    """
    return find_file(path, bundled_jobs(), "job")


def job_from_dict(
    data: Mapping[str, Any], source: str = "job", sources: Mapping[str, str] | None = None, *, folder: Path = Path()
) -> Job:
    """Make a `Job` from plain data (as from YAML).

    `sources` maps key paths to the file or override that set them; error lines name it. Relative
    paths start at `folder`. Raises `InputError`.
    """
    job = section_from_dict(Job, data, source, sources)
    job._folder = folder
    return job


def job_from_resolved(resolved: Mapping[str, Any], source: str = "job", *, folder: Path = Path()) -> Job:
    """Make the `Job` of a dataset from its resolved form.

    A missing ``least_thickness_left`` means 0: jobs from before this rule have no such key. Raises `InputError`.
    """
    trajectories = resolved.get("trajectories")
    if isinstance(trajectories, Mapping):
        resolved = {**resolved, "trajectories": {"least_thickness_left": 0.0, **trajectories}}
    return job_from_dict(resolved, source, folder=folder)
