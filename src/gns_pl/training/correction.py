"""Fits a `Corrector`: fine trajectories are followed by coarse runs, and what these miss is learned.

The examples are kept in memory, and a part of them is made anew now and then by runs that trust the network, which so
learns to lead back from where it goes astray. What counts is not the loss but whole runs: those of the validation split
are made as often, and the weights with which their runouts were nearest to the fine ones are kept.
"""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import lightning
import numpy as np
import torch
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger
from torch import Tensor
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader, IterableDataset

import gns_pl
from gns_pl.errors import InputError
from gns_pl.generation import chosen_every, generate_dataset, is_imported, resolved_data
from gns_pl.io import manifest_sha256, read_manifest, read_trajectory
from gns_pl.io.lock import locked
from gns_pl.metrics.curves import compute_curves
from gns_pl.models.corrector import Corrector, CorrectorConfig, CorrectorFile, save_corrector
from gns_pl.mpm import SimulationError
from gns_pl.nn import in_float32
from gns_pl.rollout import static_of
from gns_pl.scene import fill_scene
from gns_pl.solvers.correction import corrected_run, followed_run
from gns_pl.training.clock import Stopwatch, cost_of
from gns_pl.training.trainer import quieten
from gns_pl.trajectory import Trajectory, start_trajectory

if TYPE_CHECKING:
    from omegaconf import DictConfig

STILL = 0.1
"""A frame in which no point is faster than this part of the velocity scale teaches nothing."""

SHARES = (0.6, 1.0)
"""Of the missing velocity that is given in the runs that are learned from, in turn (`followed_run`)."""

PLACEMENTS = 3
"""Of the particles in every validation column, besides that of its fine run: single runs scatter by some per cent."""

LEAST_RUNOUT = 0.5
"""A fine run that runs out by less, in lengths of its body, is no column."""

DECAY = 0.998
"""Of the moving average of the weights, each step."""

SETTINGS = "correction_settings"

Example = tuple[int, tuple[Tensor, Tensor, Tensor, Tensor]]


class CorrectionModule(lightning.LightningModule):
    """Mean squared error of the velocity, over its root mean square.

    Args:
        corrector: is fitted; its moving average is what is judged and kept.
        fine: trajectories that are followed.
        valid: those of which whole runs are compared.
        learning_rate: the largest; it rises and falls over all steps (Smith 2018).
        num_steps: of the training.
        catch_up: of the runs that are learned from (`followed_run`).
        renewed: part of the runs that is made anew in an epoch.
        jitter: of the placements that are judged (`runout_errors`).

    Attributes:
        settings: in words, of which run its checkpoints are.
    """

    def __init__(
        self,
        corrector: Corrector,
        fine: Sequence[Trajectory],
        valid: Sequence[Trajectory],
        learning_rate: float,
        num_steps: int,
        *,
        catch_up: float,
        renewed: float = 0.0,
        jitter: float = 0.0,
    ) -> None:
        super().__init__()
        self.corrector, self.fine, self.valid = corrector, fine, valid
        self.learning_rate, self.num_steps, self.renewed = learning_rate, num_steps, renewed
        self.jitter, self.catch_up = jitter, catch_up
        self.settings = ""
        self.average = AveragedModel(corrector, avg_fn=moving_average)
        self.examples: list[list[Example]] = [
            make_examples(number, each, corrector, share=SHARES[number % len(SHARES)], catch_up=catch_up)
            for number, each in enumerate(fine)
        ]

    def training_step(self, batch: list[Example]) -> Tensor:
        """Return the loss of some examples."""
        static = static_of(*(self.fine[number] for number, _ in batch))
        before, position, predicted, wanted = (torch.cat([each[k] for _, each in batch]) for k in range(4))
        missed = self.corrector(before, position, predicted, static) - wanted
        loss: Tensor = (missed / self.corrector.correction_scale).square().mean()
        self.log("train/loss", loss)
        return loss

    def optimizer_step(self, *arguments: Any, **settings: Any) -> None:
        """Step, and average."""
        super().optimizer_step(*arguments, **settings)
        self.average.update_parameters(self.corrector)

    @property
    def averaged(self) -> Corrector:
        """The corrector with the moving average of its weights."""
        return cast(Corrector, self.average.module).eval()

    def on_train_epoch_end(self) -> None:
        """Make the validation's runs, and some of those that are learned from anew."""
        errors = runout_errors(self.averaged, self.valid, self.jitter)
        score = float(np.mean(np.abs(errors))) if errors else 0.0
        self.log("valid/runout_error", score)
        said = ", ".join(f"{100 * each:.1f} %" for each in errors)
        loss = float(self.trainer.callback_metrics["train/loss"])
        print(f"step {self.global_step:,} of {self.num_steps:,}: loss {loss:.3f}, runout off by {said}", flush=True)
        draw = np.random.default_rng(self.global_step)
        for number in np.flatnonzero(draw.random(len(self.fine)) < self.renewed).tolist():
            trust = float(draw.random())
            with contextlib.suppress(SimulationError):  # a run that breaks teaches nothing; the one before stays
                self.examples[number] = make_examples(
                    number, self.fine[number], self.averaged, catch_up=self.catch_up, trust=trust
                )

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Store what the run was made with, so that no other goes on with it."""
        checkpoint[SETTINGS] = self.settings

    def configure_optimizers(self) -> Any:
        """Return AdamW with a one-cycle learning rate."""
        optimiser = torch.optim.AdamW(self.corrector.parameters(), lr=self.learning_rate)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, self.learning_rate, self.num_steps + 1)
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}


def moving_average(average: Tensor, now: Tensor, count: Tensor | int) -> Tensor:
    """Return the moving average with one more value; it forgets the first weights faster than later ones."""
    forget = max(1 - DECAY, 9 / (10 + int(count)))
    return average + forget * (now - average)


def runout_errors(corrector: Corrector, fine: Sequence[Trajectory], jitter: float = 0.0) -> list[float]:
    """Return the errors of the final 99 % runout of columns that are run with a corrector, relative.

    Args:
        corrector: corrects.
        fine: what is to be reached; those in which nothing runs out are left out.
        jitter: of the particles' placement, in halves of their spacing; with one, the mean magnitude over `PLACEMENTS`.
    """
    errors = []
    for each in fine:
        wanted = compute_curves(each)["runout_99"][-1]
        if not wanted > LEAST_RUNOUT:
            continue
        starts = [each]
        for seed in range(PLACEMENTS if jitter else 0):
            draw = np.random.default_rng(seed)
            particles = fill_scene(each.scene, corrector.config.spacing, jitter=jitter, generator=draw)
            starts.append(start_trajectory(each.scene, particles, each.dt, {}))
        made = [corrected_run(corrector, start, each.num_frames - 1) for start in starts]
        found = [float(compute_curves(run)["runout_99"][-1] / wanted - 1) for run in made]
        errors.append(found[0] if len(found) == 1 else float(np.abs(found).mean()))
    return errors


def make_examples(
    number: int, fine: Trajectory, corrector: Corrector, *, share: float = 1.0, catch_up: float, trust: float = 0.0
) -> list[Example]:
    """Return what a coarse run misses that follows a fine trajectory, frame by frame; arguments as `followed_run`."""
    run = followed_run(fine, corrector, share=share, catch_up=catch_up, trust=trust)
    return [(number, tuple(map(torch.from_numpy, arrays))) for arrays in run]  # type: ignore[misc]


class Examples(IterableDataset[Example]):
    """An epoch of examples in which something moves, drawn at random from those that the module has at its start.

    Args:
        module: holds them.
        number: of the epoch.
    """

    def __init__(self, module: CorrectionModule, number: int) -> None:
        self.module, self.number = module, number

    def __len__(self) -> int:
        return self.number

    def __iter__(self) -> Iterator[Example]:
        corrector = self.module.corrector
        least = STILL * float(corrector.velocity_scale) * corrector.config.interval
        moving = [
            each for run in self.module.examples for each in run if float((each[1][2] - each[1][1]).abs().max()) > least
        ]
        draw = np.random.default_rng(self.module.global_step + 1)
        for index in draw.integers(0, len(moving), self.number):
            yield moving[index]


def set_scales(corrector: Corrector, examples: Sequence[Example]) -> None:
    """Set the normalisation of a corrector."""
    interval = corrector.config.interval
    corrector.velocity_scale.fill_(rms([(after - now) / interval for _, (_, now, after, _) in examples]))
    corrector.correction_scale.fill_(rms([velocity for _, (*_, velocity) in examples]))


def rms(values: Sequence[Tensor]) -> float:
    """Return the root mean square of all numbers."""
    return math.sqrt(sum(float(each.double().square().sum()) for each in values) / sum(each.numel() for each in values))


def correction_config(cfg: DictConfig) -> Path:
    """Fit as a Hydra config says (conf/correction.yaml)."""
    from hydra.core.hydra_config import HydraConfig
    from omegaconf import OmegaConf

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    settings["data"] = resolved_data(settings["data"])
    if is_imported(settings["data"]):
        raise InputError("correct.py fits what MPM misses of its own finer runs, and these data are imported.")
    return fit_corrector(settings, Path(HydraConfig.get().runtime.output_dir))


def fit_corrector(settings: Mapping[str, Any], output: Path) -> Path:
    """Fit a corrector and write its file.

    A run that was broken off goes on from its last validation; one run works in a folder at a time.

    Args:
        settings: as conf/correction.yaml.
        output: folder; made.

    Returns:
        The corrector's file.

    Raises:
        InputError: settings or data that cannot be used, or a folder that holds a run of others.
    """
    output.mkdir(parents=True, exist_ok=True)
    with locked(output / ".lock", on_wait=lambda: print(f"{output}: another run works here; waiting for it")):
        return _fit(settings, output)


@in_float32
def _fit(settings: Mapping[str, Any], output: Path) -> Path:
    quieten()
    lightning.seed_everything(settings["seed"], verbose=False)
    directory = generate_dataset(settings["data"], device="auto")
    manifest, stride = read_manifest(directory), int(settings["stride"])
    fine = {
        split: [read_trajectory(directory / name).every(stride) for name in manifest.splits[split]]
        for split in ("train", "valid")
    }
    if not fine["train"]:
        raise InputError(f"{directory}: there is nothing to train on.")
    if not any(compute_curves(each)["runout_99"][-1] > LEAST_RUNOUT for each in fine["valid"]):
        raise InputError(
            f"{directory}: no validation trajectory runs out, so none can choose the weights; hold one out."
        )
    config = CorrectorConfig(
        dim=manifest.dim,
        interval=manifest.dt * stride,
        spacing=manifest.spacing,
        mpm=settings["mpm"],
        **settings["model"],
    )
    print(f"{len(fine['train'])} fine trajectories are followed by coarse runs", flush=True)
    number, every, size = (int(settings[key]) for key in ("num_steps", "valid_every", "batch_size"))
    module = CorrectionModule(
        Corrector(config),
        fine["train"],
        fine["valid"],
        float(settings["learning_rate"]),
        number,
        catch_up=float(settings["catch_up"]),
        renewed=float(settings["renewed"]),
        jitter=float(settings["data"]["mpm"]["jitter"]) / chosen_every(settings["data"]),
    )
    module.settings = json.dumps(settings, sort_keys=True)
    for corrector in (module.corrector, module.averaged):
        set_scales(corrector, [each for run in module.examples for each in run])
    data = Examples(module, every * size)
    loader: DataLoader[Example] = DataLoader(data, batch_size=size, collate_fn=list)
    kept: dict[str, Any] = {"save_on_train_epoch_end": True, "enable_version_counter": False}
    best = ModelCheckpoint(output, filename="best", monitor="valid/runout_error", **kept)
    latest = ModelCheckpoint(output, filename="last", **kept)
    clock = Stopwatch()
    trainer = lightning.Trainer(
        accelerator="cpu",
        devices=1,
        max_steps=number,
        callbacks=[best, latest, clock],
        reload_dataloaders_every_n_epochs=1,
        logger=CSVLogger(output, name=None, version="csv"),
        gradient_clip_val=1.0,
        enable_progress_bar=False,
        enable_model_summary=False,
        log_every_n_steps=100,
    )
    parameters = sum(each.numel() for each in module.corrector.parameters())
    print(f"{parameters:,} parameters, {number:,} steps, into {output}", flush=True)
    last = output / "last.ckpt"
    if last.exists():
        made_with = torch.load(last, map_location="cpu", weights_only=True).get(SETTINGS)
        if made_with != module.settings:
            raise InputError(f"{output}: holds a run of other settings; remove it or choose another hydra.run.dir=.")
    trainer.fit(module, loader, ckpt_path=last if last.exists() else None, weights_only=True)
    state = torch.load(best.best_model_path, map_location="cpu", weights_only=True)
    prefix = "average.module."
    weights = {name: value for name, value in state["state_dict"].items() if name.startswith(prefix)}
    corrector = Corrector(config)
    corrector.load_state_dict({name.removeprefix(prefix): value for name, value in weights.items()})
    provenance = {
        "version": gns_pl.__version__,
        "steps": int(state["global_step"]),
        "dataset_sha256": manifest_sha256(directory),
        "description": settings["description"],
        "cost": cost_of(directory, clock.seconds),
    }
    path = output / f"{settings['name']}.corrector"
    save_corrector(path, CorrectorFile(corrector.eval(), dict(settings["data"]), provenance))
    print(f"{path}: the weights of step {state['global_step']:,}, nearest in the validation's runouts")
    return path
