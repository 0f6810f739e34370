"""A training of a corrector of coarse MPM from its settings: `python train.py +experiment=corrected_plane`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lightning.pytorch import Trainer

from gns_pl.errors import InputError
from gns_pl.generation import chosen_every, is_imported
from gns_pl.models.corrector import CorrectorConfig, load_corrector, save_corrector
from gns_pl.models.shipped import CORRECTOR
from gns_pl.mpm.settings import solver_config
from gns_pl.training.config import CorrectionConfig
from gns_pl.training.correction import CorrectionModule
from gns_pl.training.followed import FollowedRuns
from gns_pl.training.provenance import provenance
from gns_pl.training.recipe import Recipe


class CorrectorRecipe(Recipe):
    """A corrector of coarse MPM.

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
        if trainer.num_devices * trainer.num_nodes > 1 or trainer.strategy.root_device.type != "cpu":
            raise InputError(
                "a corrector is trained by one process on a CPU: trainer.accelerator=cpu trainer.devices=1"
            )
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

    def export(self, checkpoint: Path, output: Path) -> list[Path]:
        """Write NAME.corrector into the run's folder, and return its path."""
        path = output / f"{self.settings['name']}{CORRECTOR}"
        save_corrector(path, load_corrector(checkpoint))
        return [path]
