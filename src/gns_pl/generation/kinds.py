"""Kinds of families of scenes: a function that draws one scene, and which of its arguments a family has to give.

A kind of one's own is named as "MODULE.FUNCTION". A new one of the package is an entry of `KINDS`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from gns_pl.errors import InputError
from gns_pl.extensions import imported_function
from gns_pl.generation.spec import FROM_FILES
from gns_pl.scene import (
    Scene,
    sample_block_release,
    sample_column_collapse,
    sample_cube_drop,
    sample_ground_release,
    sample_pair_release,
)

COMMON = ("gravity", "walls", "material", "name")
"""Arguments that every sampler is given, of those that it takes: magnitude [m/s²], face → `Wall`, `Material`, name."""


@dataclass(frozen=True)
class Kind:
    """A kind of family.

    Attributes:
        sampler: (random generator, keywords) → a scene.
        needed: keywords that a family has to give.
        optional: that it may give.
        common: of `COMMON`, those that the sampler takes.
        checked: the needed and optional ones are all that there are.
    """

    sampler: Callable[..., Scene]
    needed: tuple[str, ...]
    optional: tuple[str, ...] = ()
    common: tuple[str, ...] = COMMON
    checked: bool = True


KINDS: dict[str, Kind] = {
    "cube_drop": Kind(sample_cube_drop, ("domain", "side", "speed", "max_drop", "duration")),
    "block_release": Kind(sample_block_release, ("domain", "length", "aspect_ratio", "at_wall", "duration")),
    "column_collapse": Kind(sample_column_collapse, ("domain", "length", "aspect_ratio", "duration_tau")),
    "ground_release": Kind(
        sample_ground_release,
        ("domain", "length", "height", "duration", "incline_deg", "friction"),
        ("hill", "step", "barrier", "curve", "layer", "far_incline_deg"),
    ),
    "pair_release": Kind(sample_pair_release, ("domain", "length", "aspect_ratio", "at_wall", "speed", "duration")),
}
"""Name → kind."""


def find_kind(owner: str, name: str) -> Kind:
    """Return a kind by its name, or by "MODULE.FUNCTION" with the function's keywords as what a family gives.

    Args:
        owner: the family, for messages.
        name: of the kind.

    Raises:
        InputError: there is none.
    """
    if name in KINDS:
        return KINDS[name]
    if "." not in str(name):
        kinds = ", ".join([*KINDS, FROM_FILES])
        raise InputError(
            f"{owner}: there is no kind {name!r} of scenes; known are {kinds}, and MODULE.FUNCTION of your own."
        )
    function = imported_function(name, f"{owner}: kind", list(KINDS))
    generator, *parameters = inspect.signature(function).parameters.values() or (None,)
    if generator is None or generator.kind not in (
        inspect.Parameter.POSITIONAL_ONLY,
        inspect.Parameter.POSITIONAL_OR_KEYWORD,
    ):
        raise InputError(f"{owner}: {name} must take a random generator first, as sampler(generator, *, …).")
    catches = any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in parameters)
    named = [parameter for parameter in parameters if parameter.kind is not inspect.Parameter.VAR_KEYWORD]
    own = [parameter for parameter in named if parameter.name not in COMMON]
    return Kind(
        partial(_drawn, function, owner, name),
        needed=tuple(parameter.name for parameter in own if parameter.default is inspect.Parameter.empty),
        optional=tuple(parameter.name for parameter in own if parameter.default is not inspect.Parameter.empty),
        common=COMMON if catches else tuple(parameter.name for parameter in named if parameter.name in COMMON),
        checked=not catches,
    )


def _drawn(function: Callable[..., object], owner: str, name: str, /, *arguments: object, **keywords: object) -> Scene:
    try:
        scene = function(*arguments, **keywords)
    except TypeError as error:
        raise InputError(f"{owner}: {name}: {error}.") from error
    if not isinstance(scene, Scene):
        raise InputError(f"{owner}: {name} must return a Scene, not {type(scene).__name__}.")
    return scene
