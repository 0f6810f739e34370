"""`simulate.py` from its config to its last line: the runs, what became of each, and the report that was asked for."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gns_pl.errors import InputError
from gns_pl.evaluation.outcome import Outcome, read_outcome
from gns_pl.evaluation.run_report import ReportedRun, check_reporting, report_lines, write_report
from gns_pl.io import read_header, read_trajectory
from gns_pl.text import override

if TYPE_CHECKING:
    from omegaconf import DictConfig


def simulate_and_describe(cfg: DictConfig, *, label: str = "") -> list[Path]:
    """Simulate as a Hydra config says (conf/simulate.yaml), and say what became of every run.

    Args:
        cfg: the config.
        label: what tells this job from the others of a sweep; it goes into the names of the files.

    Returns:
        The trajectory files.
    """
    from omegaconf import OmegaConf

    reporting: dict[str, Any] = OmegaConf.to_container(cfg.reporting, resolve=True)  # type: ignore[assignment]
    wanted = bool(cfg.report or reporting["film"] or reporting["paraview"])
    if wanted:
        keys = ("figures", "film", "paraview")
        check_reporting(**{key: reporting[key] for key in keys}, key="reporting")
    from gns_pl.solvers.simulate import simulate_config

    paths = simulate_config(cfg, label=label)
    # Of several processes that torchrun has started the first describes.
    if os.environ.get("WORLD_SIZE", "1") != "1" and os.environ.get("RANK", "0") != "0":
        return paths
    for path in paths:
        describe(path)
        if cfg.check:
            compare_with_check(path, cfg.tolerance)
    if wanted:
        for path in paths:
            try:
                report(path, reporting)
            except InputError as error:  # the run itself is whole
                print(f"{path}: no report: {error}")
    return paths


def describe(path: Path) -> Outcome:
    """Print one block about the run in a file, in metres and seconds."""
    outcome = read_outcome(path)
    print(f"{path}:", *report_lines(outcome.rows()), sep="\n", flush=True)
    return outcome


def compare_with_check(path: Path, tolerance: float | None) -> None:
    """Print how far a run and the one on coarser cells are apart, where there is one.

    Args:
        path: of the run.
        tolerance: of the final runout, relative, that was asked for; None if none was.
    """
    from gns_pl.solvers.simulate import CHECK_CELLS, check_path

    coarser = check_path(path)
    if not coarser.is_file():
        return
    fine, coarse = read_outcome(path), read_outcome(coarser)
    cells = [float(read_header(file).provenance["mpm"]["cell_size"]) for file in (path, coarser)]  # type: ignore[index]
    text = f"check: cells of {cells[0]:.3g} m and of {cells[1]:.3g} m give a final runout of {fine.runout:.3g} m and "
    text += f"{coarse.runout:.3g} m, a mean height of {fine.mean_height:.3g} m and {coarse.mean_height:.3g} m"
    if fine.runout > 0:
        change = coarse.runout / fine.runout - 1
        error = abs(change) / (CHECK_CELLS - 1)
        text += (
            f": {100 * change:+.1f} % in the runout; if errors are proportional to the cells, the finer run errs by "
        )
        text += f"{100 * error:.1f} %"
        if tolerance is not None and error > tolerance:
            finer = override("cell_size", f"{cells[0] * max(0.25, tolerance / error):.2g}")
            text += f", more than the tolerance of {100 * tolerance:g} %; run it on finer cells: solver=mpm {finer}"
        elif tolerance is not None:
            text += f", within the tolerance of {100 * tolerance:g} %"
    print(f"{text}.")


def report(path: Path, reporting: Mapping[str, Any]) -> list[Path]:
    """Write the report about the run in a file into a folder of its name beside it.

    Args:
        path: of the run.
        reporting: as `run_report.write_report`.
    """
    trajectory = read_trajectory(path)
    provenance = trajectory.provenance
    solver = str(provenance.get("checkpoint", provenance.get("solver", "")))
    files = write_report(
        {path.stem: ReportedRun(trajectory, Path(solver).stem if "checkpoint" in provenance else solver)},
        path.with_suffix(""),
        **reporting,
    )
    print("Made:", *files, sep="\n  ")
    return files
