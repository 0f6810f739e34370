"""`benchmark.py`: measure what is missing, draw, say it, and hand records to the choice."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl.errors import InputError
from gns_pl.evaluation.scenes import build_scenes
from gns_pl.text import command, override

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from gns_pl.scene import Scene

PLAN, RECORDS = "plan.json", "records.csv"


def benchmark_config(cfg: DictConfig) -> list[Path]:
    """Chart as a Hydra config says (conf/benchmark.yaml); what can be refused is refused before anything is measured.

    Returns:
        The files made.
    """
    from omegaconf import OmegaConf

    from gns_pl.evaluation.checks import check_figures, named_checkpoints
    from gns_pl.models.shipped import is_corrector

    settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    check_figures(without=".")
    evaluation, logger, paper, side_walls, out = (
        settings.pop(key) for key in ("evaluation", "logger", "paper", "side_walls", "out")
    )
    logger = logger if logger.pop("enabled") else None
    given = {key: settings.pop(key) for key in ("records", "publish")}
    if settings.pop("from_table"):
        return finish(Path(out), logger=logger, **given)
    ckpt = settings["ckpt"] or []
    settings["ckpt"] = [ckpt] if isinstance(ckpt, str) else ckpt
    learned = [each for each in settings["ckpt"] if not is_corrector(each)]
    if learned:
        named_checkpoints(learned)  # refuses one that is not there before anything heavy is imported
    for key in ("placements", "threads"):
        value = settings[key]
        if not (key == "threads" and value is None) and (not isinstance(value, int) or value < 1):
            raise InputError(f"{key} must be a whole number of at least 1, not {value!r}.")
    data = {**paper, "walls": {**paper["walls"], **({"y-": side_walls, "y+": side_walls} if side_walls else {})}}
    scenes = build_scenes(
        evaluation["columns"],
        evaluation["scenes"],
        only=evaluation["only"],
        domain=evaluation["domain"],
        duration=evaluation["duration"],
        interval=settings["frame_interval"],
        data=data,
    )
    settings["law"]["data"], settings["cache"] = data, Path(settings["cache"])
    return chart(list(scenes.values()), out=Path(out), logger=logger, **given, **settings)


def chart(
    scenes: Sequence[Scene],
    *,
    out: Path,
    records: str | Path | None = None,
    publish: str | Path | None = None,
    logger: Mapping[str, Any] | None = None,
    **settings: Any,
) -> list[Path]:
    """Measure what the tables in `out` lack and chart it; a killed run goes on, row by row.

    Args:
        scenes: on which all settings are run.
        out: folder of the tables and of what is made of them.
        records: as `finish`, like the next two.
        publish: likewise.
        logger: likewise.
        settings: as of `measure.measure`.

    Returns:
        The files made.

    Raises:
        InputError: settings that cannot be used.
        StorageError: the disk refuses.
    """
    from gns_pl.evaluation.chart.measure import measure
    from gns_pl.evaluation.chart.tables import Tables
    from gns_pl.generation.records import make_folder
    from gns_pl.io.lock import locked

    make_folder(out)
    with locked(out / ".benchmark.lock", on_wait=lambda: print(f"{out}: another run measures here; waiting for it")):
        measure(scenes, Tables(out), out / PLAN, **settings)
        return finish(out, records=records, publish=publish, logger=logger)


def finish(
    out: Path, *, records: str | Path | None, publish: str | Path | None, logger: Mapping[str, Any] | None
) -> list[Path]:
    """Draw and write what the tables and the plan in a folder hold; nothing is measured.

    Args:
        out: the folder.
        records: a table of `simulate.py`'s choice into which the runs go; None for `out`/records.csv alone.
        publish: folder into which page, table and figure are copied; None for none.
        logger: {offline, project} of W&B; None logs nothing.

    Returns:
        The files made.

    Raises:
        InputError: nothing was measured there.
    """
    from gns_pl.evaluation.chart.plan import read_plan
    from gns_pl.evaluation.chart.tables import Tables

    plan, tables = read_plan(out / PLAN), Tables(out)  # refused before anything heavy is imported
    from gns_pl.evaluation.chart.draw import DETAILS, FIGURES, PAGE, POINTS, draw
    from gns_pl.evaluation.chart.records import records_of, write_records

    made = draw(plan, tables, out, logger=logger)
    selectable = {entry.name for entry in plan.entries if entry.for_choice}
    setups = {each.judged: each.setup for each in plan.scenes}
    found = records_of((row for row in plan.runs(tables.runs) if row.name in selectable), setups)
    for path in (out / RECORDS, *([Path(records)] if records else [])):
        number = write_records(path, found)
        goes_by = override("choice.records", path)
        print(f"{path}: {number} records; {command('simulate')} … tolerance=… {goes_by} goes by them")
        made.append(path)
    if publish:
        Path(publish).mkdir(parents=True, exist_ok=True)
        names = (PAGE, POINTS, *FIGURES, *DETAILS)
        made += [Path(shutil.copyfile(out / name, Path(publish) / name)) for name in names]
    print("Made:", *made, sep="\n  ")
    return made
