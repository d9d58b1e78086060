"""Compare translations from one sensor to another: those of any network, beside ours, baselines and floors.

    python benchmarks/translators.py paired.zarr training.networks --list test.npz
    python benchmarks/translators.py paired.zarr training.networks --predictions theirs=theirs.npz
    python benchmarks/translators.py paired.zarr training.networks --inputs signals --network theirs=file:function

The folder of `simgen train` gives the splits, the signals and the networks to compare with. --list writes the test
samples, the inputs of all networks:

    press, step    (n,) numbers in the dataset
    signals        (n, channel) V
    source         (n, vertex, 3) displacement of the source, m

--predictions reads an .npz or a zarr folder with press, step and ``displacement`` (n, vertex, 3) of the target, m, of
all test samples in any order. --network calls a function with tensors of some test samples, named as above. It returns
``displacement`` of these samples.

--inputs says what these networks know, and so which floor holds for them: the source's mesh or the signals.
"""

import argparse
import importlib
import sys
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch
import zarr
from record import arguments, run, write
from torch import Tensor

from simgen.errors import InputError
from simgen.learning.data.registry import SIGNALS, SOURCE, TARGET
from simgen.learning.data.samples import BATCH, load_training_data
from simgen.learning.evaluation.error_tables import Entry, markdown, plain_entry
from simgen.learning.evaluation.metrics import Predictor
from simgen.learning.networks.checkpoint import load_network
from simgen.learning.networks.network_data import TrainingInputs
from simgen.learning.training.evaluate import Evaluation
from simgen.learning.training.run import is_trained, torch_device
from simgen.learning.translation.translator import read_job

KEYS = ("press", "step", "displacement")


class TestSamples:
    """Test samples of a dataset, with the signals of a folder of networks."""

    __test__ = False  # no class of tests

    def __init__(self, dataset: Path, networks: Path, device: str):
        job, where = read_job(networks), torch_device(device)
        if job.signals.recordings is not None:
            raise InputError(f"{networks}: was trained on recordings, which hold no target; allowed: synthetic signals")
        data = load_training_data(dataset, (job.source, job.target), where, lambda each, _: each, job.leave_out)
        self.inputs = TrainingInputs(job, data, cache(lambda name: load_network(networks / name, where)))
        self.evaluation = Evaluation(self.inputs, partial(is_trained, networks))
        self.rows = data.rows("test")

    def given(self, rows: Tensor) -> dict[str, Tensor]:
        """Inputs that a network may use, of samples (n,)."""
        data, at = self.inputs.data, rows.cpu().numpy()
        press, step = (torch.from_numpy(each[at]).to(rows.device) for each in (data.press, data.step))
        return {"press": press, "step": step, "signals": self.inputs.signals.values[rows],
                "source": self.inputs.source.displacement(rows)}  # fmt: skip

    def write_list(self, file: Path) -> None:
        parts = [self.given(some) for some in self.rows.split(BATCH)]
        whole = {key: torch.cat([part[key] for part in parts]).cpu().numpy() for key in parts[0]}
        try:
            with open(file, "wb") as out:
                np.savez(out, **whole)
        except OSError as error:
            raise InputError(f"--list {file}: cannot be written: {error.strerror}") from None

    def from_file(self, name: str) -> Predictor:
        """Predictions of a file. Raises `InputError` unless it has all test samples."""
        found = read_predictions(Path(name))
        self._check(f"{name}: displacement", found["displacement"].shape, len(found["press"]))
        data, at = self.inputs.data, self.rows.cpu().numpy()
        known, stated = one_number(data.press, data.step), one_number(found["press"], found["step"])
        missing = at[~np.isin(known[at], stated)]
        if len(missing):
            first = f"press {data.press[missing[0]]}, step {data.step[missing[0]]}"
            raise InputError(f"{name}: {len(missing)} of {len(at)} test samples are missing, the first is {first}; "
                             "allowed: all of --list")  # fmt: skip
        if len(np.unique(stated)) < len(stated):
            raise InputError(f"{name}: samples are there twice; allowed: each press and step once")
        order = np.argsort(stated)

        def predict(rows: Tensor) -> Tensor:
            places = order[np.searchsorted(stated, known[rows.cpu().numpy()], sorter=order)]
            return torch.from_numpy(found["displacement"][places]).to(rows.device)

        return predict

    def from_function(self, name: str) -> Predictor:
        """Predictions of a function, named module:function. Raises `InputError` for results of another shape."""
        function = imported(name)

        def predict(rows: Tensor) -> Tensor:
            found = function(self.given(rows))
            if not isinstance(found, Tensor | np.ndarray):
                raise InputError(f"{name}: returned {type(found).__name__}; allowed: a tensor or an array")
            found = torch.as_tensor(found, device=rows.device)
            self._check(f"{name}: returned", tuple(found.shape), len(rows))
            return found

        return predict

    def _check(self, name: str, shape: tuple[int, ...], samples: int) -> None:
        allowed = (samples, *self.inputs.target.rest.shape)
        if shape != allowed:
            raise InputError(f"{name} has shape {shape}; allowed: {allowed}")

    def compared(self, inputs: str, others: Mapping[str, Predictor]) -> list[Entry]:
        """Baselines, the floor, our networks, and the others."""
        own = [*self.evaluation.task(inputs, TARGET)] or [*self.evaluation.bars(inputs, TARGET)]
        entry = partial(self.evaluation.mesh_entry, inputs, TARGET, parameters=None)
        return [*own, *(entry(name, predict) for name, predict in others.items())]


def read_predictions(file: Path) -> dict[str, np.ndarray]:
    """Read press (n,), step (n,) and displacement (n, ...). Raises `InputError`."""
    try:
        stored = zarr.open_group(file, mode="r") if file.is_dir() else np.load(file, allow_pickle=False)
        found = {key: np.asarray(stored[key]) for key in KEYS}
    except Exception as error:  # zarr and zip files raise errors of many kinds
        words = str(error).splitlines() or [type(error).__name__]
        raise InputError(f"{file}: cannot be read ({words[0]}); allowed: an .npz or a zarr folder with "
                         f"{', '.join(KEYS)}") from None  # fmt: skip
    for key in KEYS[:2]:
        if found[key].shape != found["displacement"].shape[:1] or found[key].dtype.kind not in "iu":
            raise InputError(f"{file}: {key}: {found[key].dtype} {found[key].shape}; allowed: a whole number for each "
                             "sample of displacement")  # fmt: skip
    if found["displacement"].dtype.kind != "f":
        raise InputError(f"{file}: displacement: {found['displacement'].dtype}; allowed: floating-point numbers, m")
    return found


def one_number(press: np.ndarray, step: np.ndarray) -> np.ndarray:
    """A number for each press and step."""
    return press.astype(np.int64) * 2**32 + step.astype(np.int64)


def imported(name: str) -> Callable:
    """Import a function named module:function. Raises `InputError`."""
    module, _, function = name.partition(":")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"--network {name}: {error}; allowed: module:function") from None


def pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: NAME=...")
    return name, value


def main() -> None:
    parser = arguments(__doc__, "translators.json")
    parser.add_argument("dataset", type=Path)
    parser.add_argument("networks", type=Path, help="folder of `simgen train`")
    parser.add_argument("--inputs", choices=(SOURCE, SIGNALS), default=SOURCE, help="what the networks know")
    parser.add_argument("--predictions", type=pair, action="append", default=[], metavar="NAME=FILE")
    parser.add_argument("--network", type=pair, action="append", default=[], metavar="NAME=MODULE:FUNCTION")
    parser.add_argument("--list", type=Path, metavar="FILE.npz", help="write the test samples and end")
    run(parser, compare)


def compare(asked: argparse.Namespace) -> None:
    samples = TestSamples(asked.dataset, asked.networks, asked.device)
    if asked.list is not None:
        samples.write_list(asked.list)
        print(f"wrote {asked.list}: {len(samples.rows):,} samples")
        return
    names = [name for name, _ in (*asked.predictions, *asked.network)]
    if len(set(names)) < len(names):
        raise InputError(f"--predictions and --network: {', '.join(names)}; allowed: each name once")
    sys.path.insert(0, "")  # modules of the current folder
    others = {name: samples.from_file(file) for name, file in asked.predictions}
    others |= {name: samples.from_function(function) for name, function in asked.network}
    entries = samples.compared(asked.inputs, others)
    print(markdown(entries))
    write(asked, [plain_entry(entry, entries) for entry in entries], task=entries[0].task)


if __name__ == "__main__":
    main()
