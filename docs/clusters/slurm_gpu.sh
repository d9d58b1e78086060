#!/bin/bash
#SBATCH --job-name=simgen
#SBATCH --nodes=2
#SBATCH --ntasks-per-node=1
#SBATCH --gpus-per-node=4
#SBATCH --cpus-per-task=16
#SBATCH --mem=240G
#SBATCH --time=01:00:00
# A worker for each GPU:  sbatch slurm_gpu.sh jobs/paired.yaml [KEY=VALUE ...] [--output FOLDER]
# A worker's 128 threads each take a shard. Their presses are solved together on its GPU.
set -euo pipefail
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
export DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL="1 hour"
file=$PWD/scheduler-$SLURM_JOB_ID.json
trap 'kill $(jobs -p) 2> /dev/null; rm -f "$file"' EXIT

dask scheduler --port 0 --scheduler-file "$file" &
until [ -s "$file" ]; do sleep 0.5; done
srun dask cuda worker --scheduler-file "$file" --nthreads 128 --memory-limit 0 --local-directory "${TMPDIR:-/tmp}" &
simgen run "$@" --device cuda --scheduler-file "$file" --workers $((SLURM_NNODES * SLURM_GPUS_PER_NODE))
