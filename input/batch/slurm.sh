#!/usr/bin/env bash
# Slurm job: sbatch input/batch/slurm.sh SCENE [OUTPUT]      see docs/cluster.md
# Slurm signals this script 300 s before the limit; dosui then writes a checkpoint and the job
# submits itself again until the scene has finished.
#SBATCH --job-name=dosui
#SBATCH --nodes=1
#SBATCH --ntasks-per-node=32
#SBATCH --cpus-per-task=1
#SBATCH --time=24:00:00
#SBATCH --signal=B:USR1@300
#SBATCH --output=%x-%j.log
#SBATCH --open-mode=append
set -u

SCENE=${1:?usage: sbatch slurm.sh SCENE [OUTPUT]}
OUTPUT=${2:-output}
DOSUI=${DOSUI:-dosui}                       # path of the program
BATCH=${DOSUI_BATCH:-$SLURM_SUBMIT_DIR/input/batch}   # folder of this script: Slurm runs a copy of it
export OMP_NUM_THREADS=1
# module load openmpi hdf5 metis            # as on your cluster

cd "$SLURM_SUBMIT_DIR" || exit 1
source "$BATCH/job.sh" || exit 1
dosui_job srun --cpu-bind=cores --kill-on-bad-exit=0
status=$?
# srun reports the largest status of the tasks; every rank ends with the same one.
if [ "$status" -eq 3 ]; then
  exec sbatch --job-name="$SLURM_JOB_NAME" "$BATCH/slurm.sh" "$SCENE" "$OUTPUT"
fi
exit "$status"
