"""Provenance of a dataset: version, commit, source hash and packages, and the difference of two provenances."""

import hashlib
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import simgen
from simgen.config.resources import PACKAGE

PACKAGES = ("warp-lang", "numpy", "scipy", "pymetis", "zarr", "zarrs", "numcodecs", "trimesh")


def code_version() -> dict[str, str | bool | None]:
    """Version and sha256 of the sources; in a checkout also the commit, and ``dirty`` if tracked files differ."""
    commit = _git("rev-parse", "HEAD") if (PACKAGE.parent / ".git").exists() else None
    dirty = bool(_git("status", "--porcelain", "--untracked-files=no")) if commit else None
    return {"version": simgen.__version__, "source": source_hash(), "commit": commit, "dirty": dirty}


def file_hash(path: Path) -> str:
    """sha256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def source_hash(package: Path = PACKAGE) -> str:
    """sha256 of names and contents of a package's .py files; the same in a checkout and in a wheel."""
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        content = hashlib.sha256(file.read_bytes()).hexdigest()
        digest.update(f"{content}  {file.relative_to(package).as_posix()}\n".encode())
    return digest.hexdigest()


def package_versions() -> dict[str, str]:
    return {name: metadata.version(name) for name in PACKAGES}


def difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Compare two nested mappings: a line ``key.sub: old -> new`` for each leaf that differs."""
    flat_old, flat_new = _flatten(old), _flatten(new)
    keys = [*flat_old, *(key for key in flat_new if key not in flat_old)]
    return [
        f"{key}: {flat_old.get(key, '(absent)')} -> {flat_new.get(key, '(absent)')}"
        for key in keys
        if flat_old.get(key, ...) != flat_new.get(key, ...)
    ]


def _git(*arguments: str) -> str | None:
    command = ["git", "-C", str(PACKAGE.parent), *arguments]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def _flatten(data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat = {}
    for key, value in data.items():
        if isinstance(value, Mapping):
            flat |= _flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat
