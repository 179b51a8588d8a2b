"""The job scripts with stand-ins for srun, sbatch and qsub: signal, checkpoint, resubmission."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
from conftest import BIN, ROOT, scene_text

STAND_INS = {
    # srun without its options, on two ranks; sbatch and qsub only note what they are asked.
    "srun": 'while [[ $1 == --* ]]; do shift; done; exec mpirun -n 2 "$@"',
    "sbatch": 'echo "$@" >>"$PBS_O_WORKDIR/submitted"',
    "qsub": 'echo "$@" >>"$PBS_O_WORKDIR/submitted"',
}
SCRIPTS = sorted((ROOT / "input").glob("**/*.sh"))


@pytest.fixture
def job(tmp_path: Path) -> dict[str, str]:
    """Environment in which the scripts find the stand-ins; the scene takes half a minute."""
    for name, text in STAND_INS.items():
        (tmp_path / "bin").mkdir(exist_ok=True)
        (tmp_path / "bin" / name).write_text(f"#!/usr/bin/env bash\n{text}\n")
        (tmp_path / "bin" / name).chmod(0o755)
    text = scene_text("terzaghi/scene_2d.nml", spacing="0.0125", box_max="0.25, 1.0")
    (tmp_path / "scene.nml").write_text(text)
    return os.environ | {
        "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}",
        "DOSUI": str(BIN / "dosui"),
        "DOSUI_BATCH": str(ROOT / "input" / "batch"),
        "SLURM_SUBMIT_DIR": str(tmp_path),
        "SLURM_JOB_NAME": "dosui",
        "PBS_O_WORKDIR": str(tmp_path),
        "SCENE": "scene.nml",
        "OUTPUT": "out",
        "WALLTIME": "304",  # the timer of pbs.sh fires after 4 s
    }


def start(job: dict[str, str], script: str) -> subprocess.Popen[str]:
    """The script as the batch system starts it."""
    command = ["bash", str(ROOT / "input" / "batch" / script), "scene.nml", "out"]
    return subprocess.Popen(
        command, env=job, stdout=subprocess.PIPE, text=True, start_new_session=True
    )


def finish(process: subprocess.Popen[str]) -> str:
    """What the script prints until its end; a script that hangs is ended, with its children."""
    try:
        return process.communicate(timeout=60)[0]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise


def wait_for(path: Path) -> None:
    """Waits until a file is there, half a minute at most."""
    for _ in range(300):
        if path.exists():
            return
        time.sleep(0.1)
    raise AssertionError(f"{path} does not come")


def submitted(job: dict[str, str]) -> list[str]:
    """What the scripts have submitted."""
    path = Path(job["PBS_O_WORKDIR"]) / "submitted"
    return path.read_text().splitlines() if path.exists() else []


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_shell_scripts_parse(script: Path) -> None:
    assert subprocess.run(["bash", "-n", str(script)], check=False).returncode == 0


@pytest.mark.parametrize("warning", [signal.SIGUSR1, signal.SIGTERM])
def test_slurm_stops_and_submits_itself_again(job: dict[str, str], warning: int) -> None:
    process = start(job, "slurm.sh")
    wait_for(
        Path(job["PBS_O_WORKDIR"]) / "out" / "terzaghi_2d.vtkhdf"
    )  # it watches signals by then
    process.send_signal(warning)
    text = finish(process)
    assert "exit status 3" in text
    assert len(submitted(job)) == 1
    assert submitted(job)[0].endswith("slurm.sh scene.nml out")
    assert list((Path(job["PBS_O_WORKDIR"]) / "out").glob("*.restart.h5"))


def test_pbs_stops_by_its_timer_and_goes_on(job: dict[str, str]) -> None:
    text = finish(start(job, "pbs.sh"))
    assert "exit status 3" in text
    assert "SCENE=scene.nml,OUTPUT=out,WALLTIME=304" in submitted(job)[0]
    text = finish(start(job, "pbs.sh"))
    assert "restart      from out/" in text


def test_a_job_takes_only_its_own_checkpoint(job: dict[str, str]) -> None:
    """Another scene's in the same folder is passed over, however new; of its own name, refused."""
    folder = Path(job["PBS_O_WORKDIR"])
    text = scene_text("terzaghi/scene_1d.nml", output_times="0.01", end_time="0.02")
    other = text.replace("'terzaghi_1d'", "'other'").replace(
        "  end_time", "  maximum_steps = 9\n  end_time"
    )
    (folder / "other.nml").write_text(other)
    command = [job["DOSUI"], "other.nml", "--output", "out"]
    assert subprocess.run(command, cwd=folder, env=job, check=False).returncode == 0
    assert (folder / "out" / "other.restart.h5").exists()
    (folder / "scene.nml").write_text(text)
    process = start(job, "slurm.sh")
    assert "no checkpoint of this scene" in finish(process)
    assert process.returncode == 0
    (folder / "out" / "other.restart.h5").rename(folder / "out" / "terzaghi_1d.restart.h5")
    (folder / "scene.nml").write_text(text.replace("0.025", "0.05"))
    process = start(job, "slurm.sh")
    finish(process)
    assert process.returncode == 2
    assert not list((folder / "out").glob(".job_started*"))


def test_a_stop_without_checkpoint_is_not_submitted_again(job: dict[str, str]) -> None:
    stop = Path(job["PBS_O_WORKDIR"]) / "bin" / "stop"
    stop.write_text("#!/usr/bin/env bash\nexit 3\n")
    stop.chmod(0o755)
    process = start(job | {"DOSUI": str(stop)}, "slurm.sh")
    finish(process)
    assert process.returncode == 1
    assert submitted(job) == []


def test_a_finished_scene_is_not_submitted_again(job: dict[str, str]) -> None:
    path = Path(job["PBS_O_WORKDIR"]) / "scene.nml"
    text = scene_text("terzaghi/scene_1d.nml", output_times="0.01", end_time="0.02")
    path.write_text(text)
    process = start(job, "slurm.sh")
    finish(process)
    assert process.returncode == 0
    assert submitted(job) == []
