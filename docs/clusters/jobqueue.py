"""Keep 64 SLURM jobs with a dask worker each, and give them a job:  python jobqueue.py 64 jobs/paired.yaml

dask-jobqueue submits a SLURM job for each worker and replaces those that end (jobqueue.yaml says what it asks for).
"""

import subprocess
import sys

from dask_jobqueue import SLURMCluster

if __name__ == "__main__":
    with SLURMCluster() as cluster:
        cluster.adapt(minimum_jobs=int(sys.argv[1]), maximum_jobs=int(sys.argv[1]))
        subprocess.run(["simgen", "run", *sys.argv[2:], "--scheduler", cluster.scheduler_address], check=True)
