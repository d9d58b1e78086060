"""``croissant.json``: the dataset in the Croissant vocabulary (MLCommons, version 1.0; http://mlcommons.org/croissant).

Croissant has tables, not zarr arrays. Its readers load ``presses.csv`` as a record set. A second record set lists the
arrays with shape, type, unit and meaning.
"""

import hashlib
import json
from typing import Any

import numpy as np
import zarr

from simgen.dataset.card.presses import columns
from simgen.dataset.card.readme import METHOD, summary
from simgen.dataset.reader import Dataset

NAMESPACES = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "conformsTo": "dct:conformsTo",
}
TERMS = """citeAs column data dataType examples extract field equivalentProperty fileObject fileProperty fileSet format
    includes isLiveDataset jsonPath key md5 parentField path recordSet references regex repeated replace samplingRate
    separator source subField transform"""
TYPES = {"data": "@json", "examples": "@json", "dataType": "@vocab"}
CONTEXT = NAMESPACES | {
    term: {"@id": f"cr:{term}", "@type": TYPES[term]} if term in TYPES else f"cr:{term}" for term in TERMS.split()
}


def croissant(dataset: Dataset, table: str) -> str:
    """Make the text of the file; ``table`` is the text of ``presses.csv``."""
    license = dataset.job.dataset.license
    described = {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": dataset.job.name,
        "description": summary(dataset),
        **({"license": license} if license else {}),
        "citeAs": METHOD,
        "version": "1.0.0",
        "keywords": ["tactile sensing", "finite elements", "simulation", "robotics", *dataset.sensors],
        "isBasedOn": "https://github.com/wzaielamri/across_framework",
        "distribution": [
            _file("presses.csv", "text/csv", table.encode(), "a line for each press"),
            _file("zarr.json", "application/json", (dataset.path / "zarr.json").read_bytes(),
                  "root of the zarr v3 folder that holds all arrays"),
        ],
        "recordSet": [_presses(dataset), _arrays(dataset)],
    }  # fmt: skip
    return json.dumps(described, indent=1) + "\n"


def _file(name: str, kind: str, data: bytes, about: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "description": about,
        "contentUrl": name,
        "contentSize": f"{len(data)} B",
        "encodingFormat": kind,
        "sha256": hashlib.sha256(data).hexdigest(),
    }


def _presses(dataset: Dataset) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": "presses",
        "name": "presses",
        "description": "one record for each press",
        "key": {"@id": "presses/press"},
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"presses/{column}",
                "name": column,
                "description": about,
                "dataType": kind,
                "source": {"fileObject": {"@id": "presses.csv"}, "extract": {"column": column}},
            }
            for column, (kind, about) in columns(dataset).items()
        ],
    }


def _arrays(dataset: Dataset) -> dict[str, Any]:
    """List all arrays of the zarr folder, as records within this file."""
    fields = ("path", "shape", "dtype", "unit", "about")
    records = []
    members = dataset.root.members(max_depth=None)
    for path, array in sorted((path, member) for path, member in members if isinstance(member, zarr.Array)):
        about = array.attrs
        shape, dtype = " x ".join(map(str, array.shape)), str(np.dtype(array.dtype))
        record = (path, shape, dtype, about.get("unit", ""), about.get("about", ""))
        records.append({f"arrays/{key}": value for key, value in zip(fields, record, strict=True)})
    return {
        "@type": "cr:RecordSet",
        "@id": "arrays",
        "name": "arrays",
        "description": "the arrays of the zarr folder",
        "field": [
            {"@type": "cr:Field", "@id": f"arrays/{key}", "name": key, "dataType": "sc:Text"} for key in fields
        ],
        "data": records,
    }

