"""The keys and the kinds of values that a config may have: those of the command's own files in conf/.

Hydra takes `+key=value` for any key, and any value for a key. A config is therefore compared with the one that the
chosen options of its groups give, without what was typed and without experiments.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any

from hydra import compose
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from gns_pl.errors import InputError
from gns_pl.text import did_you_mean

OPEN = (
    *(
        "data.families",
        "data.walls",
        "data.mpm",
        "data.material",
        "data.store_every",
        "data.every",
        "data.sampling",
        "data.root",
    ),
    *("model", "changes", "ensemble.vary", "catalogue", "evaluation.columns", "evaluation.stress.mpm"),
    *(
        "evaluation.stress.variants",
        "evaluation.stress.sand",
        "choice.hybrid",
        "choice.shallow",
        "choice.mpm",
        "costs",
        "variants",
    ),
    *("side_walls", "wall", "material", "types", "sand", "paper", "mpm", "scenes"),
)
"""Where keys may be added, left out and be null; what reads them checks them."""

UNTYPED = ("trainer", "callbacks", "logger", "hydra")
"""Arguments of other packages, which check them."""

EMPTY = (
    *("stabilise", "acceleration", "side_walls", "choice.hybrid", "costs", "types", "ckpt", "batches.sizes"),
    *("evaluation.spread", "evaluation.snapshots", "evaluation.columns.*", "evaluation.stress.variants.*"),
)
"""Lists and mappings that may be null."""

NUMBERS = (
    *("tolerance", "duration", "dt", "scale", "spacing", "threads", "num_workers", "training.num_train"),
    *("training.optimisation.huber_delta", "reporting.reached", "evaluation.reached", "ensemble.grid"),
)
TEXTS = (
    *(
        "solver",
        "start",
        "out",
        "choice.records",
        "records",
        "publish",
        "source",
        "target",
        "deck",
        "data.root",
        "resume",
    ),
    *("weights.metadata", "weights.data", "weights.edge_update", "evaluation.split"),
    *("evaluation.film", "evaluation.stress.label"),
)
SEVERAL = (
    "ckpt",
    "scene",
    "sets",
    *(f"evaluation.{name}" for name in ("scenes", "only", "start", "stress.only", "stress.axes")),
)
KINDS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(NUMBERS, ("number",)),
    **dict.fromkeys(TEXTS, ("text",)),
    **dict.fromkeys(SEVERAL, ("text", "list")),
    **dict.fromkeys(("lower", "upper", "evaluation.stress.shown", "model.material_features"), ("list",)),
    **dict.fromkeys(("name", "description", "gravity_axis"), ("text", "number")),
    "choice.frame_interval": ("number",),
    "model.network": ("text", "mapping"),
    "threads": ("number", "list"),
    "types": ("mapping",),
}
"""Kinds of values of keys that are null unless somebody sets them, and of words that may look like a number."""

MPM = ("", "choice.", "data.", "evaluation.stress.")
"""Owners of settings of the material point method."""

WHOLE = {
    **dict.fromkeys(("seed", "data.seed", "evaluation.seed", "evaluation.stress.seed", "evaluation.placements"), 0),
    **dict.fromkeys(("num_workers", "placements", "budget", "ensemble.members"), 1),
    "ensemble.grid": 2,
    **dict.fromkeys(("batches.turns", "valid", "test"), 0),
    **dict.fromkeys((f"{owner}mpm.points_per_direction" for owner in MPM), 1),
}
"""Keys of whole numbers, and the smallest."""

POSITIVE = (
    *(f"{owner}mpm.{name}" for owner in MPM for name in ("courant", "cell_size")),
    *("frame_interval", "choice.frame_interval", "evaluation.duration", "evaluation.stress.interval"),
    *("cells", "difference", "duration_tau", "fine.cells_per_metre", "fine.interval"),
)
"""Keys of numbers above zero."""

LARGEST = 2**32 - 1
"""Whole number that a key may have, as seeds of torch and NumPy."""

WORDS = {
    "flag": "true or false",
    "number": "a number",
    "text": "text",
    "list": "a list, as [a,b]",
    "mapping": "a mapping of names to values, as {a:1}",
    "null": "null",
}


def check_known(cfg: DictConfig) -> None:
    """Raise an `InputError` for a key that the command does not have or lacks, and for a value of another kind.

    Args:
        cfg: the config of the job that is running.
    """
    hydra = HydraConfig.get()
    if not GlobalHydra.instance().is_initialized():  # a worker process, whose config the first process has checked
        return
    base = compose(str(hydra.job.config_name), list(base_overrides(hydra.runtime.choices, hydra.overrides.hydra)))
    for name in map(str, cfg):
        if name not in base:
            raise unknown_key(name, base)
    for name in map(str, base):
        if name in cfg:
            check_value(name, plain(cfg, name), plain(base, name), base)
        elif name not in (*OPEN, *UNTYPED):
            raise InputError(f"{name}: it cannot be left out.")


def base_overrides(choices: Mapping[str, Any], hydra: list[str]) -> Iterator[str]:
    """Return the overrides that give the config of a command without what was typed and without experiments."""
    for group, option in choices.items():
        own = "@" not in group and not group.startswith("hydra/") and group not in ("experiment", "sweep")
        if own and isinstance(option, str):
            yield f"{group}={option}"
    yield from (each for each in hydra if each.lstrip("+").startswith("hydra.searchpath"))


def plain(cfg: DictConfig, key: str) -> Any:
    """Return a part of a config as plain values, with what it refers to."""
    value = cfg[key]
    return OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value


def check_value(key: str, value: Any, usual: Any, base: DictConfig) -> None:
    """Raise an `InputError` unless a value is of the kind of the usual one and has its keys; parts likewise."""
    if key in UNTYPED:
        return
    is_open = any(key == each or key.startswith(f"{each}.") for each in OPEN)
    kinds = KINDS.get(key, () if usual is None else (kind_of(usual),))
    if usual is None or any(fnmatchcase(key, each) for each in EMPTY):
        kinds = (*kinds, "null") if kinds else ()
    if kinds and kind_of(value) not in kinds:
        raise InputError(f"{key} must be {' or '.join(WORDS[kind] for kind in kinds)}, not {shown(value)}.")
    if key in WHOLE and value is not None and (not isinstance(value, int) or not WHOLE[key] <= value <= LARGEST):
        raise InputError(f"{key} must be a whole number of at least {WHOLE[key]}, not {value}.")
    if key in POSITIVE and value is not None and not value > 0:
        raise InputError(f"{key} must be above 0, not {value}.")
    if isinstance(usual, Mapping) and isinstance(value, Mapping):
        for name in value:
            if name in usual:
                check_value(f"{key}.{name}", value[name], usual[name], base)
            elif not is_open and f"{key}.{name}" not in OPEN:
                raise unknown_key(f"{key}.{name}", base)
        for name in usual:
            if name not in value and not is_open and f"{key}.{name}" not in OPEN:
                raise InputError(f"{key}.{name}: it cannot be left out.")
    if isinstance(usual, list) and isinstance(value, list) and usual and not isinstance(usual[0], Mapping):
        for each in value:
            if kind_of(each) != kind_of(usual[0]):
                raise InputError(
                    f"{key} must be a list of {WORDS[kind_of(usual[0])].removeprefix('a ')}s, not {shown(value)}."
                )


def kind_of(value: Any) -> str:
    """Return the kind of a plain value, one of `WORDS`."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "flag"
    kinds: tuple[tuple[str, Any], ...] = (("number", int | float), ("text", str), ("mapping", Mapping), ("list", list))
    return next((kind for kind, types in kinds if isinstance(value, types)), type(value).__name__)


def shown(value: Any) -> str:
    """Return a value as it is typed."""
    return {"null": "null", "flag": str(value).lower()}.get(kind_of(value), repr(value))


def unknown_key(key: str, base: DictConfig) -> InputError:
    """Return the error for a key that a command does not have, with the one that may have been meant."""
    owner, name = _name_with_dot(key, base)
    if name:
        return InputError(
            f"{key}: the name {name} has a dot in it, a step down for a command line; give it as a mapping, as "
            f"'{owner}={{{name}:{{…}}}}', which leaves the others as they are."
        )
    meant = did_you_mean(key, all_keys(base), dotted=True)
    new = any(key.startswith(f"{each}.") for each in (*OPEN, *UNTYPED))
    added = f"; a new one is added by a + before it: +{key}=…" if new else ""
    return InputError(f"there is no key {key}{meant}{added or ('.' if meant else _siblings(key, base))}")


def _name_with_dot(key: str, base: DictConfig) -> tuple[str, str]:
    """Return the first name with a dot in it on the way to a key, and the key of what holds it; else empty texts."""
    content: Any = OmegaConf.to_container(base, resolve=False)
    owner = ""
    while isinstance(content, Mapping):
        rest = key[len(owner) + 1 :] if owner else key
        name = max((str(each) for each in content if f"{rest}.".startswith(f"{each}.")), key=len, default="")
        if not name or "." in name:
            return owner, name
        owner, content = f"{owner}.{name}" if owner else name, content[name]
    return "", ""


def all_keys(base: DictConfig) -> list[str]:
    """Return all keys of a config that a user can type, dotted."""

    def walk(value: Mapping[str, Any], prefix: str) -> Iterator[str]:
        for name, inner in value.items():
            yield f"{prefix}{name}"
            if isinstance(inner, Mapping):
                yield from walk(inner, f"{prefix}{name}.")

    content: Any = OmegaConf.to_container(base, resolve=False)
    keys = list(walk(content, ""))
    scenes = [key.split(".", 2)[2] for key in keys if key.startswith("catalogue.") and key.count(".") > 1]
    typed = [key for key in keys if key.split(".")[0] not in ("changes", "catalogue", "hydra", "paper", "sand")]
    return [*typed, *(f"scene.{key}" for key in scenes)]


def _siblings(key: str, base: DictConfig) -> str:
    owner, _, _ = key.rpartition(".")
    depth = key.count(".")
    near = [
        each for each in all_keys(base) if each.count(".") == depth and each.startswith(f"{owner}." if owner else "")
    ]
    return f"; there are {', '.join(each.rpartition('.')[2] for each in near)}." if near else "."
