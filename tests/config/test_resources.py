"""Bundled files."""

from simgen.config.resources import bundled_jobs, resource


def test_bundled_folders_are_there():
    assert (resource("sensor_models") / "digit" / "sensor.yaml").is_file()
    assert (resource("indenters") / "indenters.yaml").is_file()


def test_jobs_of_datasets_and_of_trainings_are_told_apart():
    datasets, trainings = ({file.stem for file in bundled_jobs(training)} for training in (False, True))
    assert {"smoke", "paired"} <= datasets and {"training", "training_smoke"} <= trainings
    assert not datasets & trainings
