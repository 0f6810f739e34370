"""Trainings of correctors of coarse MPM from their settings: experiments `corrected` and `corrected_plane`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lightning.pytorch import Trainer

from gns_pl.errors import InputError
from gns_pl.generation import chosen_every, find_dataset, is_imported, resolved_data
from gns_pl.models.corrector import CorrectorConfig, load_corrector, save_corrector
from gns_pl.models.shipped import CORRECTOR
from gns_pl.mpm.settings import solver_config
from gns_pl.solvers.fitted_files import read_fitted
from gns_pl.solvers.retuned import RetunedMPMSolver
from gns_pl.training.config import CorrectedRunsConfig, CorrectionConfig
from gns_pl.training.corrected_runs import CorrectedRunsModule, FineRuns, velocity_scale
from gns_pl.training.correction import CorrectionModule
from gns_pl.training.followed import FollowedRuns
from gns_pl.training.provenance import provenance
from gns_pl.training.recipe import Recipe


class ExportedRecipe(Recipe):
    """What recipes of correctors share.

    Attributes:
        settings: the resolved config.
    """

    settings: Mapping[str, Any]

    def check_process(self, trainer: Trainer) -> None:
        """Raise an `InputError` for several processes or another device than a CPU."""
        if trainer.num_devices * trainer.num_nodes > 1 or trainer.strategy.root_device.type != "cpu":
            raise InputError(
                "a corrector is trained by one process on a CPU: trainer.accelerator=cpu trainer.devices=1"
            )

    def export(self, checkpoint: Path, output: Path) -> list[Path]:
        """Write NAME.corrector into the run's folder, and return its path."""
        path = output / f"{self.settings['name']}{CORRECTOR}"
        save_corrector(path, load_corrector(checkpoint))
        return [path]


class CorrectorRecipe(ExportedRecipe):
    """A corrector of coarse MPM, taught by the velocities that its runs miss.

    Args:
        settings: the resolved config.

    Raises:
        InputError: a setting that no data could make valid.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.settings = settings
        self.training = CorrectionConfig.from_dict(settings["training"])
        self.num_steps, self.batch_size = self.training.num_steps, self.training.batch_size
        if settings["ckpt"] is not None:
            raise InputError("a corrector begins with random weights; leave ckpt out.")
        if is_imported(settings["data"]):
            raise InputError(
                "model=corrector learns what MPM misses of its own finer runs, and these data are imported."
            )
        model = {key: value for key, value in settings["model"].items() if key != "kind"}
        self.model = {**model, "mpm": {**settings["data"]["mpm"], **model["mpm"]}}
        CorrectorConfig.from_dict({**self.model, "dim": 2, "interval": 1.0, "spacing": 1e-9})
        solver_config(self.model["mpm"])

    def build(self, directory: Path, trainer: Trainer) -> tuple[CorrectionModule, FollowedRuns]:
        """Return module and data module, whose first runs are made."""
        self.check_process(trainer)
        datamodule = FollowedRuns(directory, self.training, self.settings["seed"])
        if trainer.limit_val_batches:
            datamodule.check_validation()
        manifest, data = datamodule.manifest, self.settings["data"]
        of_data = {"dim": manifest.dim, "interval": manifest.dt * self.training.stride, "spacing": manifest.spacing}
        module = CorrectionModule(
            model=asdict(CorrectorConfig.from_dict({**self.model, **of_data})),
            data=data,
            learning_rate=self.training.learning_rate,
            num_steps=self.training.num_steps,
            placement_jitter=float(data["mpm"]["jitter"]) / chosen_every(data),
            provenance=provenance(self.settings, directory),
        )
        print(f"{len(datamodule.train_names)} fine trajectories are followed by coarse runs", flush=True)
        datamodule.follow(module.corrector)
        return module, datamodule


class RetunedCorrectorRecipe(ExportedRecipe):
    """A corrector of retuned coarse MPM, trained on whole runs.

    Args:
        settings: the resolved config. `also` is the specification of a second data set, if there is one.

    Raises:
        InputError: a setting that no data could make valid.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self.settings = settings
        self.training = CorrectedRunsConfig.from_dict(settings["training"])
        self.num_steps, self.batch_size = self.training.num_steps, self.training.scenes
        if settings["ckpt"] is not None:
            raise InputError("a corrector begins with random weights; leave ckpt out.")
        self.data = [settings["data"], *([resolved_data(settings["also"])] if settings.get("also") else [])]
        if any(map(is_imported, self.data)):
            raise InputError("model=corrector_retuned runs scenes by MPM, and imported data have none that it knows.")
        model = {key: value for key, value in settings["model"].items() if key != "kind"}
        coarse = read_fitted(model["coarse"])
        if not isinstance(coarse, RetunedMPMSolver):
            raise InputError(f"model.coarse={model['coarse']} is no retuned MPM, such as mpm-retuned-5.")
        scalars = {"cells": coarse.cells, "factors": dict(vars(coarse.factors))}
        self.model = {**model, "spacing": 1.0, "coarse": scalars, "mpm": dict(coarse.settings)}
        CorrectorConfig.from_dict({**self.model, "dim": 3, "interval": 1.0})

    def build(self, directory: Path, trainer: Trainer) -> tuple[CorrectedRunsModule, FineRuns]:
        """Return module and data module, the second data set generated where it is missing."""
        self.check_process(trainer)
        directories = [directory, *(find_dataset(data, progress=True) for data in self.data[1:])]
        datamodule = FineRuns(directories, self.training, self.settings["seed"])
        manifest = datamodule.manifest
        of_data = {"dim": manifest.dim, "interval": manifest.dt * self.training.stride}
        families = {name: family for data in self.data for name, family in data["families"].items()}
        module = CorrectedRunsModule(
            model=asdict(CorrectorConfig.from_dict({**self.model, **of_data})),
            data={**self.settings["data"], "families": families},
            training=asdict(self.training),
            seed=self.settings["seed"],
            provenance=provenance(self.settings, directory),
        )
        module.corrector.velocity_scale.fill_(velocity_scale(datamodule.train_set))
        return module, datamodule
