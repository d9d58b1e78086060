"""From a job to its dataset: the plan, shards, workers (the only module that imports dask) and the run."""
