"""The LightningDataModule: windows for training, whole trajectories for validation, split by trajectory."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import torch
from lightning.pytorch import LightningDataModule
from torch.utils.data import DataLoader as TorchDataLoader
from torch.utils.data import Dataset
from torch_geometric.loader import DataLoader

from gns_pl.data.places import check_set
from gns_pl.data.sampler import StepSampler
from gns_pl.data.statistics import RunningStatistics, measure_motion
from gns_pl.data.windows import WindowDataset
from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.io import read_header, read_manifest, read_static, read_trajectory
from gns_pl.scene.refusals import SEE_SURFACES, check_bare
from gns_pl.trajectory import Trajectory


class TrajectoryDataset(Dataset[Trajectory | None]):
    """Whole trajectories, read when asked for.

    Args:
        paths: trajectory files; None stands for a slot that is left empty.
        stride: frames of the files in a step.
    """

    def __init__(self, paths: list[Path | None], stride: int) -> None:
        self.paths = paths
        self.stride = stride

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> Trajectory | None:
        path = self.paths[index]
        return None if path is None else read_trajectory(path).every(self.stride)


LOADER_GRACE = 60
"""Seconds that a loader process outlives a SIGTERM."""


def _leave_signals_to_parent(worker: int) -> None:
    """Let a loader process outlive signals, for the process that trains needs its windows for the last step.

    Terminals send Ctrl-C to all processes of a command, batch systems SIGTERM and others. Torch ends loader processes
    without a signal, and by SIGTERM if that fails; so SIGTERM is obeyed, but late.
    """
    for name in ("SIGINT", "SIGUSR1", "SIGUSR2", "SIGXCPU", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: signal.alarm(LOADER_GRACE))  # SIGALRM ends a process


class TrajectoryDataModule(LightningDataModule):
    """Loaders over a dataset folder. Its state is the number of steps made, so that resuming goes on in the order.

    Args:
        directory: folder with a manifest.
        batch_size: windows per step, of all processes together.
        num_steps: training steps in all.
        input_sequence_length: H.
        num_targets: frames behind the history in every window.
        stride: frames of the files in a step.
        start_repeats: how often windows are listed while a trajectory sets out.
        moving_repeats: how often windows are listed in which something moves.
        num_workers: loader processes.
        memory_limit: the training set is kept in memory if its positions take no more than this [bytes].
        num_train: use only the first so many training trajectories; all if None.
        seed: of the order of windows.
        surfaces: the simulator sees surfaces, so that scenes may have obstacles and terrain.

    Raises:
        InputError: more trajectories asked for than there are.
    """

    def __init__(
        self,
        directory: Path,
        *,
        batch_size: int,
        num_steps: int,
        input_sequence_length: int,
        num_targets: int,
        stride: int,
        start_repeats: int,
        moving_repeats: int,
        num_workers: int,
        memory_limit: float,
        num_train: int | None,
        seed: int,
        surfaces: bool = False,
    ) -> None:
        super().__init__()
        self.directory = Path(directory)
        self.manifest = read_manifest(self.directory)
        self.batch_size = batch_size
        self.num_steps = num_steps
        self.input_sequence_length = input_sequence_length
        self.num_targets = num_targets
        self.stride = stride
        self.start_repeats = start_repeats
        self.moving_repeats = moving_repeats
        self.num_workers = num_workers
        self.seed = seed
        self.cell = self.manifest.spacing if surfaces else None
        self._steps_made = 0
        names = self.manifest.splits["train"]
        if num_train is not None and not 0 < num_train <= len(names):
            raise InputError(f"training.num_train is {num_train}, but the set has {len(names)} training trajectories.")
        self.train_names = names[:num_train]
        self.valid_names = self.manifest.splits["valid"]
        files = [self.manifest.files[name] for name in self.train_names]
        self.in_memory = sum(4 * f.num_frames * f.num_particles * self.manifest.dim for f in files) <= memory_limit

    def setup(self, stage: str) -> None:
        """Open the files of the splits."""
        if stage == "fit" and not hasattr(self, "train_set"):
            self.train_set = WindowDataset(
                [self.directory / name for name in self.train_names],
                input_sequence_length=self.input_sequence_length,
                num_targets=self.num_targets,
                stride=self.stride,
                start_repeats=self.start_repeats,
                moving_repeats=self.moving_repeats,
                in_memory=self.in_memory,
                cell=self.cell,
            )

    def check_validation(self) -> None:
        """Open every validation trajectory, and leave out those that are too short for a step, with a sentence.

        Raises:
            InputError: one that is missing, cannot be read or has obstacles; or none that is long enough.
        """
        usable = []
        for name in self.manifest.splits["valid"]:
            path = self.directory / name
            first = read_trajectory(path, num_frames=1)
            if self.cell is None:
                check_bare(f"{path}: its scene", first.scene, cure=SEE_SURFACES)
            if read_header(path).num_frames > self.stride:
                usable.append(name)
        self.valid_names, listed = tuple(usable), self.manifest.splits["valid"]
        short = [name for name in listed if name not in usable]
        if short and not usable:
            raise InputError(
                f"{self.directory}: no validation trajectory has the {self.stride + 1} frames of a step ({short[0]} "
                f"has {self.manifest.files[short[0]].num_frames}); hold longer ones out, or train without a "
                "validation: add trainer.limit_val_batches=0."
            )
        if short:
            print(
                f"{len(short)} of {len(listed)} validation trajectories have fewer than the {self.stride + 1} frames "
                f"of a step and are left out: {', '.join(short[:3])}{' …' if len(short) > 3 else ''}."
            )

    def _processes(self) -> tuple[int, int]:
        """Return the number of this process and how many there are."""
        return (0, 1) if self.trainer is None else (self.trainer.global_rank, self.trainer.world_size)

    def _sampler(self, *, rank: int = 0, num_ranks: int = 1) -> StepSampler:
        return StepSampler(
            num_windows=len(self.train_set),
            batch_size=self.batch_size,
            num_steps=self.num_steps,
            seed=self.seed,
            first_step=self._steps_made,
            rank=rank,
            num_ranks=num_ranks,
        )

    def statistics(self) -> dict[str, RunningStatistics]:
        """Return the velocity's and the acceleration's over the training trajectories, at the step's stride."""
        total = {name: RunningStatistics(self.manifest.dim) for name in ("velocity", "acceleration")}
        for path in (self.directory / name for name in self.train_names):
            static, header = read_static(path), read_header(path)
            moved = static["particle_type"] != int(ParticleType.KINEMATIC)
            measured = measure_motion(path, header, static["initial_velocity"], stride=self.stride, moved=moved)
            for name, seen in measured.items():
                total[name].merge(seen)
        return total

    def check_places(self, radius: float) -> None:
        """Raise an `InputError` for particles outside their boxes, without neighbours, or too far from zero.

        Args:
            radius: connectivity radius of the model [m].
        """
        names = self.train_names, self.manifest.splits["valid"]
        train, valid = ([self.directory / name for name in split] for split in names)
        check_set(train, valid, radius=radius, spacing=self.manifest.spacing)

    def train_dataloader(self) -> DataLoader:
        """Return this process's share of the batches of all steps still to make."""
        rank, ranks = self._processes()
        sampler = self._sampler(rank=rank, num_ranks=ranks)
        return DataLoader(
            self.train_set, batch_sampler=sampler, num_workers=self.num_workers, worker_init_fn=_leave_signals_to_parent
        )

    def val_dataloader(self) -> TorchDataLoader[Trajectory | None]:
        """Return this process's share of the validation trajectories one by one, to be rolled out.

        Rank r of R has r, r + R, …; those that would have one less than others have an empty slot in its place.
        """
        rank, ranks = self._processes()
        paths: list[Path | None] = [self.directory / name for name in self.valid_names]
        paths += [None] * (-len(paths) % ranks)
        return TorchDataLoader(TrajectoryDataset(paths[rank::ranks], self.stride), batch_size=None)

    def windows_of_step(self, step: int) -> list[dict[str, Any]]:
        """Return every window of a step's joined batch, those of all processes, as plain values and tensors."""
        windows = []
        for index, number in self._sampler().joined_batch(step):
            which, frame = self.train_set.index[index]
            tensors = self.train_set[index, number].to_dict()
            windows.append({**tensors, "number": number, "trajectory": self.train_names[which], "frame": frame})
        return windows

    def transfer_batch_to_device(self, batch: Any, device: torch.device, dataloader_idx: int) -> Any:
        """Move windows; trajectories stay NumPy."""
        if batch is None or isinstance(batch, Trajectory):
            return batch
        return super().transfer_batch_to_device(batch, device, dataloader_idx)

    def state_dict(self) -> dict[str, Any]:
        """Return the number of steps made."""
        return {"steps_made": self.trainer.global_step if self.trainer is not None else self._steps_made}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on behind the steps made."""
        self._steps_made = int(state_dict["steps_made"])
