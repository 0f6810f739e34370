"""What a training ends with: summary.json for programs (sweeps read it), the same in words, and the learning curve."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning.pytorch import Trainer

from gns_pl.data.datamodule import TrajectoryDataModule
from gns_pl.errors import tolerated
from gns_pl.io.atomic import write_atomically
from gns_pl.text import without_nan
from gns_pl.training.callbacks import SkipNonFinite
from gns_pl.training.checkpoints import LAST, BestCheckpoint, best_checkpoint
from gns_pl.training.clock import Clock
from gns_pl.training.history import PREFIX, Floats, History, read_history
from gns_pl.training.learning import LearningModule
from gns_pl.training.loggers import log_image
from gns_pl.training.module import SimulatorModule
from gns_pl.training.progress import validation_values
from gns_pl.training.summary import FORMAT, FORMAT_VERSION, SUMMARY_FILE, headline, summary_lines
from gns_pl.training.validation import MONITORED
from gns_pl.viz import missing_packages, plot_learning_curve

CURVE_FILE = "learning_curve.png"


def close_run(
    output: Path,
    trainer: Trainer,
    module: LearningModule,
    datamodule: TrajectoryDataModule,
    exported: Sequence[Path] = (),
) -> None:
    """Write summary.json and learning_curve.png into the run's folder, log the figure, and print the summary.

    It is called however the fit ended, and does nothing if that was before the first step.

    Args:
        output: folder of the run.
        trainer: after the fit.
        module: what was trained.
        datamodule: what it was trained on.
        exported: what was made of the best checkpoint, and is used in its place.
    """
    if not trainer.is_global_zero or trainer.global_step == 0:
        return
    for logger in trainer.loggers:
        with tolerated(f"the file of {type(logger).__name__}"):
            logger.save()
    history = read_history(output)
    summary = summarise_run(history, output=output, trainer=trainer, module=module, datamodule=datamodule)
    if exported:
        summary["checkpoint"] = str(exported[0])
    content = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    write_atomically(output / SUMMARY_FILE, content.encode())
    if missing_packages():
        print(f"No {CURVE_FILE}: it needs {' and '.join(missing_packages())} (pip install 'gns_pl[viz]').")
    elif len(history.training["step"]):
        with tolerated(CURVE_FILE):
            title = f"{summary['name']}: {headline(summary)}"
            plot_learning_curve(history.training, history.validation, output / CURVE_FILE, title=title)
            log_image(trainer.loggers, "learning_curve", output / CURVE_FILE, trainer.global_step)
    print("", *summary_lines(summary), sep="\n", flush=True)


def summarise_run(
    history: History, *, output: Path, trainer: Trainer, module: LearningModule, datamodule: TrajectoryDataModule
) -> dict[str, Any]:
    """Return the content of summary.json: plain values in SI units, None for what is not known.

    `wall_seconds` is the time of the fit with validations and checkpoints, over all starts that led here; making the
    data is not in it. Times of a step are medians of what the history holds. `best` and `final` are the validations
    with the least of the error that chooses the best checkpoint (`monitor`), and the last one.

    Args:
        history: of the run, all its starts.
        output: folder of the run.
        trainer: after the fit.
        module: what was trained.
        datamodule: what it was trained on.
    """
    settings, monitor = module.provenance["config"], monitored(trainer)
    clocks = [callback for callback in trainer.callbacks if isinstance(callback, Clock)]  # type: ignore[attr-defined]
    steps, planned = trainer.global_step, datamodule.num_steps
    best, final = _validation(history, best_validation(history, monitor)), _validation(history, -1)
    if not history.num_starts:  # nothing was logged
        best, final = unlogged_validations(trainer)
    summary = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "name": settings["name"],
        "description": settings["description"],
        "status": "finished" if steps >= planned else "stopped",
        "steps": steps,
        "num_steps": planned,
        "num_starts": history.num_starts,
        "wall_seconds": clocks[0].seconds if clocks else None,
        "data": {
            "name": settings["data"]["name"],
            "num_train": len(datamodule.train_names),
            "num_valid": len(datamodule.valid_names),
            "num_windows": len(datamodule.train_set),
        },
        "batch_size": datamodule.batch_size,
        "num_parameters": sum(parameter.numel() for parameter in module.parameters()),
        "device": str(trainer.strategy.root_device),
        "num_threads": torch.get_num_threads(),
        "step_seconds": _median(history.training["step_seconds"]),
        "windows_per_s": _median(history.training["windows_per_s"]),
        "rollout_step_seconds": _median(history.validation.get("rollout_step_seconds", np.empty(0))),
        **whole_runs(trainer, module, history),
        "monitor": monitor,
        "best": best,
        "final": final,
        "checkpoint": str(best_checkpoint(trainer) or output / LAST),
    }
    plain: dict[str, Any] = without_nan(summary)
    return plain


def whole_runs(trainer: Trainer, module: LearningModule, history: History) -> dict[str, dict[str, Any]]:
    """Return "rollouts" of the steps that made whole runs: their number, time and how many of them were left out."""
    if not isinstance(module, SimulatorModule) or trainer.global_step <= module.first_rollout:
        return {}
    skips = [each.skipped for each in trainer.callbacks if isinstance(each, SkipNonFinite)]  # type: ignore[attr-defined]
    late = history.training["step"] > module.first_rollout
    seconds = _median(history.training["step_seconds"][late])
    number = trainer.global_step - module.first_rollout
    return {"rollouts": {"num_steps": number, "step_seconds": seconds, "skipped": sum(skips)}}


def unlogged_validations(trainer: Trainer) -> tuple[dict[str, float] | None, dict[str, float] | None]:
    """Return what callbacks know of the best validation and of the last one; None where there was none."""
    final: dict[str, float] | None = validation_values(trainer) or None
    if final is not None:
        final["step"] = trainer.global_step
    for callback in trainer.callbacks:  # type: ignore[attr-defined]
        if isinstance(callback, BestCheckpoint) and callback.least is not None and callback.step is not None:
            return {"step": callback.step, monitored(trainer): callback.least}, final
    return None, final


def monitored(trainer: Trainer) -> str:
    """Return the name of the error by which the best checkpoint is chosen, without its prefix."""
    callbacks = [each for each in trainer.callbacks if isinstance(each, BestCheckpoint)]  # type: ignore[attr-defined]
    return callbacks[0].monitor.removeprefix(PREFIX) if callbacks else MONITORED


def best_validation(history: History, monitor: str = MONITORED) -> int | None:
    """Return the place of the validation with the least error of a name, None if there is none."""
    errors = history.validation.get(monitor, np.empty(0))
    return int(np.nanargmin(errors)) if np.isfinite(errors).any() else None


def _validation(history: History, place: int | None) -> dict[str, float] | None:
    if place is None or not len(history.validation["step"]):
        return None
    values = {name: float(column[place]) for name, column in history.validation.items()}
    return values | {"step": int(values["step"])}


def _median(values: Floats) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else math.nan


def run_files(output: Path) -> list[Path]:
    """Return the paths of what `close_run` leaves in a run's folder."""
    return [output / SUMMARY_FILE, output / CURVE_FILE]
