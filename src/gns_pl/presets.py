"""Numbers of the package's own configuration (conf/), for those who use it from Python."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "conf"


@cache
def _loaded(path: Path) -> Any:
    from omegaconf import OmegaConf

    content: Any = OmegaConf.load(path)
    parts = [name for name in content.pop("defaults", []) if name != "_self_"]
    return OmegaConf.merge(*(_loaded(path.parent / f"{name}.yaml") for name in parts), content)


def preset(name: str) -> dict[str, Any]:
    """Return what a file of the configuration holds, as plain values.

    What it takes from the paper's numbers (`${paper.…}`) is filled in.

    Args:
        name: of the file below conf/, without its ending, as "rollout/stable".
    """
    from omegaconf import OmegaConf

    whole = OmegaConf.create({"paper": _loaded(FOLDER / "data" / "_paper.yaml"), "wanted": {}})
    whole.wanted = _loaded(FOLDER / f"{name}.yaml")
    content: dict[str, Any] = OmegaConf.to_container(whole.wanted, resolve=True)  # type: ignore[assignment]
    return content
