#!/bin/bash
#SBATCH --job-name=simgen
#SBATCH --ntasks=64
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=3G
#SBATCH --time=24:00:00
# One worker on each task's core:  sbatch slurm.sh jobs/paired.yaml [KEY=VALUE ...] [--output FOLDER]
# Submit it again to continue. Job, dataset and this folder lie on a file system that all nodes share.
set -euo pipefail
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
export DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL="1 hour"
file=$PWD/scheduler-$SLURM_JOB_ID.json
trap 'kill $(jobs -p) 2> /dev/null; rm -f "$file"' EXIT

dask scheduler --port 0 --scheduler-file "$file" &
until [ -s "$file" ]; do sleep 0.5; done
srun dask worker --scheduler-file "$file" --nthreads 1 --memory-limit "${SLURM_MEM_PER_CPU:-0}MiB" \
    --local-directory "${TMPDIR:-/tmp}" &
simgen run "$@" --scheduler-file "$file"
