"""The material point solver beside published laws of granular collapse, its energy balance and its angle of repose.

    python benchmarks/mpm_validation.py            # docs/mpm_validation.csv, mpm_energy.csv, mpm_validation.png
    python benchmarks/mpm_validation.py --figure   # only the figure, from the files there are

Columns in plane strain of aspect ratio 0.4 to 6 and quarter columns around an axis, sand without cohesion on a rough
floor (friction tan φ); heaps left on a pedestal whose edge sand falls over; and where the energy of a column goes.
A few minutes on one core. `tests/validation/test_mpm_laws.py` holds what is claimed of it.
"""

from __future__ import annotations

import argparse
import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.metrics.curves import compute_curves
from gns_pl.metrics.laws import LAWS, Law
from gns_pl.metrics.measures import arrest_time, percentile_front
from gns_pl.mpm import MPMConfig, simulate
from gns_pl.scene import FACES, Body, Box, Material, Scene, Wall, column_collapse, fill_scene

DOCS = Path(__file__).parents[1] / "docs"
GRAVITY = 9.81
ASPECT_RATIOS = (0.4, 0.6, 0.8, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
FRICTION_ANGLES = (20.0, 25.0, 30.0, 35.0, 40.0, 45.0)
RADIUS = 0.2
"""L0 of the columns of the laws, and radius of the axisymmetric ones [m]."""


AXISYMMETRIC = Law("Lube et al. 2004, axisymmetric", 1.24, 1.6, 0.5)


def lube_height(aspect_ratio: float) -> float:
    """Return the final height over L0 of Lube et al. 2005."""
    return aspect_ratio if aspect_ratio < 1.15 else aspect_ratio**0.4


def sand(friction_angle_deg: float = 30.0) -> Material:
    """Return sand without cohesion."""
    return Material(density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=friction_angle_deg)


def settings(cell_size: float, **changes: Any) -> MPMConfig:
    """Return the solver's settings: those of the data sets, two points per direction."""
    values: dict[str, Any] = {
        "cell_size": cell_size,
        "points_per_direction": 2,
        "courant": 0.3,
        "transfer": "affine_flip",
        "damping_rate": 20.0,
        "bulk_viscosity": 0.3,
        "jitter": 0.5,
    }
    return MPMConfig(**(values | changes))


def rough_floor(dim: int, friction_angle_deg: float) -> dict[str, Wall]:
    """Return slip walls and a floor of friction tan φ."""
    floor = Wall("friction", math.tan(math.radians(friction_angle_deg)))
    return {**dict.fromkeys(FACES[dim], Wall("slip")), f"{'xyz'[2]}-": floor}


def cells_across(aspect_ratio: float) -> int:
    """Return how many grid cells the shorter of L0 and H0 is given: low columns are thin when they have spread."""
    return 32 if aspect_ratio <= 1.5 else 16


def plane_scene(aspect_ratio: float, friction_angle_deg: float, duration: float) -> tuple[Scene, float]:
    """Return a column in plane strain that is watched for `duration` · τ, and τ = √(H0/g) [s]."""
    height = aspect_ratio * RADIUS
    tau = math.sqrt(height / GRAVITY)
    scene = column_collapse(
        domain=(RADIUS * (1.5 + 4 * max(aspect_ratio, aspect_ratio**0.7)), 1.1 * height),
        length=RADIUS,
        height=height,
        gravity=GRAVITY,
        duration=duration * tau,
        material=sand(friction_angle_deg),
        walls=rough_floor(2, friction_angle_deg),
    )
    return scene, tau


def plane_column(aspect_ratio: float, friction_angle_deg: float = 30.0) -> dict[str, float]:
    """Run a column in plane strain and return runout, height, arrest and energies.

    Args:
        aspect_ratio: H0 / L0.
        friction_angle_deg: φ of sand and floor [degrees].

    Returns:
        Final `runout_99`, `runout_max`, `height_99` [L0], `arrest_time` [√(H0/g)], final `kinetic` [m g H0 / 2],
        largest `rise` of kinetic plus potential energy between frames [m g H0 / 2].
    """
    scene, tau = plane_scene(aspect_ratio, friction_angle_deg, 8.0)
    height = aspect_ratio * RADIUS
    flow = simulate(scene, settings(min(RADIUS, height) / cells_across(aspect_ratio)), frame_interval=tau / 50)
    curves = compute_curves(flow)
    unit = float(flow.mass.sum()) * GRAVITY * height / 2
    return {
        "runout_99": float(curves["runout_99"][-1]),
        "runout_max": float(curves["runout_max"][-1]),
        "height_99": float(curves["height_99"][-1]),
        "arrest_time": arrest_time(curves["time_tau"], curves["runout_99"]),
        "kinetic": float(curves["kinetic_energy"][-1]) / unit,
        "rise": float(np.diff(curves["kinetic_energy"] + curves["potential_energy"]).max()) / unit,
    }


def axisymmetric_column(aspect_ratio: float, cells: int = 12) -> dict[str, float]:
    """Run a quarter of a round column between two slip walls, its symmetry planes.

    Args:
        aspect_ratio: H0 / R0.
        cells: grid cells along R0.

    Returns:
        Final `runout_99`, `runout_max` of the radius [R0], and `anisotropy`, the 99 % front within 15° of the walls
        over that within 15° of the diagonal.
    """
    height, strip = aspect_ratio * RADIUS, RADIUS / cells
    tau = math.sqrt(height / GRAVITY)
    middles = (np.arange(cells) + 0.5) * strip
    bodies = tuple(
        Body((0.0, float(y - strip / 2), 0.0), (math.sqrt(RADIUS**2 - y**2), strip, height), (0.0,) * 3)
        for y in middles
    )
    side = RADIUS * (1.4 + 2.2 * aspect_ratio ** (1.0 if aspect_ratio < 1.7 else 0.5))
    scene = Scene(
        name="quarter_column",
        lower=(0.0,) * 3,
        upper=(side, side, 1.1 * height),
        gravity=(0.0, 0.0, -GRAVITY),
        duration=6 * tau,
        materials={"sand": sand()},
        bodies=bodies,
        walls=rough_floor(3, 30.0),
    )
    flow = simulate(scene, settings(RADIUS / cells), frame_interval=tau / 10)
    last = flow.position[-1].astype(np.float64)
    radius, angle = np.hypot(last[:, 0], last[:, 1]), np.degrees(np.arctan2(last[:, 1], last[:, 0]))
    diagonal = np.abs(angle - 45) < 15
    edge = np.abs(angle - 45) > 30
    mass = flow.mass.astype(np.float64)

    def front(chosen: NDArray[np.bool_], percent: float) -> float:
        return float(percentile_front(radius[None, chosen], mass[chosen], (percent,), RADIUS / cells / 2)[0, 0])

    everything = np.ones(len(last), dtype=bool)
    return {
        "runout_99": front(everything, 99.0) / RADIUS - 1,
        "runout_max": front(everything, 100.0) / RADIUS - 1,
        "anisotropy": front(edge, 99.0) / front(diagonal, 99.0),
    }


def angle_of_repose(friction_angle_deg: float, cells_per_metre: int = 40) -> float:
    """Return the slope of what stays on a pedestal when the sand beside it has fallen over the edge [degrees].

    A block of 0.5 × 0.3 m stands on a pedestal of 0.5 × 0.3 m. The slope is that of a line through the surface over
    the middle 70 % of its height.
    """
    edge, top, height = 0.5, 0.3, 0.3
    floor = Wall("friction", math.tan(math.radians(friction_angle_deg)))
    scene = Scene(
        name="repose",
        lower=(0.0, 0.0),
        upper=(1.5, 0.7),
        gravity=(0.0, -GRAVITY),
        duration=2.0,
        materials={"sand": sand(friction_angle_deg)},
        bodies=(Body((0.0, top), (edge, height), (0.0, 0.0)),),
        walls=rough_floor(2, friction_angle_deg),
        obstacles=(Box((-1.0, -1.0), (1.0 + edge, 1.0 + top), floor),),
    )
    flow = simulate(scene, settings(1 / cells_per_metre), frame_interval=0.02)
    last = flow.position[-1].astype(np.float64)
    width = 2 / cells_per_metre
    middles = np.arange(width / 2, edge, width)
    surface = []
    for x in middles:  # highest point of every bin, less the lift of half a spacing
        inside = (np.abs(last[:, 0] - x) < width / 2) & (last[:, 1] > top - 0.01)
        surface.append(last[inside, 1].max() - top if inside.any() else 0.0)
    level = np.array(surface)
    used = (level > 0.15 * level.max()) & (level < 0.85 * level.max())
    slope = np.polyfit(middles[used], level[used], 1)[0]
    return math.degrees(math.atan(-slope))


ENERGIES = ("time_tau", "kinetic", "potential", "stored", "plastic", "viscous", "walls", "transfer")


def energy_balance(scene: Scene, config: MPMConfig, tau: float, num_rows: int = 160) -> list[dict[str, float]]:
    """Run a scene step by step and tell where its energy is and went, over that of the start.

    Kinetic energy of the points; potential energy; elastic energy stored, Σ V (s:s / 4G + p² / 2K); plastic
    dissipation, the work of the mean of the stresses before and after a step less what they store; dissipation by bulk
    viscosity; by walls, from their impulses on the nodes; and what is left, lost in the transfers between points and
    grid and in time (a step moves with the stresses before it, not with the mean).

    Args:
        scene: with its bodies.
        config: float64.
        tau: unit of time [s].
        num_rows: number of times kept.

    Returns:
        Rows of `ENERGIES`, energies over energy at the start.
    """
    from gns_pl.mpm.grid import clear_nodes, move_nodes, scatter_blocks, sort_points
    from gns_pl.mpm.plan import make_plan, make_setting, make_state
    from gns_pl.mpm.transfer import grid_to_points

    particles = fill_scene(scene, config.spacing, jitter=config.jitter, generator=np.random.default_rng(0))
    plan = make_plan(scene, particles, config, scene.duration)
    state, setting = make_state(scene, particles, plan.grid, config), make_setting(scene, plan.grid, config, plan.dt)
    position, velocity, affine, stress, mass, volume, index, materials, grid, gap, order, block, start = state
    cells, nodes, inverse, gravity, friction, radius, obstacles, layers, affine_part, flip, damping, dt = setting
    table = materials[index]
    shear, bulk, tension, viscosity = table[:, 0], table[:, 1], table[:, 5], table[:, 6]
    down = np.array(gravity) / np.array(inverse)

    def felt() -> NDArray[np.float64]:
        return np.maximum(stress[:, 6], -tension)

    def stored() -> float:
        s = stress
        squares = s[:, 0] ** 2 + s[:, 1] ** 2 + s[:, 2] ** 2 + 2 * (s[:, 3] ** 2 + s[:, 4] ** 2 + s[:, 5] ** 2)
        return float((volume * (squares / (4 * shear) + felt() ** 2 / (2 * bulk))).sum())

    def mechanical() -> tuple[float, float]:
        kinetic = float(0.5 * mass @ np.square(velocity).sum(axis=1))
        return kinetic, -float(mass @ (position @ down))

    plastic = viscous = walls = 0.0
    total = sum(mechanical()) + stored()
    rows = []
    every = max(1, plan.steps // num_rows)
    for step in range(plan.steps + 1):
        if step % every == 0:
            kinetic, potential = mechanical()
            elastic = stored()
            lost = total - kinetic - potential - elastic - plastic - viscous - walls
            values = (kinetic, potential, elastic, plastic, viscous, walls, lost)
            rows.append(
                {"time_tau": float(step * dt / tau)} | dict(zip(ENERGIES[1:], (v / total for v in values), strict=True))
            )
        active = sort_points(position, cells, nodes, order, block, start)
        clear_nodes(active[0], active[1], grid, gap, active, nodes)
        for colour in range(4):
            if cells[1] > 0 or colour % 2 == 0:
                scatter_blocks(
                    0, 1, colour, start, order, position, velocity, affine, stress, mass, volume, index, materials,
                    grid, gap, cells, nodes, inverse, obstacles, layers, affine_part, dt,
                )  # fmt: skip
        impulse, elastic = grid[:, 4:7].copy(), stored()
        rest = (active, cells, nodes, inverse, gravity, friction, radius, obstacles, damping, dt)
        move_nodes(active[0], active[1], grid, gap, *rest)
        # An impulse J works J · (v + v') / 2 on a node; together these are the change of its kinetic energy, exactly.
        halfway, held = grid[:, :3] - grid[:, 4:7] / 2, grid[:, 3] > 0
        of_walls = grid[:, 3:4] * (grid[:, 4:7] - dt * np.array(gravity)) - impulse
        walls -= float((of_walls * halfway)[held].sum())
        deviator, mean, opened = stress[:, :6].copy(), felt(), stress[:, 6] <= -tension
        rate = affine[:, [0, 4, 8]].sum(axis=1)
        resisting = np.where(opened, mean, np.maximum(mean - viscosity * rate, -tension)) - mean
        grid_to_points(
            0, len(mass), position, velocity, affine, stress, index, materials, grid, cells, nodes, inverse, obstacles,
            layers, flip, dt,
        )  # fmt: skip
        against = -dt * float((volume * resisting * affine[:, [0, 4, 8]].sum(axis=1)).sum())
        viscous += against
        xx, xy, xz, yx, yy, yz, zx, zy, zz = affine.T
        mean_deviator, mean_pressure = (deviator + stress[:, :6]).T / 2, (mean + felt()) / 2
        power = (mean_deviator * (xx, yy, zz, xy + yx, yz + zy, zx + xz)).sum(axis=0) - mean_pressure * (xx + yy + zz)
        plastic += dt * float((volume * power).sum()) - (stored() - elastic)
    return rows


def column_energy(aspect_ratio: float, cells: int = 16) -> list[dict[str, float]]:
    """Return the energy balance of a column of the laws over 6 √(H0/g)."""
    scene, tau = plane_scene(aspect_ratio, 30.0, 6.0)
    return energy_balance(scene, settings(min(1.0, aspect_ratio) * RADIUS / cells), tau)


def write_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write a CSV file with the union of the rows' keys."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def draw(rows: list[dict[str, str]], energies: list[dict[str, str]], path: Path) -> None:
    """Draw runout, height, arrest, repose, round columns and energies beside what is published."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from gns_pl.viz.plots import COLOURS, STYLE

    def column(kind: str, name: str, angle: str = "30") -> NDArray[np.float64]:
        kept = [row for row in rows if row["kind"] == kind and row["friction_angle_deg"] == angle]
        return np.array([float(row[name]) for row in kept])

    orange, blue, green = COLOURS[1:]
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(2, 3, figsize=(10.5, 6.2), layout="constrained")
        ratio, curve = column("plane", "aspect_ratio"), np.geomspace(0.3, 8, 100)
        styles = ("-", "--", "-.", ":")
        axis = axes[0, 0]
        for law, style in zip(LAWS, styles, strict=True):
            axis.loglog(curve, [law(a) for a in curve], style, color="0.5", lw=1, label=law.source)
        axis.loglog(ratio, column("plane", "runout_99"), "o", color=blue, label="ours, 99 % of the mass")
        axis.loglog(ratio, column("plane", "runout_max"), "^", color=blue, mfc="none", label="ours, maximum")
        rough = [row for row in rows if row["kind"] == "plane" and row["friction_angle_deg"] == "65"]
        axis.loglog(*([float(row[k]) for row in rough] for k in ("aspect_ratio", "runout_99")), "x", color=orange,
                    label="ours, φ = 65° (negative control)")  # fmt: skip
        axis.set(xlabel="aspect ratio $a = H_0/L_0$", ylabel="final runout $(L - L_0)/L_0$", title="plane channel")
        axis.legend(fontsize=6, loc="upper left")
        axis = axes[0, 1]
        axis.loglog(curve, [lube_height(a) for a in curve], "-", color="0.5", lw=1, label="Lube et al. 2005")
        axis.loglog(ratio, column("plane", "height_99"), "o", color=blue, label="ours, 99 % of the mass")
        axis.set(xlabel="aspect ratio", ylabel="final height $H/L_0$", title="plane channel")
        axis.legend()
        axis = axes[0, 2]
        axis.axhspan(2.7, 3.5, color="0.9", label="front at rest in experiments, 2.7–3.5")
        axis.semilogx(ratio, column("plane", "arrest_time"), "o", color=blue, label="ours, last 2 % of the advance")
        axis.set(xlabel="aspect ratio", ylabel=r"time of arrest [$\sqrt{H_0/g}$]", ylim=(0, 5), title="plane channel")
        axis.legend()
        axis = axes[1, 0]
        axis.loglog(curve, [AXISYMMETRIC(a) for a in curve], "-", color="0.5", lw=1, label=AXISYMMETRIC.source)
        axis.loglog(column("axisymmetric", "aspect_ratio"), column("axisymmetric", "runout_99"), "o", color=blue,
                    label="ours, 99 % of the mass")  # fmt: skip
        axis.set(
            xlabel="aspect ratio $H_0/R_0$", ylabel="final runout $(R - R_0)/R_0$", title="quarter of a round column"
        )
        axis.legend()
        axis = axes[1, 1]
        repose = [(float(r["friction_angle_deg"]), float(r["slope_deg"])) for r in rows if r["kind"] == "repose"]
        axis.plot([15, 50], [15, 50], "-", color="0.5", lw=1, label="slope = φ")
        axis.plot(*zip(*repose, strict=True), "o", color=blue, label="ours, heap at an edge")
        axis.set(xlabel="angle of friction φ [°]", ylabel="slope of the heap [°]", title="angle of repose")
        axis.legend()
        axis = axes[1, 2]
        here = [row for row in energies if float(row["aspect_ratio"]) == 2.0]
        parts = ("potential", "kinetic", "stored", "plastic", "walls", "viscous", "transfer")
        shades = ("0.85", blue, orange, green, "#CC79A7", "#F0E442", "0.4")
        names = (
            "potential",
            "kinetic",
            "stored elastically",
            "plastic flow",
            "friction of the floor",
            "viscous",
            "transfers",
        )
        times = [float(row["time_tau"]) for row in here]
        heights = [[max(float(row[part]), 0.0) for row in here] for part in parts]
        axis.stackplot(times, *heights, labels=names, colors=shades)
        axis.set(xlabel=r"time [$\sqrt{H_0/g}$]", ylabel="energy / energy at the start", ylim=(0, 1.02), xlim=(0, 6))
        axis.set_title("where the energy is and went, a = 2")
        axis.legend(loc="lower left", fontsize=6, frameon=True)
        for axis in axes.flat[:4]:
            axis.set_xticks([0.5, 1, 2, 4], ["0.5", "1", "2", "4"], minor=False)
            axis.set_xticks([], minor=True)
        for axis, ticks in ((axes[0, 0], [0.5, 1, 2, 5, 10]), (axes[0, 1], [0.5, 1, 2]), (axes[1, 0], [0.5, 1, 2, 4])):
            axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
            axis.set_yticks([], minor=True)
        figure.savefig(path)
        plt.close(figure)


def main() -> None:
    """Run everything, print it, write it down and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--figure", action="store_true", help="only draw what was written down before")
    if parser.parse_args().figure:
        draw(read_rows(DOCS / "mpm_validation.csv"), read_rows(DOCS / "mpm_energy.csv"), DOCS / "mpm_validation.png")
        return
    rows: list[dict[str, Any]] = []

    def note(kind: str, **values: Any) -> None:
        rows.append({"kind": kind} | values)
        print(kind, *(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in values.items()), flush=True)

    for aspect_ratio in ASPECT_RATIOS:
        note("plane", friction_angle_deg=30.0, aspect_ratio=aspect_ratio, **plane_column(aspect_ratio))
    for angle in FRICTION_ANGLES:
        note("repose", friction_angle_deg=angle, slope_deg=angle_of_repose(angle))
    note("plane", friction_angle_deg=65.0, aspect_ratio=0.8, **plane_column(0.8, 65.0))
    note("plane", friction_angle_deg=65.0, aspect_ratio=2.0, **plane_column(2.0, 65.0))
    energies = []
    for aspect_ratio in (0.8, 2.0):
        balance = column_energy(aspect_ratio)
        energies += [{"aspect_ratio": aspect_ratio} | row for row in balance]
        note("energy", aspect_ratio=aspect_ratio, **balance[-1])
    for aspect_ratio in (0.5, 0.8, 1.2, 2.0, 3.0):
        note("axisymmetric", friction_angle_deg=30.0, aspect_ratio=aspect_ratio, **axisymmetric_column(aspect_ratio))
    write_rows(DOCS / "mpm_validation.csv", rows)
    write_rows(DOCS / "mpm_energy.csv", energies)
    draw(read_rows(DOCS / "mpm_validation.csv"), read_rows(DOCS / "mpm_energy.csv"), DOCS / "mpm_validation.png")


if __name__ == "__main__":
    main()
