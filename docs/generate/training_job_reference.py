"""Generator of docs/training_job.md: ``python docs/generate/training_job_reference.py > docs/training_job.md``.

A test compares the two.
"""

from reference_page import ReferencePage

from simgen.config.strict_section import StrictSection
from simgen.learning.data.schema import (
    MeshTranslationSettings,
    MeshVAESettings,
    PointTranslationSettings,
    ProjectionSettings,
    RecordingFiles,
    ReducedModelSettings,
    SignalProjectionSettings,
    Signals,
    SignalVAESettings,
    TrainingJob,
    TranslationSettings,
)
from simgen.sensing.electrodes.model import ElectrodeSettings

# Headings and sections in the order of the page.
SECTIONS: dict[str, type[StrictSection]] = {
    "The job": TrainingJob,
    "signals": Signals,
    "signals.synthetic": ElectrodeSettings,
    "signals.recordings": RecordingFiles,
    "signal_vae": SignalVAESettings,
    "mesh_vae": MeshVAESettings,
    "signal_projection": SignalProjectionSettings,
    "mesh_projection": ProjectionSettings,
    "reduced_model": ReducedModelSettings,
    "signal_translation": TranslationSettings,
    "mesh_translation": MeshTranslationSettings,
    "point_translation": PointTranslationSettings,
}

EXAMPLES: dict[str, str] = {
    "The job": """\
name: my_networks
seed: 7
dataset: my_touch.zarr
source: biotac
target: digit
networks: [rmb, rmd, s2rm, rm2rm]
""",
    "signals": """\
signals:
  synthetic: {noise_v: 0.005, bits: 10}
""",
    "signals.synthetic": """\
signals:
  synthetic: {resistivity_ohm_m: 5, series_ohm: 500, supply_v: 5}
""",
    "signals.recordings": """\
signals:
  recordings: {files: [./monday.hdf5, ./tuesday.hdf5], least_force_n: 0.2, remove_drift: true}
""",
    "signal_vae": """\
signal_vae: {widths: [128, 32], latent: 4}
""",
    "mesh_vae": """\
mesh_vae: {epochs: 100, beta: 0.001}
""",
    "signal_projection": """\
signal_projection: {widths: [256, 256], dropout: [0.2, 0.2]}
""",
    "mesh_projection": """\
mesh_projection: {schedule: cosine, patience: 1000}   # to the last epoch
""",
    "reduced_model": """\
reduced_model: {latent: 63, width: 32}   # less of PCA, more of the convolutions
""",
    "signal_translation": """\
signal_translation: {width: 256, noise: 0.01}
""",
    "mesh_translation": """\
mesh_translation: {noise: 0}   # if its inputs are latents of RMB, not predictions of S2RM
""",
    "point_translation": """\
point_translation: {epochs: 60, width: 48}
""",
}

HEAD = """\
# Training jobs

*Printed by `python docs/generate/training_job_reference.py`; a test compares.*

A training job is one YAML file. Together with the dataset and the code it decides the networks. It is read as strictly
as a [job file](job.md): an error is one line with the file, the key, the value and what is allowed, and exit code 2.
[Training](training.md) describes the networks.

- **Train**: `simgen train FILE`. `training` and `training_smoke` are bundled: `simgen train training` works.
- **Replace keys**: `simgen train training mesh_vae.epochs=100 "networks=[svb, mvb, s2mpn]"`
- **Continue**: a folder belongs to one job. With other values choose another `--output`. Only `networks`, `output` and
  the place of `dataset` (not its content) may change.

Each example below replaces the keys of the same name in the first one. A default of `-` means none.
"""

PAGE = ReferencePage(HEAD, SECTIONS, EXAMPLES)


if __name__ == "__main__":
    print(PAGE.markdown(), end="")
