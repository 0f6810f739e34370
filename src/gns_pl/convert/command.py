"""convert.py's settings, as conf/convert.yaml has them, taken to the functions that do the work."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl.errors import InputError
from gns_pl.text import command, override

if TYPE_CHECKING:
    from omegaconf import DictConfig

WEIGHTS = (".pt", ".pth")
CHECKPOINT = ".ckpt"
PROGRAMS = (".pt2", ".onnx")


def convert_config(cfg: DictConfig) -> None:
    """Convert, or inspect, as a Hydra config says; what can be refused is refused before anything is read.

    Raises:
        InputError: settings or sources that cannot be used.
    """
    from omegaconf import OmegaConf

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    source, target, inspect = (settings.pop(key) for key in ("source", "target", "inspect"))
    if not source or not (target or inspect):
        raise InputError(
            f"which source and target? {command('convert')} source=FOLDER target=datasets/NAME, or inspect=true"
        )
    settings.pop("sand")
    part = settings.pop("part")
    if not inspect and Path(target).suffix in PROGRAMS:
        _export_program(source, Path(target), part)
        return
    weights, of_files = settings.pop("weights"), {key: settings.pop(key) for key in ("trust", "deck", "lost")}
    if Path(source).suffix in (*WEIGHTS, CHECKPOINT):
        _convert_weights(Path(source), None if inspect else Path(target), settings, weights)
        return
    from gns_pl.convert.convert import convert
    from gns_pl.convert.formats import open_set
    from gns_pl.convert.given import Given
    from gns_pl.convert.inspection import inspect_source
    from gns_pl.convert.recordings import Assumed
    from gns_pl.convert.sets import advised_radius_of
    from gns_pl.io import read_manifest

    named = ("dt", "scale", "gravity", "gravity_axis", "lower", "upper", "spacing", "types", "material_value")
    given = Given(**{key: settings.pop(key) for key in named})
    assumed = Assumed(settings.pop("material"), settings.pop("wall"))
    found = open_set(source, **of_files)
    print(*inspect_source(found, given), sep="\n", flush=True)
    if inspect:
        return
    path = convert(found, target, given=given, assumed=assumed, **settings)
    print(f"Made: {path}")
    if settings["to"] == "gns_pl":
        radius = advised_radius_of(read_manifest(path))
        print(f"To train on it: {command('train')} {override('data', path)} model.connectivity_radius={radius:g}")


def _export_program(source: str, target: Path, part: str) -> None:
    from gns_pl.models.shipped import existing_checkpoint, is_corrector

    if is_corrector(source):
        raise InputError(f"{source}: corrects MPM and makes no step by itself; only simulators are exported.")
    path = existing_checkpoint(source)
    from gns_pl.convert.program import export_program
    from gns_pl.models.checkpoint import load_simulator

    print(f"Made: {export_program(load_simulator(path), target, part=part)}")


def _convert_weights(source: Path, target: Path | None, settings: dict[str, Any], weights: dict[str, Any]) -> None:
    from gns_pl.convert.weights import import_weights, inspect_weights
    from gns_pl.convert.weights_export import export_weights

    if source.suffix == CHECKPOINT:
        if target is None:
            raise InputError("inspect=true looks at data and at weights of others; a checkpoint of ours is known.")
        given = {"data": weights["data"], **{key: settings[key] for key in ("lower", "upper")}}
        print(f"Made: {export_weights(source, target, **given)}")
        return
    given = {key: settings[key] for key in ("scale", "gravity_axis", "spacing", "dt", "name")}
    print(*inspect_weights(source, weights["metadata"]), sep="\n", flush=True)
    if target is not None:
        print(f"Made: {import_weights(source, target, **given, **weights)}")
