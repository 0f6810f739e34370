"""`simulate.py` from its config to its last line: the runs, what became of each, and the report that was asked for."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.evaluation.chart.observed import Observed
from gns_pl.evaluation.maps import map_rows, maps_of, write_maps
from gns_pl.evaluation.outcome import Outcome, read_outcome
from gns_pl.evaluation.run_report import CHECKED, ReportedRun, check_reporting, report_lines, write_report
from gns_pl.io import read_header, read_trajectory, read_window
from gns_pl.metrics.maps import map_error
from gns_pl.solvers.reduction import reduce_scene

if TYPE_CHECKING:
    from omegaconf import DictConfig


def simulate_and_describe(cfg: DictConfig, *, label: str = "") -> list[Path]:
    """Simulate as a Hydra config says (conf/simulate.yaml), and say what became of every run.

    Args:
        cfg: the config.
        label: what tells this job from the others of a sweep; it goes into the names of the files.

    Returns:
        The trajectory files; none of an ensemble.
    """
    from omegaconf import OmegaConf

    reporting: dict[str, Any] = OmegaConf.to_container(cfg.reporting, resolve=True)  # type: ignore[assignment]
    reporting["maps"] = cfg.maps
    wanted = bool(cfg.report or reporting["film"] or reporting["paraview"])
    if wanted or cfg.maps:
        check_reporting(**{key: reporting[key] for key in CHECKED}, key="reporting")
    from gns_pl.solvers.simulate import simulate_config

    if cfg.ensemble.vary:
        from gns_pl.evaluation.ensemble import run_ensemble

        settings: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
        run_ensemble(settings, label)
        return []
    paths = simulate_config(cfg, label=label)
    # Of several processes that torchrun has started the first describes.
    if os.environ.get("WORLD_SIZE", "1") != "1" and os.environ.get("RANK", "0") != "0":
        return paths
    for path in paths:
        describe(path)
        if cfg.check:
            compare_with_check(path, cfg.tolerance, cfg.tolerance_of)
    for path in paths if wanted or cfg.maps else ():
        try:
            if wanted:
                report(path, reporting)
            else:
                write_maps_beside(path, figures=reporting["figures"], reached=reporting["reached"])
        except InputError as error:  # the run itself is whole
            print(f"{path}: no {'report' if wanted else 'maps'}: {error}")
    return paths


def describe(path: Path) -> Outcome:
    """Print one block about the run in a file, in metres and seconds."""
    outcome = read_outcome(path)
    print(f"{path}:", *report_lines(outcome.rows()), sep="\n", flush=True)
    return outcome


def compare_with_check(path: Path, tolerance: float | None, tolerance_of: str = "worse") -> None:
    """Print how far a run and the one on coarser cells are apart, where there is one.

    Args:
        path: of the run.
        tolerance: that was asked for, relative; None if none was.
        tolerance_of: the quantity it is of (`selection.QUANTITIES`).
    """
    from gns_pl.solvers.selection import QUANTITIES, listed, with_worse
    from gns_pl.solvers.simulate import CHECK_CELLS, check_path

    coarser = check_path(path)
    if not coarser.is_file():
        return
    fine, coarse = _observed_end(path), _observed_end(coarser)
    cells = [float(read_header(file).provenance["mpm"]["cell_size"]) for file in (path, coarser)]  # type: ignore[index]
    fronts, heights = ([float(getattr(run, name)[-1]) for run in (fine, coarse)] for name in ("front", "height"))
    still = 0.0 if fronts[1] <= 0 else math.inf  # where the finer run's front does not advance
    changes = {
        "front": fronts[1] / fronts[0] - 1 if fronts[0] > 0 else still,
        "map": map_error(coarse.volumes, fine.volumes),
        "height": heights[1] / heights[0] - 1,
    }
    errors = with_worse({of: abs(change) / (CHECK_CELLS - 1) for of, change in changes.items()})
    text = f"check: cells of {cells[0]:.3g} m and of {cells[1]:.3g} m give a final runout of {fronts[0]:.3g} m and "
    text += f"{fronts[1]:.3g} m, a mean height of {heights[0]:.3g} m and {heights[1]:.3g} m, and "
    text += f"{100 * changes['map']:.1f} % of the volume in different places; if errors are proportional to the cells, "
    text += f"the finer run errs by {listed(errors)}"
    if tolerance is not None:
        asked, error = f"the tolerance of {100 * tolerance:g} % in the {QUANTITIES[tolerance_of]}", errors[tolerance_of]
        if error > tolerance:
            finer = cells[0] * max(0.25, tolerance / error)
            text += f", more than {asked}; run it on finer cells: solver=mpm cell_size={finer:.2g}"
        else:
            text += f", within {asked}"
    print(f"{text}.")


def _observed_end(path: Path) -> Observed:
    """Return what is compared of the run in a file, as a chart does, of its first and its last frame."""
    start = read_trajectory(path, 1)
    last = read_window(path, read_header(path).num_frames - 1, 1)
    run, reduction = replace(start, position=np.concatenate([start.position, last])), reduce_scene(start.scene)
    return Observed.of(run, start.scene if reduction.across is None else reduction.scene, reduction.across)


def report(path: Path, reporting: Mapping[str, Any]) -> list[Path]:
    """Write the report about the run in a file into a folder of its name beside it.

    Args:
        path: of the run.
        reporting: as `run_report.write_report`.
    """
    trajectory = read_trajectory(path)
    run = ReportedRun(trajectory, _solver_name(trajectory.provenance))
    files = write_report({path.stem: run}, path.with_suffix(""), **reporting)
    print("Made:", *files, sep="\n  ")
    return files


def write_maps_beside(path: Path, *, figures: bool, reached: float | None) -> list[Path]:
    """Write the maps of the run in a file into the folder of its report; arguments as those of `write_report`."""
    header, maps = read_header(path), maps_of(path, reached=reached)
    print(*report_lines(map_rows(maps, header.scene)), sep="\n")
    title = f"{path.stem}: {_solver_name(header.provenance)}"
    folder = path.with_suffix("") / "maps"
    files = write_maps(maps, header.scene, folder, name=path.stem, title=title, figures=figures)
    print("Made:", *files, sep="\n  ")
    return files


def _solver_name(provenance: Mapping[str, object]) -> str:
    """Return the name of the solver that made a run."""
    if "checkpoint" in provenance:
        return Path(str(provenance["checkpoint"])).stem
    return str(provenance.get("solver", ""))
