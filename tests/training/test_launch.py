"""As many processes as train together, or a sentence; and what they are told of each other."""

from __future__ import annotations

import pytest
from lightning.fabric.plugins.environments import LightningEnvironment, SLURMEnvironment
from lightning.fabric.utilities.rank_zero import rank_zero_only

from gns_pl.errors import InputError
from gns_pl.training.launch import cluster_environments, launched_devices

TORCHRUN = {"WORLD_SIZE": "4", "LOCAL_WORLD_SIZE": "2", "TORCHELASTIC_RUN_ID": "none"}
BATCH = {"SLURM_NTASKS": "4", "SLURM_JOB_NAME": "night"}
STEP = {**BATCH, "SLURM_STEP_NUM_TASKS": "4", "SLURM_NNODES": "2"}
NAMES = (
    *("WORLD_SIZE", "LOCAL_WORLD_SIZE", "TORCHELASTIC_RUN_ID", "SLURM_NTASKS", "SLURM_JOB_NAME", "SLURM_NNODES"),
    *("SLURM_STEP_NUM_TASKS", "SLURM_NTASKS_PER_NODE", "OMPI_COMM_WORLD_SIZE", "PMI_SIZE"),
)


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    for name in NAMES:
        monkeypatch.setenv(name, "")  # noted, so that it is put back
        monkeypatch.delenv(name)
    for name, value in request.param.items():
        monkeypatch.setenv(name, value)


@pytest.mark.parametrize(("environment", "devices", "nodes", "sentence"), [
    ({"WORLD_SIZE": "4"}, 1, 2, r"a launcher has started 4 processes .* set trainer.devices=2"),
    (BATCH, 1, 1, r"SLURM has 4 tasks \(SLURM_NTASKS\), .* --ntasks=1 .*--cpus-per-task\), or set trainer.devices=4"),
    ({**BATCH, "SLURM_NTASKS": "1"}, 2, 1, r"SLURM has 1 task .* in 2 processes: .* --ntasks=2 .* trainer.devices=1"),
    (STEP, 1, 1, r"SLURM has 4 tasks"),
    ({"OMPI_COMM_WORLD_SIZE": "2"}, 2, 1, r"mpirun has started 2 .* once, with trainer.devices=2"),
], indirect=["environment"])  # fmt: skip
def test_other_numbers_of_processes_are_refused(environment: None, devices: object, nodes: int, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        launched_devices(devices, nodes)


@pytest.mark.parametrize("environment", [STEP], indirect=True)
def test_it_is_said_once(environment: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rank_zero_only, "rank", 3, raising=False)
    with pytest.raises(SystemExit) as ended:
        launched_devices(1)
    assert ended.value.code == 2


@pytest.mark.parametrize(("environment", "devices", "nodes"), [
    ({}, 1, 1), ({}, 2, 1), (BATCH, "auto", 1), (BATCH, -1, 1), (BATCH, 4, 1), (STEP, 2, 2),
    ({**BATCH, "SLURM_JOB_NAME": "interactive"}, 1, 1), ({**STEP, "SLURM_STEP_NUM_TASKS": "1"}, 1, 1),
    ({"PMI_SIZE": "1"}, 2, 1),
], indirect=["environment"])  # fmt: skip
def test_those_that_fit_are_not(environment: None, devices: object, nodes: int) -> None:
    assert launched_devices(devices, nodes) == {"devices": devices, "num_nodes": nodes}


@pytest.mark.parametrize("environment", [TORCHRUN, {**TORCHRUN, **STEP}], indirect=True)
def test_torchrun_says_how_many_train_together(environment: None) -> None:
    assert launched_devices(1) == {"devices": 2, "num_nodes": 2}


@pytest.mark.parametrize(("environment", "kinds"), [
    ({}, []), (TORCHRUN, []), ({**TORCHRUN, **STEP}, []), (BATCH, [LightningEnvironment]), (STEP, [SLURMEnvironment]),
], indirect=["environment"])  # fmt: skip
def test_slurm_starts_no_job_again(environment: None, kinds: list[type]) -> None:
    found = cluster_environments()
    assert [type(each) for each in found] == kinds
    for each in found:
        assert not getattr(each, "auto_requeue", False)
        if isinstance(each, SLURMEnvironment):
            each.validate_settings(num_devices=2, num_nodes=2)
