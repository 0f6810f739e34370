"""References in files of some KB: what is compared of the finest runs, without the runs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

import gns_pl
from gns_pl.errors import InputError
from gns_pl.evaluation.chart.observed import Observed
from gns_pl.io.atomic import write_atomically

SHIPPED = Path(__file__).parent / "references"
"""Those of the package's scene sets."""

FORMAT, FORMAT_VERSION, DIGITS = "gns_pl reference", 1, 6


def write_kept(path: Path, observed: Observed, facts: Mapping[str, Any]) -> None:
    """Write a reference as JSON, whole or not at all.

    Args:
        path: the file.
        observed: what is compared, written with `DIGITS` significant digits.
        facts: plain values besides.

    Raises:
        StorageError: the disk refuses.
    """
    arrays = {each.name: _rounded(getattr(observed, each.name)) for each in fields(Observed)}
    head = {"format": FORMAT, "format_version": FORMAT_VERSION, "gns_pl": gns_pl.__version__}
    lines = [
        f" {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}"
        for key, value in (head | dict(facts) | arrays).items()
    ]
    write_atomically(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


def read_kept(path: Path, names: Sequence[str]) -> tuple[Observed, dict[str, Any]]:
    """Read a reference, and some of its facts.

    Raises:
        InputError: another file.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if (content["format"], content["format_version"]) != (FORMAT, FORMAT_VERSION):
            raise ValueError("another format")
        arrays = {each.name: np.array(content[each.name]) for each in fields(Observed) if each.name != "arrest"}
        return Observed(arrest=float(content["arrest"]), **arrays), {name: content[name] for name in names}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: is no reference of benchmark.py ({error}); remove it.") from error


def _rounded(values: Any) -> Any:
    if np.ndim(values):
        return [_rounded(value) for value in values]
    return float(f"{float(values):.{DIGITS}g}")
