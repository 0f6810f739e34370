"""A logger that takes images, as W&B's does, and remembers them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lightning.pytorch.loggers.logger import Logger

LOGGED: list[tuple[str, int, bytes]] = []
"""Key, step and content of every image, of all loggers of this kind."""


class FakeLogger(Logger):
    @property
    def name(self) -> str:
        return "fake"

    @property
    def version(self) -> str:
        return "0"

    def log_metrics(self, metrics: Any, step: int | None = None) -> None:
        pass

    def log_hyperparams(self, params: Any, *args: Any, **kwargs: Any) -> None:
        pass

    def log_image(self, key: str, images: list[str], step: int) -> None:
        LOGGED.extend((key, step, Path(image).read_bytes()) for image in images)
