"""From a job to its dataset: the plan, shards, workers (the only ones that import dask) and the run."""
