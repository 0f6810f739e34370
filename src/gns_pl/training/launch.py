"""Who starts the processes of a training: Lightning, or `torchrun`, `srun` or `mpirun` before it.

`trainer.devices=2` alone needs no launcher, since Lightning starts `train.py` once more for every further device.
`torchrun` says how many processes it has started, and they train together. Another launcher that starts other numbers
than the settings say would train several times side by side.
"""

from __future__ import annotations

import os
from typing import Any

from lightning.fabric.plugins.environments.cluster_environment import ClusterEnvironment
from lightning.fabric.plugins.environments.lightning import LightningEnvironment
from lightning.fabric.plugins.environments.slurm import SLURMEnvironment

from gns_pl.errors import InputError
from gns_pl.training.devices import is_rank_zero

MPI_SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
INTERACTIVE = ("bash", "interactive")
"""Names of SLURM's jobs in which a user types commands; Lightning takes them for no job, too."""


def in_slurm_job() -> bool:
    """Return whether SLURM runs this command, not a user in a shell that it gave him."""
    return "SLURM_NTASKS" in os.environ and os.environ.get("SLURM_JOB_NAME") not in INTERACTIVE


def cluster_environments() -> list[ClusterEnvironment]:
    """Return what Lightning should know of the processes, empty where it finds out by itself.

    In a SLURM job Lightning would answer USR1 with a checkpoint in the working folder and a new job; here it is one of
    the signals that end a run (`StopAtSignal`).
    """
    if "TORCHELASTIC_RUN_ID" in os.environ or not in_slurm_job():
        return []
    if int(os.environ.get("SLURM_STEP_NUM_TASKS", 1)) > 1:
        tasks = int(os.environ["SLURM_NTASKS"]) // int(os.environ.get("SLURM_NNODES", 1))
        os.environ.setdefault("SLURM_NTASKS_PER_NODE", str(tasks))  # Lightning accepts no other way to ask for them
        return [SLURMEnvironment(auto_requeue=False)]
    return [LightningEnvironment()]


def launched_devices(devices: Any, num_nodes: int = 1) -> dict[str, Any]:
    """Return "devices" and "num_nodes" for the trainer: what `torchrun` has started, and what is set elsewhere.

    Args:
        devices: trainer.devices; only a number can be compared before there is a trainer.
        num_nodes: trainer.num_nodes.

    Raises:
        InputError: another launcher has started other numbers of processes; what to set is said.
        SystemExit: with status 2, in all of them but the first one, which says it.
    """
    if "TORCHELASTIC_RUN_ID" in os.environ:
        local = int(os.environ["LOCAL_WORLD_SIZE"])
        return {"devices": local, "num_nodes": int(os.environ["WORLD_SIZE"]) // local}
    try:
        _check_started(devices, num_nodes)
    except InputError:
        if not is_rank_zero():
            raise SystemExit(2) from None
        raise
    return {"devices": devices, "num_nodes": num_nodes}


def _check_started(devices: object, num_nodes: int) -> None:
    started, launcher = _started()
    if started == 1 and launcher != "SLURM":
        return
    if launcher == "mpirun":
        raise InputError(
            f"mpirun has started {started} processes, which would train one by one; start train.py once, with "
            f"trainer.devices={started}."
        )
    wanted = devices * num_nodes if isinstance(devices, int) and not isinstance(devices, bool) else -1
    if wanted < 1 or wanted == started:  # -1, "auto" and lists: Lightning compares
        return
    setting = f"trainer.devices={started}" if num_nodes == 1 else f"trainer.devices={max(1, started // num_nodes)}"
    if launcher == "SLURM":
        raise InputError(
            f"SLURM has {started} task{'s' if started > 1 else ''} (SLURM_NTASKS), but trainer.devices={devices} "
            f"trains in {wanted} process{'es' if wanted > 1 else ''}: ask for --ntasks={wanted} (cores of a task are "
            f"--cpus-per-task), or set {setting}."
        )
    raise InputError(
        f"{launcher} has started {started} processes (WORLD_SIZE), but trainer.devices={devices} trains in {wanted}: "
        f"start train.py once, without a launcher, or set {setting}."
    )


def _started() -> tuple[int, str]:
    """Return how many processes were started for this training, and by what."""
    if "WORLD_SIZE" in os.environ:
        return int(os.environ["WORLD_SIZE"]), "a launcher"
    if in_slurm_job():
        return int(os.environ.get("SLURM_STEP_NUM_TASKS", os.environ["SLURM_NTASKS"])), "SLURM"
    sizes = [int(os.environ[name]) for name in MPI_SIZES if name in os.environ]
    return max(sizes, default=1), "mpirun" if max(sizes, default=1) > 1 else "nothing"
