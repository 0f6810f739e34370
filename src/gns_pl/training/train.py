"""`train`: dataset, simulator, trainer and loggers put together from the resolved config."""

from __future__ import annotations

import logging
import math
import subprocess
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from hydra.utils import instantiate
from lightning.pytorch import Trainer, seed_everything
from omegaconf import DictConfig, OmegaConf

from gns_pl.data.datamodule import TrajectoryDataModule
from gns_pl.errors import InputError
from gns_pl.generation import generate_dataset
from gns_pl.io import Manifest, manifest_sha256
from gns_pl.training.module import SimulatorModule
from gns_pl.training.resume import check_resume

PACKAGES = ("gns_pl", "torch", "torch-geometric", "lightning", "numpy", "numba", "h5py")


def train(cfg: DictConfig, output: Path, resume: Path | None) -> Path:
    """Generate the data where they are missing, train a simulator on them, and return its last checkpoint.

    Args:
        cfg: the config of conf/train.yaml.
        output: folder of this run.
        resume: checkpoint to go on from.

    Returns:
        Path of the last checkpoint.

    Raises:
        InputError: a setting that cannot be used.
    """
    quieten()
    seed_everything(cfg.seed, workers=True, verbose=False)
    data = plain(cfg.data)
    directory = generate_dataset(data)
    module, datamodule = build(cfg, data, directory)
    if resume is not None:
        check_resume(resume, dict(module.hparams))
    callbacks = [instantiate(callback) for callback in cfg.callbacks.values()]
    loggers = [instantiate(logger) for logger in cfg.logger.values() if OmegaConf.is_config(logger)]
    last = output / "last.ckpt"
    trainer: Trainer = instantiate(cfg.trainer, callbacks=callbacks, logger=loggers)
    print(
        f"{cfg.name}: {len(datamodule.train_set)} windows of {len(datamodule.train_names)} trajectories, "
        f"{sum(p.numel() for p in module.parameters())} parameters, {trainer.max_steps} steps on "
        f"{trainer.strategy.root_device}, into {output}"
    )
    try:
        for logger in loggers:
            logger.log_hyperparams(plain(cfg))
        trainer.fit(module, datamodule=datamodule, ckpt_path=resume, weights_only=True)
    except SystemExit:  # Lightning's way out after Ctrl-C
        hint = f"; to go on, add resume={last}" if last.is_file() else ""
        raise SystemExit(f"train.py: stopped after {trainer.global_step} steps{hint}.") from None
    finally:
        finish_wandb(cfg)
    return last


def build(cfg: DictConfig, data: dict[str, Any], directory: Path) -> tuple[SimulatorModule, TrajectoryDataModule]:
    """Return the module, its statistics set, and the data module of a config and a dataset folder."""
    training = plain(cfg.training)
    model = plain(cfg.model)
    datamodule = TrajectoryDataModule(
        directory,
        batch_size=training["batch_size"],
        num_steps=training["optimisation"]["num_steps"],
        input_sequence_length=model["input_sequence_length"],
        start_repeats=training["start_repeats"],
        num_workers=training["num_workers"],
        memory_limit=training["memory_limit"],
        num_train=training["num_train"],
        seed=cfg.seed,
    )
    manifest = datamodule.manifest
    perturbation = {key: training[key] for key in ("noise_std", "noise_free", "strain_std", "strain_length", "restore")}
    module = SimulatorModule(
        model={
            **model,
            "dim": manifest.dim,
            "dt": manifest.dt,
            "spacing": manifest.spacing,
            "particle_types": list(manifest.particle_types),
            "material_features": list(manifest.material_features),
        },
        data=data,
        optimisation=training["optimisation"],
        perturbation=perturbation,
        seed=cfg.seed,
        provenance=provenance(cfg, directory),
    )
    datamodule.setup("fit")
    scales = statistics(manifest, data["gravity"], training["noise_std"])
    module.simulator.set_statistics(**scales, material=material_scale(datamodule))
    return module, datamodule


def statistics(manifest: Manifest, gravity: float, noise_std: float) -> dict[str, float]:
    """Return root mean squares over all components, training noise included.

    Args:
        manifest: with mean and standard deviation of velocity and acceleration.
        gravity: magnitude, along the last axis [m/s²].
        noise_std: of the latest velocity's noise times Δt [m].

    Returns:
        "velocity" [m/s] and "acceleration" (of a − g) [m/s²].
    """
    values = manifest.statistics
    velocity = [m**2 + s**2 for m, s in zip(values["velocity"]["mean"], values["velocity"]["std"], strict=True)]
    mean = list(values["acceleration"]["mean"])
    mean[-1] += gravity
    acceleration = [m**2 + s**2 for m, s in zip(mean, values["acceleration"]["std"], strict=True)]
    noise = noise_std / manifest.dt
    return {
        "velocity": math.sqrt(sum(velocity) / len(velocity) + noise**2),
        "acceleration": math.sqrt(sum(acceleration) / len(acceleration) + (noise / manifest.dt) ** 2),
    }


def material_scale(datamodule: TrajectoryDataModule) -> torch.Tensor:
    """Return mean and standard deviation of the material features over the training set [2, K]; 1 where constant."""
    material = torch.cat([constant["material"] for constant in datamodule.train_set.constant]).double()
    deviation = material.std(dim=0, correction=0)
    return torch.stack([material.mean(dim=0), torch.where(deviation > 1e-9, deviation, 1.0)]).float()


def quieten() -> None:
    """Keep Lightning's advertisements, and warnings that tell a user nothing, off the terminal."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    for message in (
        ".*exists and is not empty",
        ".*does not have many workers",
        ".*LeafSpec.*",
        ".*weights_only.*",
        ".*not resumable.*",
    ):
        warnings.filterwarnings("ignore", message)
    warnings.filterwarnings("ignore", category=DeprecationWarning)


def provenance(cfg: DictConfig, directory: Path) -> dict[str, Any]:
    """Return versions, commit, config and the hash of the dataset's manifest."""
    try:
        commit = subprocess.run(
            ["git", "describe", "--always", "--dirty"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        commit = "unknown"
    return {
        "description": cfg.description,
        "versions": {name: version(name) for name in PACKAGES},
        "commit": commit,
        "config": plain(cfg),
        "manifest_sha256": manifest_sha256(directory),
    }


def finish_wandb(cfg: DictConfig) -> None:
    """End the W&B run, or the jobs of a sweep would merge into one."""
    if "wandb" in cfg.logger:
        import wandb

        wandb.finish()


def plain(cfg: Any) -> dict[str, Any]:
    """Return a config as plain dicts and lists."""
    resolved = OmegaConf.to_container(cfg, resolve=True) if OmegaConf.is_config(cfg) else cfg
    if not isinstance(resolved, Mapping):
        raise InputError(f"expected a group of settings, not {resolved!r}.")
    return {str(key): value for key, value in resolved.items()}
