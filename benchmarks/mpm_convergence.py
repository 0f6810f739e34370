"""How well the material point solver is converged, and what each of its choices does to a column collapse.

    python benchmarks/mpm_convergence.py                     # every study, about an hour on one core, and the figure
    python benchmarks/mpm_convergence.py --study resolution transfer --workers 2
    python benchmarks/mpm_convergence.py --figure            # only docs/mpm_convergence.png and the estimates
    python benchmarks/mpm_convergence.py --reference         # the curves in tests/validation/ref

Every run is one row of docs/mpm_convergence.csv, written when it is done; what is there is not run again, so a stopped
study goes on. The scene: the paper's columns (a = H0/L0 = 0.8 and 2.0, its sand, friction 0.385 on floor and ends) with
slip side walls in a box long enough for the front, over 8 √(H0/g). Times are those of one thread on a machine that may
have been doing other things; `benchmarks/mpm.py` measures speed.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
import os
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from gns_pl.metrics.curves import compute_curves
from gns_pl.metrics.measures import arrest_time
from gns_pl.mpm import MPMConfig, SimulationError, simulate
from gns_pl.scene import FACES, Material, Scene, Wall, column_collapse

DOCS = Path(__file__).parents[1] / "docs"
REFERENCES = Path(__file__).parents[1] / "tests" / "validation" / "ref"
REFERENCE_CURVES = (
    "runout_99",
    "runout_995",
    "runout_max",
    "height_99",
    "mean_height",
    "kinetic_energy",
    "potential_energy",
)
REFERENCE_RUNS = (("plane", 144, (0, 1)), ("friction", 48, (0,)))
"""Side walls, cells per metre and placements of the references that are kept."""
SAND = Material(
    density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30, cohesion=100, tension_cutoff=50
)
FRICTION, SLIP = Wall("friction", 0.385), Wall("slip")
LENGTH = {0.8: 0.475, 2.0: 0.3}
"""Aspect ratio → L0 [m]."""
WIDTH = 0.5
"""Of the three-dimensional channel [m]."""
DURATION = 8.0
"""In √(H0/g); the front stops near 3.5, inner motion near 6."""
FRAME_INTERVAL = 0.0025
"""[s]"""
REST = 0.1
"""Accelerations at rest are taken over this last part of a run [s]."""

SETTINGS: dict[str, Any] = {
    "walls": "plane",  # plane: two dimensions; slip: three with slip side walls; friction: three, the paper's walls
    "cells_per_metre": 24,
    "points_per_direction": 2,
    "courant": 0.3,
    "transfer": "affine_flip",
    "damping_rate": 20.0,
    "bulk_viscosity": 0.3,
    "flip_fraction": 1.0,
    "local_damping": 0.0,
    "shape": "quadratic",
    "precision": "float64",
    "seed": 0,
}
"""What a run has where its study says nothing else."""

RESULTS = (
    "points",
    "steps",
    "seconds",
    "runout_99",
    "runout_995",
    "runout_max",
    "height_99",
    "mean_height",
    "arrest_time",
    "final_speed",
    "final_kinetic",
    "dissipated",
    "rest_acceleration",
    "failure",
)
"""Lengths in L0, times in √(H0/g), energies over m g H0 / 2, speed [m/s], acceleration [m/s²]."""

COLUMNS = ("study", "aspect_ratio", *SETTINGS, *RESULTS)


def studies() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every run as its study and what differs from `SETTINGS`, cheap studies first."""
    for cells, points, seed in itertools.product((12, 18, 24, 36, 48), (2, 3, 4), (0, 1, 2)):
        yield "resolution", {"cells_per_metre": cells, "points_per_direction": points, "seed": seed}
    for cells, seed in itertools.product((72, 96), (0, 1, 2)):
        yield "resolution", {"cells_per_metre": cells, "seed": seed}
    for courant in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6):
        yield "courant", {"cells_per_metre": 24, "courant": courant}
    per_step = ({"transfer": "pic"}, {"transfer": "apic"}, {"flip_fraction": 0.99}, {"flip_fraction": 0.9})
    for courant, choice in itertools.product((0.3, 0.1, 0.03), per_step):
        yield "transfer", {"cells_per_metre": 24, "courant": courant, "damping_rate": 0.0} | choice
    for cells in (24, 48):
        for rate, transfer in itertools.product((0.0, 5.0, 20.0, 50.0), ("affine_flip", "flip")):
            yield "transfer", {"cells_per_metre": cells, "damping_rate": rate, "transfer": transfer}
        yield "local damping", {"cells_per_metre": cells, "damping_rate": 0.0, "local_damping": 0.05}
    for cells, points in itertools.product((12, 24, 48), (2, 4)):
        if cells < 48 or points < 4:
            yield "shape", {"cells_per_metre": cells, "points_per_direction": points, "shape": "linear"}
    for cells in (12, 24, 48):
        yield "precision", {"cells_per_metre": cells, "precision": "float32"}
    for cells, viscosity in itertools.product((24, 48, 72), (0.0, 0.86)):
        yield "viscosity", {"cells_per_metre": cells, "bulk_viscosity": viscosity}
    for cells, points in ((12, 2), (12, 4), (18, 2), (24, 2)):
        for walls in ("slip", "friction"):
            yield "walls", {"cells_per_metre": cells, "points_per_direction": points, "walls": walls}
    for courant, cells in itertools.product((0.1, 0.5), (48,)):
        yield "courant", {"cells_per_metre": cells, "courant": courant}
    yield "walls", {"cells_per_metre": 36, "walls": "friction"}
    for seed in (0, 1):
        yield "resolution", {"cells_per_metre": 144, "seed": seed}
    yield "walls", {"cells_per_metre": 48, "walls": "friction"}


def make_scene(aspect_ratio: float, walls: str) -> Scene:
    """Return the column; `walls` as in `SETTINGS`."""
    length = LENGTH[aspect_ratio]
    height = aspect_ratio * length
    dim = 2 if walls == "plane" else 3
    faces = dict.fromkeys(FACES[dim], FRICTION)
    if walls == "slip":
        faces |= {"y-": SLIP, "y+": SLIP}
    return column_collapse(
        domain=(2.5, 0.75) if dim == 2 else (2.0, WIDTH, 0.75),
        length=length,
        height=height,
        gravity=9.81,
        duration=DURATION * math.sqrt(height / 9.81),
        material=SAND,
        walls=faces,
        name=f"column_{aspect_ratio:g}",
    )


def run(aspect_ratio: float, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Simulate one column and return its `RESULTS`."""
    choice = dict(settings)
    walls, cells, seed = choice.pop("walls"), choice.pop("cells_per_metre"), choice.pop("seed")
    scene = make_scene(aspect_ratio, walls)
    config = MPMConfig(cell_size=1 / cells, jitter=0.5, **choice)
    simulate(scene.replace(duration=FRAME_INTERVAL), config, frame_interval=FRAME_INTERVAL)  # compiles
    started = time.perf_counter()
    try:
        flow = simulate(scene, config, frame_interval=FRAME_INTERVAL, seed=seed)
    except SimulationError as error:
        return {"failure": str(error)}
    seconds = time.perf_counter() - started
    curves = compute_curves(flow)
    energy = float(flow.mass.sum()) * 9.81 * aspect_ratio * LENGTH[aspect_ratio] / 2
    acceleration = np.diff(flow.position[-round(REST / FRAME_INTERVAL) :].astype(np.float64), n=2, axis=0)
    results: dict[str, Any] = {
        name: float(curves[name][-1]) for name in ("runout_99", "runout_995", "runout_max", "height_99")
    }
    results |= {
        "points": flow.num_particles,
        "steps": flow.provenance["num_steps"],
        "seconds": round(seconds, 2),
        "mean_height": float(curves["mean_height"][-1]) / LENGTH[aspect_ratio],
        "arrest_time": arrest_time(curves["time_tau"], curves["runout_99"]),
        "final_speed": float(curves["speed_mean"][-1]),
        "final_kinetic": float(curves["kinetic_energy"][-1]) / energy,
        "dissipated": float(curves["dissipated_energy"][-1]) / energy,
        "rest_acceleration": float(np.sqrt(np.square(acceleration / FRAME_INTERVAL**2).sum(axis=2).mean())),
        "failure": "",
    }
    return results


def reference_curves(aspect_ratio: float, walls: str, cells: int, seeds: tuple[int, ...]) -> dict[str, Any]:
    """Return the columns of a reference, means over seeds every 0.1 √(H0/g), and their standard deviation of runout."""
    scene = make_scene(aspect_ratio, walls)
    choice = {name: SETTINGS[name] for name in SETTINGS if name not in ("walls", "cells_per_metre", "seed")}
    config = MPMConfig(cell_size=1 / cells, jitter=0.5, **choice)
    times = np.round(np.arange(0, DURATION + 1e-9, 0.1), 1)
    found: dict[str, list[Any]] = {name: [] for name in REFERENCE_CURVES}
    for seed in seeds:
        curves = compute_curves(simulate(scene, config, frame_interval=FRAME_INTERVAL, seed=seed))
        unit = curves["potential_energy"][0]
        for name, values in found.items():
            scale = unit if "energy" in name else (LENGTH[aspect_ratio] if name == "mean_height" else 1.0)
            values.append(np.interp(times, curves["time_tau"], curves[name] / scale))
    columns: dict[str, Any] = {"time_tau": times}
    for name, values in found.items():
        columns[name] = np.mean(values, axis=0)
    columns["runout_99_scatter"] = np.std(found["runout_99"], axis=0)
    return columns


def write_reference(aspect_ratio: float, walls: str, cells: int, seeds: tuple[int, ...]) -> None:
    """Write one file of tests/validation/ref."""
    columns = reference_curves(aspect_ratio, walls, cells, seeds)
    path = REFERENCES / f"mpm_{walls}_{aspect_ratio:g}.csv"
    about = {"plane": "slip side walls (plane strain)", "friction": "friction 0.385 on the side walls too, 0.5 m apart"}
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(
            f"# Column a = {aspect_ratio:g}, L0 = {LENGTH[aspect_ratio]:g} m, the paper's sand, friction 0.385 on "
            f"floor and ends, {about[walls]}.\n"
            f"# gns_pl.mpm at 1/{cells} m, 2 points per direction, mean over {len(seeds)} placements; error estimate: "
            "docs/reference.md.\n"
            "# Lengths in L0, energies over the potential energy at the start, time in sqrt(H0/g).\n"
        )
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{value:.4f}" for value in row] for row in zip(*columns.values(), strict=True))
    print(path, f"final 99 % runout {columns['runout_99'][-1]:.3f}", flush=True)


def key(row: Mapping[str, Any]) -> tuple[str, ...]:
    """What makes a run this one, whatever study it belongs to."""
    return tuple(str(row[name]) for name in ("aspect_ratio", *SETTINGS))


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file of results, none if it is not there."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def run_studies(path: Path, chosen: list[str], workers: int) -> None:
    """Run what is missing of the chosen studies and append it to `path`."""
    done = {key(row) for row in read_rows(path)}
    todo = []
    for (study, choice), aspect_ratio in itertools.product(list(studies()), LENGTH):
        row = {"study": study, "aspect_ratio": aspect_ratio} | SETTINGS | choice
        if (not chosen or study in chosen) and key(row) not in done:
            done.add(key(row))
            todo.append(row)
    print(f"{len(todo)} runs to do, {len(done) - len(todo)} done; results go to {path}", flush=True)
    if not path.exists():
        path.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    os.environ["NUMBA_NUM_THREADS"] = "1"
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(run, row["aspect_ratio"], {name: row[name] for name in SETTINGS}): row for row in todo}
        for future in as_completed(waiting):
            row = waiting[future] | future.result()
            with path.open("a", encoding="utf-8", newline="") as file:
                csv.DictWriter(file, COLUMNS).writerow(
                    {name: f"{value:.6g}" if isinstance(value, float) and name in RESULTS else value
                     for name, value in row.items()}
                )  # fmt: skip
            print(f"{row['study']:14s} a={row['aspect_ratio']} {row.get('runout_99', math.nan):.4f} "
                  f"{row.get('seconds', 0):.0f} s {row.get('failure', '')}", flush=True)  # fmt: skip


def estimates(rows: list[dict[str, str]]) -> Iterator[tuple[str, int, list[float], float, float]]:
    """Yield aspect ratio, cells of the finest grid, runout by cells, observed order and relative error of the finest.

    Means over placements at 12, 24 and 48 cells per metre give the order p. The error of the finest grid is the largest
    of three: Richardson's extrapolation between the two finest as Roache's grid convergence index has it,
    1.25 |f_f − f_m| / (r^p − 1) with p cut to [1, 2]; twice the scatter of the placements; and half the range over the
    four finest grids, since fine grids differ without order.
    """
    for aspect_ratio in ("0.8", "2.0"):
        groups: dict[int, list[float]] = {}
        for row in rows:
            if (row["study"], row["aspect_ratio"], row["points_per_direction"]) == ("resolution", aspect_ratio, "2"):
                groups.setdefault(int(row["cells_per_metre"]), []).append(float(row["runout_99"]))
        cells = sorted(groups)
        means = {n: float(np.mean(groups[n])) for n in cells}
        order = math.log2(abs((means[24] - means[12]) / (means[48] - means[24])))
        most = [n for n in cells if len(groups[n]) > 1][-1]
        middle = max(n for n in cells if n < most)
        p = min(max(order, 1.0), 2.0)
        discretisation = 1.25 * abs(means[most] - means[middle]) / ((most / middle) ** p - 1)
        disorder = float(np.ptp([means[n] for n in cells[-4:]])) / 2
        error = max(discretisation, 2 * float(np.std(groups[most])), disorder) / means[most]
        yield aspect_ratio, most, [means[n] for n in cells], order, error


def draw(rows: list[dict[str, str]], path: Path) -> None:
    """Draw what the studies found."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from gns_pl.viz.plots import COLOURS, STYLE

    colour = dict(zip(("0.8", "2.0"), COLOURS[2:0:-1], strict=True))

    def select(aspect_ratio: str, **wanted: Any) -> list[dict[str, str]]:
        settled = {name: str(value) for name, value in (SETTINGS | wanted).items() if value is not None}
        return [
            row for row in rows if row["aspect_ratio"] == aspect_ratio and all(row[n] == v for n, v in settled.items())
        ]

    def line(axis: Any, x: str, y: str, aspect_ratio: str, marker: str, label: str, **wanted: Any) -> None:
        groups: dict[float, list[float]] = {}
        for row in select(aspect_ratio, **{x: None, "seed": None} | wanted):
            if not row["failure"]:
                groups.setdefault(float(row[x]), []).append(float(row[y]))
        at = sorted(groups)
        mean, spread = [np.mean(groups[v]) for v in at], [np.std(groups[v]) for v in at]
        axis.errorbar(at, mean, spread, fmt=marker, color=colour[aspect_ratio], ms=4, lw=0.9, capsize=2, label=label,
                      mfc="none" if "-." in marker or ":" in marker else None)  # fmt: skip

    per_step: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("s--", "FLIP 0.99 per step", {"flip_fraction": 0.99}),
        ("^-.", "APIC", {"transfer": "apic"}),
        ("v:", "PIC", {"transfer": "pic"}),
    )
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(2, 3, figsize=(10.5, 6.2), layout="constrained")
        for a in colour:
            for points, marker in ((2, "o-"), (3, "s--"), (4, "^:")):
                line(axes[0, 0], "cells_per_metre", "runout_99", a, marker, f"a = {a}, {points} points",
                     points_per_direction=points)  # fmt: skip
                line(axes[0, 1], "cells_per_metre", "mean_height", a, marker, f"a = {a}, {points} points",
                     points_per_direction=points)  # fmt: skip
            line(axes[0, 2], "courant", "runout_99", a, "o-", f"a = {a}, affine FLIP, rate 20/s")
            for marker, name, wanted in per_step:
                line(axes[0, 2], "courant", "runout_99", a, marker, f"a = {a}, {name}", damping_rate=0.0, **wanted)
            line(axes[1, 0], "damping_rate", "runout_99", a, "o-", f"a = {a}, affine FLIP, 1/24 m")
            line(axes[1, 0], "damping_rate", "runout_99", a, "s--", f"a = {a}, affine FLIP, 1/48 m", cells_per_metre=48)
            line(axes[1, 0], "damping_rate", "runout_99", a, "^:", f"a = {a}, FLIP, 1/24 m", transfer="flip")
            line(axes[1, 1], "cells_per_metre", "runout_99", a, "o-", f"a = {a}, two dimensions")
            line(axes[1, 1], "cells_per_metre", "runout_99", a, "s--", f"a = {a}, three, slip sides", walls="slip")
            line(axes[1, 1], "cells_per_metre", "runout_99", a, "^:", f"a = {a}, three, friction", walls="friction")
        axes[0, 0].set(xscale="log", xlabel="cells per metre", ylabel="final runout, 99 % of the mass [$L_0$]",
                       title="resolution")  # fmt: skip
        axes[0, 1].set(xscale="log", xlabel="cells per metre", ylabel="final mean height [$L_0$]", title="resolution")
        axes[0, 2].set(
            xscale="log", xlabel="Courant number", ylabel="final runout [$L_0$]", title="damping per step, 1/24 m"
        )
        axes[1, 0].set(xlabel="damping rate [1/s]", ylabel="final runout [$L_0$]", title="transfer")
        axes[1, 1].set(xscale="log", xlabel="cells per metre", ylabel="final runout [$L_0$]", title="side walls")
        for axis in (axes[0, 0], axes[0, 1], axes[1, 1]):
            axis.set_xticks([12, 24, 48, 96], ["12", "24", "48", "96"], minor=False)
            axis.set_xticks([], minor=True)
        bars = (
            ("affine FLIP, 20/s", {}),
            ("affine FLIP, 0", {"damping_rate": 0.0}),
            ("FLIP, 0", {"damping_rate": 0.0, "transfer": "flip"}),
            ("FLIP, 20/s", {"transfer": "flip"}),
            ("FLIP 0.99 per step", {"damping_rate": 0.0, "flip_fraction": 0.99}),
            ("APIC", {"damping_rate": 0.0, "transfer": "apic"}),
            ("PIC", {"damping_rate": 0.0, "transfer": "pic"}),
            ("linear shapes", {"shape": "linear"}),
            ("no bulk viscosity", {"bulk_viscosity": 0.0}),
            ("float32", {"precision": "float32"}),
        )
        for shift, a in ((-0.2, "0.8"), (0.2, "2.0")):
            values = [
                np.mean([float(r["rest_acceleration"]) for r in select(a, seed=None, **w)] or [math.nan])
                for _, w in bars
            ]
            axes[1, 2].barh(np.arange(len(bars)) + shift, values, 0.38, color=colour[a], label=f"a = {a}")
        axes[1, 2].set_yticks(range(len(bars)), [name for name, _ in bars])
        axes[1, 2].invert_yaxis()
        axes[1, 2].set(
            xscale="log", xlabel="acceleration at rest, root mean square [m/s²]", title="noise of the heap, 1/24 m"
        )
        for axis, ticks in ((axes[0, 2], [0.03, 0.1, 0.3, 0.6]), (axes[1, 2], [0.003, 0.01, 0.03, 0.1])):
            axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
            axis.set_xticks([], minor=True)
        axes[0, 2].set_ylim(-0.1, 4.4)
        axes[1, 2].set_xlim(1e-3, 0.1)
        for axis in axes.flat:
            axis.legend(fontsize=5.5, ncols=2 if axis is axes[0, 2] else 1)
        figure.savefig(path)
        plt.close(figure)


def main() -> None:
    """Run studies, draw them, or write references."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--study", nargs="+", default=[], choices=sorted({study for study, _ in studies()}))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--results", type=Path, default=DOCS / "mpm_convergence.csv")
    parser.add_argument("--figure", action="store_true", help="only draw the results there are")
    parser.add_argument("--reference", action="store_true", help="only write the reference curves")
    chosen = parser.parse_args()
    if chosen.reference:
        for (walls, cells, seeds), aspect_ratio in itertools.product(REFERENCE_RUNS, LENGTH):
            write_reference(aspect_ratio, walls, cells, seeds)
        return
    if not chosen.figure:
        run_studies(chosen.results, chosen.study, chosen.workers)
    rows = read_rows(chosen.results)
    for aspect_ratio, finest, runouts, order, error in estimates(rows):
        told = ", ".join(f"{value:.3f}" for value in runouts)
        print(f"a = {aspect_ratio}: {told}; order {order:.2f}; at 1/{finest} m within {100 * error:.1f} %")
    draw(rows, chosen.results.with_suffix(".png"))


if __name__ == "__main__":
    main()
