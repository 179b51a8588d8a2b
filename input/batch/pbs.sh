#!/usr/bin/env bash
# PBS job: qsub -v SCENE=input/mandel/nu_0.2.nml,OUTPUT=output input/batch/pbs.sh   see docs/cluster.md
# PBS has no signal before the limit, so a timer in this script sends one 300 s before it; dosui then
# writes a checkpoint and the job submits itself again until the scene has finished.
#PBS -N dosui
#PBS -l select=1:ncpus=32:mpiprocs=32
#PBS -l walltime=24:00:00
#PBS -j oe
set -u

SCENE=${SCENE:?usage: qsub -v SCENE=scene.nml[,OUTPUT=folder] pbs.sh}
OUTPUT=${OUTPUT:-output}
WALLTIME=${WALLTIME:-86400}                 # the walltime above [s]
DOSUI=${DOSUI:-dosui}                       # path of the program
BATCH=${DOSUI_BATCH:-$PBS_O_WORKDIR/input/batch}      # folder of this script: PBS runs a copy of it
export OMP_NUM_THREADS=1
# module load openmpi hdf5 metis            # as on your cluster

cd "$PBS_O_WORKDIR" || exit 1
source "$BATCH/job.sh" || exit 1
set -m   # the timer in a process group of its own, so that its sleep ends with it
(sleep $((WALLTIME - 300)) && kill -USR1 $$) &
timer=$!
set +m
dosui_job mpirun
status=$?
kill -- "-$timer" 2>/dev/null
if [ "$status" -eq 3 ]; then
  exec qsub -v "SCENE=$SCENE,OUTPUT=$OUTPUT,WALLTIME=$WALLTIME,DOSUI=$DOSUI,DOSUI_BATCH=$BATCH" "$BATCH/pbs.sh"
fi
exit "$status"
