# Sourced by slurm.sh and pbs.sh: runs a scene, or goes on from its checkpoint. See docs/cluster.md.
#
# dosui_job LAUNCHER...   with SCENE, OUTPUT and DOSUI set; LAUNCHER: srun, or mpirun with options.
# Returns dosui's exit status: 0 finished, 3 stopped by the signal with a new checkpoint in OUTPUT
# (submit again), anything else an error.

dosui_job() {
  local launcher status=0 earlier=1 interrupted=0 started
  mkdir -p "$OUTPUT"
  started="$OUTPUT/.job_started.$$"
  touch "$started"
  echo "$(date '+%F %T')  $SCENE"
  # --continue looks for the checkpoint of this scene itself, by the name of its files, and refuses
  # one that was written by another scene.
  "$@" "$DOSUI" "$SCENE" --output "$OUTPUT" --continue &
  launcher=$!
  # The batch system signals this script; srun and mpirun hand SIGUSR1 on to every rank. SIGTERM
  # becomes SIGUSR1: after a SIGTERM mpirun kills the ranks within seconds, perhaps too soon.
  trap 'interrupted=1; kill -USR1 "$launcher"' USR1 TERM
  while :; do
    status=0
    wait "$launcher" || status=$?
    [ "$interrupted" -eq 1 ] || break
    interrupted=0   # the trapped signal has ended `wait`, not the launcher: wait again
    earlier=$status
  done
  trap - USR1 TERM
  if [ "$status" -eq 127 ]; then status=$earlier; fi   # it had just ended when the signal came
  echo "$(date '+%F %T')  exit status $status"
  if [ "$status" -eq 3 ] && [ -z "$(find "$OUTPUT" -name '*.restart.h5' -newer "$started")" ]; then
    echo "no new checkpoint in $OUTPUT, so submitting again would never end" >&2
    status=1
  fi
  rm -f "$started"
  return "$status"
}
