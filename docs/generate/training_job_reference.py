"""The reference of training jobs: ``python docs/generate/training_job_reference.py > docs/training_job.md``.

A test compares the page with what this prints.
"""

from reference_page import ReferencePage

from simgen.config.strict_section import StrictSection
from simgen.learning.training.schema import (
    Fit,
    MeshTranslationSettings,
    MeshVAESettings,
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

# Headings with their sections, in the order of the page.
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
}

# What a key does; those of `Fit` are said once for all networks.
MEANINGS: dict[type[StrictSection], dict[str, str]] = {
    TrainingJob: {
        "name": "names the folder of the networks, `<name>.networks`",
        "seed": "of weights, order of samples, dropout, drawn latents, and of the splits of recordings",
        "dataset": "what `simgen run` wrote; a path starts at the current folder",
        "source": "the sensor that is translated from; signals are those of its electrodes",
        "target": "the sensor that is translated to",
        "networks": "what is trained now, each after those that it needs; others may be added later",
        "signals": "where the electrodes' signals come from",
        "mesh_vae": "how MVB and MVD are made and trained",
        "signal_vae": "SVB",
        "signal_projection": "S2MPN",
        "mesh_projection": "M2MPN",
        "reduced_model": "RMB and RMD",
        "signal_translation": "S2RM",
        "mesh_translation": "RM2RM",
        "output": "where the networks go; `--output` replaces it, and it is no part of the job's hash",
    },
    Signals: {
        "synthetic": "of the dataset's samples, by the [electrode model](electrodes.md)",
        "recordings": "recorded ones, which replace the synthetic ones",
    },
    ElectrodeSettings: {
        "resistivity_ohm_m": "the film's resistance is proportional to it",
        "electrode_radius_mm": "where the current enters the film",
        "outer_radius_mm": "the film's resistance grows with the logarithm of this radius over the electrode's",
        "least_film_um": "thickness of a gap that is closed",
        "series_ohm": "what does not change with the gap",
        "reference_ohm": "where the reading is taken",
        "supply_v": "readings are cut to 0 to this",
        "noise_v": "normal, its own for each press, depth and electrode",
        "drift_v_per_sample": "a straight line for each electrode, over the samples in their order",
        "bits": "readings are rounded to steps of the supply",
        "seed": "the same seed, the same noise and drift",
    },
    RecordingFiles: {
        "files": "in the [published layout](electrodes.md#recordings); paths start at the folder of the job file",
        "least_force_n": "samples of less force are no contact, and left out",
        "remove_drift": "takes a straight line off each electrode, fitted where nothing touches",
    },
    Fit: {
        "epochs": "so many at most",
        "batch": "samples of a step; all of them where there are fewer",
        "learning_rate": "of the first epoch",
        "schedule": "exponential: times `decay` after each epoch. Cosine: half a cosine, to 0 after the last epoch",
        "decay": "of the exponential schedule",
        "weight_decay": "of AdamW; without it, it is Adam",
        "patience": "so many epochs without a new least validation loss end the training",
    },
    SignalVAESettings: {
        "widths": "of the encoder's hidden layers; the decoder has them backwards",
        "latent": "numbers of a latent",
        "beta": "weight of the KL divergence, which is a mean over latents",
    },
    MeshVAESettings: {
        "latent": "numbers of a latent; the linear layers beside it are four times as wide",
        "beta": "weight of the KL divergence, which is a mean over latents",
    },
    ProjectionSettings: {
        "widths": "of the hidden layers; a linear layer into the latent space follows",
        "dropout": "after each of them",
    },
    ReducedModelSettings: {
        "latent": "principal components",
        "width": "features of a vertex between the convolutions",
    },
    TranslationSettings: {
        "width": "of the residual blocks",
        "blocks": "how many there are",
        "noise": "standard deviation of what training adds to each input, over the sample's own size",
        "power": "errors count over that power of how far a sample is from rest: 0 as they are, 1 relative",
    },
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
mesh_translation: {noise: 0}   # if it will be given latents of RMB itself, and not those of S2RM
""",
}

HEAD = """\
# Training jobs

*Printed by `python docs/generate/training_job_reference.py`; a test compares.*

All that decides the networks, beside the dataset and the code. It is read as strictly as [job files](job.md) are: what
is wrong is one line with the file, the key, the value and what is allowed, and exit code 2. What is trained, and why:
[training](training.md).

- **Where.** `simgen train FILE`. `training` and `training_smoke` are bundled: `simgen train training` will do.
- **Replacing keys.** `simgen train training mesh_vae.epochs=100 "networks=[svb, mvb, s2mpn]"`
- **Going on.** A folder belongs to one job: with other values choose another `--output`. Only `networks`, `dataset`
  (where it lies, not what it holds) and `output` may change.

Each example below replaces the keys of the same name in the first one. A default of `-` is none.
"""

PAGE = ReferencePage(HEAD, SECTIONS, MEANINGS, EXAMPLES)


if __name__ == "__main__":
    print(PAGE.markdown(), end="")
