"""`train`: dataset, simulator, trainer and loggers put together from the resolved config."""

from __future__ import annotations

import errno
import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import Trainer, seed_everything
from omegaconf import DictConfig, OmegaConf

from gns_pl.data.datamodule import TrajectoryDataModule
from gns_pl.errors import InputError, tolerated
from gns_pl.generation import find_dataset, resolved_data
from gns_pl.io import StorageError
from gns_pl.machine import provide_home
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint
from gns_pl.models.registry import simulator_config
from gns_pl.models.shipped import CORRECTOR_KIND, existing_checkpoint
from gns_pl.nn import in_float32
from gns_pl.nn.memory import keep_freed_memory
from gns_pl.training.beginning import begin_from
from gns_pl.training.callbacks import StopAtSignal
from gns_pl.training.checkpoints import BEST, LAST, best_checkpoint
from gns_pl.training.config import TrainingConfig
from gns_pl.training.deposits import Deposits
from gns_pl.training.devices import check_devices, end_together, is_rank_zero
from gns_pl.training.distribution import measure_distribution
from gns_pl.training.learning import LearningModule
from gns_pl.training.loggers import close_loggers, log_settings
from gns_pl.training.module import SimulatorModule
from gns_pl.training.provenance import provenance
from gns_pl.training.recipe import Recipe
from gns_pl.training.resume import exclusive, go_on, steps_made
from gns_pl.training.run_summary import close_run, monitored, run_files
from gns_pl.training.summary import SUMMARY_FILE
from gns_pl.training.trainer import build_trainer, quieten
from gns_pl.training.validation import DEPOSIT_ERROR
from gns_pl.training.whole_runs import WholeRuns, read_fine_run


class SimulatorRecipe(Recipe):
    """A learned simulator.

    Args:
        settings: the resolved config.

    Raises:
        InputError: a setting that no data could make valid.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.settings = settings
        self.training = TrainingConfig.from_dict(settings["training"])
        check_model(settings["model"])
        name = settings["ckpt"]
        if not (name is None or isinstance(name, str)):
            raise InputError(f"ckpt must be one file, or one name of a model of the package, not {name}.")
        self.begun = None if name is None else load_checkpoint(existing_checkpoint(name))
        self.num_steps, self.batch_size = self.training.optimisation.num_steps, self.training.batch_size

    def build(self, directory: Path, trainer: Trainer) -> tuple[SimulatorModule, TrajectoryDataModule]:
        """Return module and data module of a dataset folder."""
        model = self.settings["model"]
        datamodule = build_data(directory, self.training, model, self.settings["seed"])
        if trainer.limit_val_batches:
            datamodule.check_validation()
        phase, processes = self.training.rollout, trainer.num_nodes * trainer.num_devices
        if phase.num_steps and phase.scenes % processes:
            raise InputError(
                f"training.rollout.scenes={phase.scenes} per step cannot be shared by {processes} processes alike; "
                "make it a multiple, or set trainer.devices."
            )
        module = build_module(self.settings, self.training, datamodule, self.begun)
        stride = self.training.stride
        if phase.num_steps:
            runs = [read_fine_run(directory / name, stride) for name in datamodule.train_names]
            symmetry, seed = self.training.optimisation.symmetry, self.settings["seed"]
            module.whole_runs = WholeRuns(runs, phase, self.settings["data"], symmetry=symmetry, seed=seed)
        if trainer.limit_val_batches and (phase.num_steps or monitored(trainer) == DEPOSIT_ERROR):
            held_out = [read_fine_run(directory / name, stride) for name in datamodule.valid_names]
            module.deposits = Deposits(held_out, phase.placements)
        return module, datamodule


def find_recipe(settings: Mapping[str, Any]) -> Recipe:
    """Return what is trained: `model.kind` says it.

    Args:
        settings: the resolved config.

    Raises:
        InputError: a setting that no data could make valid.
    """
    if settings["model"].get("kind") != CORRECTOR_KIND:
        return SimulatorRecipe(settings)
    from gns_pl.training.corrector_recipe import CorrectorRecipe, RetunedCorrectorRecipe

    return RetunedCorrectorRecipe(settings) if settings["model"].get("coarse") else CorrectorRecipe(settings)


@in_float32
def train(cfg: DictConfig, output: Path, resume: Path | None) -> Path:
    """Generate the data where they are missing, train a simulator on them, and return its last checkpoint.

    Args:
        cfg: the config of conf/train.yaml.
        output: folder of this run.
        resume: checkpoint to go on from.

    Returns:
        Path of the last checkpoint.

    Raises:
        InputError: a setting that cannot be used; found before anything is generated where that is possible.
    """
    quieten()
    keep_freed_memory()
    provide_home()  # before W&B and torch look for it
    os.environ.setdefault("WANDB_SILENT", "true")  # it would print a page; where its run is, is told below
    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    settings["data"] = resolved_data(settings["data"])
    recipe = find_recipe(settings)
    steps = recipe.num_steps
    if resume is not None and steps_made(resume, settings) >= steps:
        print(f"{resume} has made its {steps} steps already; nothing is left to train.")
        best = output / BEST  # a kill behind the last step may have kept it from being exported
        recipe.export(best if best.is_file() else resume, output)
        return resume
    stop = StopAtSignal()
    trainer = build_trainer(cfg, output, steps, stop)
    check_devices(trainer, recipe.batch_size)
    exported: list[Path] = []
    with end_together(trainer), exclusive(output) if is_rank_zero() else nullcontext():
        seed_everything(settings["seed"], workers=True, verbose=False)
        directory = find_dataset(settings["data"], progress=is_rank_zero())
        module, datamodule = recipe.build(directory, trainer)
        try:
            if is_rank_zero():
                announce(settings, trainer, module, datamodule, output)
                log_settings(trainer.loggers, settings)
            trainer.fit(module, datamodule=datamodule, ckpt_path=resume, weights_only=True)
            if stop.received is not None and trainer.global_step < steps:
                raise SystemExit  # as Lightning does after a second Ctrl-C
        except SystemExit:
            hint = f"; to go on, add {go_on(output)}" if (output / LAST).is_file() else ""
            raise SystemExit(f"train.py: stopped after {trainer.global_step} steps{hint}") from None
        except (StorageError, OSError) as error:
            if isinstance(error, OSError) and error.errno != errno.ENOSPC:
                raise
            hint = f"; make room and go on: add {go_on(output)}" if (output / LAST).is_file() else ""
            raise StorageError(f"{str(error).rstrip('.')}{hint}") from error
        except Exception as error:
            if (output / LAST).is_file():
                error.add_note(f"To go on from {output / LAST}, add {go_on(output)}")
            raise
        finally:
            with tolerated("what the best checkpoint is used as"):
                if is_rank_zero() and (output / LAST).is_file():
                    exported = recipe.export(best_checkpoint(trainer) or output / LAST, output)
            with tolerated(SUMMARY_FILE):
                close_run(output, trainer, module, datamodule, exported)
            close_loggers(trainer.loggers)
        if not is_rank_zero():
            raise SystemExit(0)  # the rest is done once
    if trainer.global_step < steps:
        print(f"Stopped after {trainer.global_step} of {steps} steps; to go on, add {go_on(output)}")
    results = (
        *exported,
        output / LAST,
        best_checkpoint(trainer),
        *run_files(output),
        *sorted(output.glob("csv/*/metrics.csv")),
    )
    files = [*filter(None, results), *sorted(output.glob("wandb/*run-*")), *sorted(output.glob("tensorboard/*"))]
    print("Made:", *(path for path in files if path.exists()), sep="\n  ")
    return output / LAST


def announce(
    settings: Mapping[str, Any],
    trainer: Trainer,
    module: LearningModule,
    datamodule: TrajectoryDataModule,
    output: Path,
) -> None:
    """Print what is about to be trained on what, and where."""
    processes = trainer.num_nodes * trainer.num_devices
    where = f"{trainer.strategy.root_device}" + (f" and {processes - 1} more" if processes > 1 else "")
    print(
        f"{settings['name']}: {len(datamodule.train_set)} windows of {len(datamodule.train_names)} trajectories, "
        f"{sum(p.numel() for p in module.parameters())} parameters, {datamodule.num_steps} steps on {where}, "
        f"into {output}",
        flush=True,
    )
    if not trainer.limit_val_batches or not datamodule.valid_names:
        print(
            "Nothing is held out for a validation, so there will be no best.ckpt; the result is last.ckpt.", flush=True
        )


def choose_features(wanted: Sequence[str] | None, available: Sequence[str]) -> list[str]:
    """Return the material features that become node inputs: those wanted, all that the data have if None.

    Raises:
        InputError: features that the data do not begin with.
    """
    features = list(available if wanted is None else wanted)
    if features != list(available)[: len(features)]:
        raise InputError(f"model.material_features is {features}, but the data have {list(available)}, in this order.")
    return features


def check_model(model: Mapping[str, Any]) -> None:
    """Raise an `InputError` for a model that no data could make valid."""
    data = {"dim": 3, "dt": 1.0, "spacing": 1.0, "particle_types": (), "material_features": ()}
    simulator_config({**model, **data})


def build_data(directory: Path, training: TrainingConfig, model: Mapping[str, Any], seed: int) -> TrajectoryDataModule:
    """Return the data module of a dataset folder, with its training set open.

    Args:
        directory: folder with a manifest.
        training: conf/training.
        model: conf/model, of which the history and what is known of walls count.
        seed: of the order of windows.
    """
    datamodule = TrajectoryDataModule(
        directory,
        batch_size=training.batch_size,
        num_steps=training.optimisation.num_steps,
        input_sequence_length=model["input_sequence_length"],
        num_targets=training.optimisation.unroll_steps,
        stride=training.stride,
        start_repeats=training.start_repeats,
        moving_repeats=training.moving_repeats,
        num_workers=training.num_workers,
        memory_limit=training.memory_limit,
        num_train=training.num_train,
        seed=seed,
        surfaces=model.get("walls", "box") != "box",
    )
    datamodule.setup("fit")
    return datamodule


def build_module(
    settings: Mapping[str, Any],
    training: TrainingConfig,
    datamodule: TrajectoryDataModule,
    begun: Checkpoint | None = None,
) -> SimulatorModule:
    """Return the module with the statistics of its data set.

    Args:
        settings: the resolved config.
        training: conf/training, checked.
        datamodule: with its training set open.
        begun: what the training begins with; None for random weights.

    Raises:
        InputError: data that do not fit, or a beginning of another build.
    """
    manifest = datamodule.manifest
    of_data: dict[str, Any] = {
        "dim": manifest.dim,
        "dt": manifest.dt * training.stride,
        "spacing": manifest.spacing,
        "particle_types": list(manifest.particle_types),
        "material_features": choose_features(settings["model"]["material_features"], manifest.material_features),
    }
    model = {**settings["model"], **of_data}
    datamodule.check_places(model["connectivity_radius"])
    module = SimulatorModule(
        model=model,
        data=settings["data"],
        optimisation=vars(training.optimisation),
        perturbation=vars(training.perturbation),
        rollout=vars(training.rollout),
        particles_per_window=datamodule.train_set.mean_moved_particles(),
        seed=settings["seed"],
        provenance=provenance(settings, datamodule.directory),
    )
    if training.stride == 1:
        moments = manifest.statistics
    else:
        moments = {name: seen.to_dict() for name, seen in datamodule.statistics().items()}
    module.simulator.fit_statistics(
        moments,
        gravity=settings["data"]["gravity"],
        noise_std=training.perturbation.noise_std,
        material=material_scale(datamodule, len(of_data["material_features"])),
    )
    if begun is not None:
        begin_from(module.simulator, begun, settings["ckpt"])
    if module.simulator.config.exact_steps:
        module.provenance["frame_statistics"] = moments  # digit for digit, as an export of the weights needs them
    module.distribution = measure_distribution(
        module.simulator,
        datamodule.train_set,
        symmetry=training.optimisation.symmetry,
        seed=settings["seed"],
        source=module.provenance["manifest_sha256"],
    )
    return module


def material_scale(datamodule: TrajectoryDataModule, number: int) -> torch.Tensor:
    """Return mean and standard deviation of the first K = `number` material features [2, K]; 1 where constant."""
    if not number:
        return torch.empty(2, 0)
    material = torch.cat([constant["material"][:, :number] for constant in datamodule.train_set.constant]).double()
    deviation = material.std(dim=0, correction=0)
    return torch.stack([material.mean(dim=0), torch.where(deviation > 1e-9, deviation, 1.0)]).float()
