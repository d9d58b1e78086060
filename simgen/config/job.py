"""Reading a job: YAML in, a frozen and checked `simgen.config.job_schema.Job` out.

Everything that decides the bytes of a dataset is in the job, and nothing else is: no host, date or number
of workers. A key that is unknown, or a value that is out of range, is an `InputError` of one line: the file, the key
path, the value, what is allowed.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from simgen.config.job_schema import Job
from simgen.config.resources import bundled_jobs
from simgen.config.strict_section import find_file, load_section, section_from_dict


def load_job(path: str | Path, overrides: Iterable[str] = ()) -> Job:
    """Read a job file; `overrides` are ``key.sub=value`` strings, their values read as YAML.

    ``smoke``, ``smoke.yaml`` and ``jobs/smoke.yaml`` that do not exist are looked up among the bundled jobs.
    Raises `InputError` with one line that names the file, the key, the value and what is allowed.
    """
    file = find_job(path)
    job = load_section(Job, file, str(path), overrides)
    job._folder = file.parent.resolve()
    return job


def find_job(path: str | Path) -> Path:
    """The job file itself, or for ``NAME`` and ``jobs/NAME`` the bundled one of that name.

    Raises `InputError` if there is neither.
    """
    return find_file(path, bundled_jobs(), "job")


def job_from_dict(
    data: Mapping[str, Any], source: str = "job", sources: Mapping[str, str] | None = None, *, folder: Path = Path()
) -> Job:
    """Check plain data (as from YAML) and make a `Job` of it. `sources` tells which key came from where.

    Raises `InputError`.
    """
    job = section_from_dict(Job, data, source, sources)
    job._folder = folder
    return job


def job_from_resolved(resolved: Mapping[str, Any], source: str = "job", *, folder: Path = Path()) -> Job:
    """Make the `Job` that resolved to this when a dataset was written.

    ``least_thickness_left`` is absent where it was 0, and in jobs from before there was this rule. Raises `InputError`.
    """
    trajectories = resolved.get("trajectories")
    if isinstance(trajectories, Mapping):
        resolved = {**resolved, "trajectories": {"least_thickness_left": 0.0, **trajectories}}
    return job_from_dict(resolved, source, folder=folder)
