"""What the one material value of others' particles means: tan φ, φ in degrees or radians, or a share of it.

The sets of geoelements/gns have a third array that says nothing of itself, and their authors' hold tan φ in some and
φ/70 in others; between 0.3 and 0.7 the two cannot be told apart. It is asked for, and never guessed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.fields import MATERIAL_FEATURES

METADATA_KEY = "material_property"
"""In a metadata.json of ours for others: the feature that the material value is."""
_SHARE = re.compile(r"phi/(\d+(?:\.\d+)?)")
MEANINGS = "tan, degrees, radians, phi/70 (of degrees, or another number) or none (to leave it out)"


def check_material_value(meaning: object) -> None:
    """Check a user's `material_value`.

    Raises:
        InputError: another one than there is.
    """
    share = _SHARE.fullmatch(str(meaning))
    if meaning not in ("tan", "degrees", "radians", "none") and not (share and float(share[1]) > 0):
        raise InputError(f"material_value must be one of {MEANINGS}, not {meaning!r}.")


def stated_meaning(metadata: Mapping[str, Any]) -> str | None:
    """Return the `material_value` that a metadata.json states; None if it does not."""
    return "tan" if metadata.get(METADATA_KEY) == MATERIAL_FEATURES[0] else None


def material_question(lowest: float, highest: float) -> str:
    """Return the sentence that asks for the meaning of values of this range."""
    values = f"{lowest:.4g}" if lowest == highest else f"{lowest:.4g} to {highest:.4g}"
    return f"what the material value of the particles, {values}, means is not stated: give material_value={MEANINGS}"


def tangents(values: NDArray[np.float32], meaning: str) -> NDArray[np.float32]:
    """Return material values as tan φ.

    Args:
        values: of any shape.
        meaning: as `Given.material_value`, but "none".

    Raises:
        InputError: values that are no angles of friction in this meaning.
    """
    if meaning == "tan":
        if (values < 0).any():
            raise InputError(f"a material value of {values.min():g} is no tan φ; give another material_value=.")
        return values
    share = _SHARE.fullmatch(meaning)
    unit = np.pi / 180 * float(share[1]) if share else {"degrees": np.pi / 180, "radians": 1.0}[meaning]
    angle = values.astype(np.float64) * unit
    wrong = values[(angle < 0) | (angle >= np.pi / 2)]
    if len(wrong):
        degrees = np.degrees(float(wrong[0]) * unit)
        raise InputError(
            f"a material value of {wrong[0]:g} would be φ = {degrees:.4g}° with material_value={meaning}; give another."
        )
    return np.tan(angle).astype(np.float32)
