"""Friction angle and initial velocity from a deposit: gradients through the rollout, differences of it, and MPM.

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 python examples/inverse.py    # docs/inverse.md, in minutes
    python examples/inverse.py --truths 1 --out runs/inverse    # a first look
    python examples/inverse.py --from-table    # page and figure again

A square of sand is thrown along a floor; place, size and floor are known, friction angle φ and velocity u are not. What
is observed is the deposit that fine MPM leaves: its thickness along the floor, not where any particle went.
"""

from __future__ import annotations

import argparse
import copy
import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from inverse_page import METHODS, read_text, write_figure, write_page

from gns_pl.inverse import Bounds, ByDifferences, ByGradient, Fit, Problem, adam, deposit_thickness, lbfgs, solve
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint
from gns_pl.mpm.settings import run_solver
from gns_pl.scene import Material, Scene, Wall, cube_drop
from gns_pl.solvers.learned import LearnedSolver

STEPS = 60  # of 20 ms
WIDTH = 0.05  # m, of the kernel; the particles are 0.031 m apart
PLACES = torch.arange(0.01, 2.0, 0.02, dtype=torch.float64)  # m
BOUNDS = Bounds((math.tan(math.radians(20)), -1.5), (1.0, 1.5))  # of tan φ and of u [m/s]: those of the data
GUESS = (math.tan(math.radians(32.5)), 0.0)
DIFFERENCES = (5e-3, 1e-2)  # half of each: wide enough for float32, narrow enough for a slope
WIDE = (0.03, 0.15)  # half of each, a twentieth of the range: what a search would want to know
WALK = 40  # steps of Adam
HORIZONS = (1, 5, 10, 20, 30, 40, 60)
FINE, MIDDLE, COARSE = 1 / 48, 1 / 36, 1 / 24  # m, cells of MPM; FINE made the observation and taught the simulator
SOLVE = {"difference": 0.03, "tolerance": 3e-3, "most": 15}


def thrown(data: Mapping[str, Any], angle: float, speed: float) -> Scene:
    """Return the scene: a square just over the floor; `data` has its material and walls, φ [degrees], u [m/s]."""
    return cube_drop(
        domain=(2.0, 0.8), side=0.32, position=(0.6, 0.03), velocity=(speed, 0.0), gravity=data["gravity"],
        duration=STEPS * 0.02, material=Material(**{**data["material"], "friction_angle_deg": angle}),
        walls={face: Wall(**wall) for face, wall in data["walls"].items()},
    )  # fmt: skip


def deposit_of_mpm(data: Mapping[str, Any], unknowns: np.ndarray, cell: float, seed: int) -> torch.Tensor:
    """Return the thickness that MPM on such cells [m] leaves [P] [m]."""
    scene = thrown(data, math.degrees(math.atan(unknowns[0])), float(unknowns[1]))
    run = run_solver(scene, {**data["mpm"], "cell_size": cell}, frame_interval=scene.duration, seed=seed)
    last = torch.from_numpy(run.position[-1]).double()
    walls = (scene.lower[0], scene.upper[0])
    return deposit_thickness(last, torch.from_numpy(run.volume()).double(), PLACES, WIDTH, walls)


def problem_of(checkpoint: Checkpoint, observed: torch.Tensor) -> Problem:
    """Return what is asked of a learned simulator; it is shown the guess in the place of the truth."""
    scene = thrown(checkpoint.data, math.degrees(math.atan(GUESS[0])), GUESS[1])
    start = LearnedSolver.of(checkpoint).start(scene)
    return Problem(checkpoint.simulator.requires_grad_(False), start, STEPS, PLACES, observed, WIDTH)


def truths(number: int) -> list[tuple[float, float]]:
    """Return tan φ and u of the hidden truths."""
    draw = np.random.default_rng(10).uniform
    return [(math.tan(math.radians(draw(23, 42))), draw(0.2, 1.3)) for _ in range(number)]


def fits(
    checkpoint: Checkpoint, number: int, truth: tuple[float, float], only: Sequence[str]
) -> Iterator[dict[str, Any]]:
    """Yield a row for each of the methods `only` of finding a truth's unknowns."""
    data = checkpoint.data
    observed = deposit_of_mpm(data, np.array(truth), FINE, seed=1000 + number)
    problem = problem_of(checkpoint, observed)
    with torch.no_grad():
        own = problem.thickness(problem.rollout(torch.tensor([truth]))[-1, 0]).double()
    twin = replace(problem, observed=own)

    def learned(unknowns: np.ndarray) -> torch.Tensor:
        with torch.no_grad():
            return problem.thickness(problem.rollout(torch.from_numpy(unknowns)[None])[-1, 0]).double()

    def mpm(cell: float) -> Callable[[np.ndarray], torch.Tensor]:
        return lambda unknowns: deposit_of_mpm(data, unknowns, cell, seed=0)

    def descended(slope: ByGradient | ByDifferences) -> tuple[Fit, int]:
        return lbfgs(slope, GUESS, BOUNDS, tolerance=1e-3, most=40), slope.num_rollouts

    def solved(deposit: Callable[[np.ndarray], torch.Tensor]) -> tuple[Fit, int]:
        deposit(np.array(GUESS))  # what is compiled is compiled
        fit = solve(lambda x: ((deposit(x) - observed) / observed.norm()).numpy(), GUESS, BOUNDS, **SOLVE)
        return fit, fit.evaluations

    methods: dict[str, Callable[[], tuple[Fit, int]]] = {
        "gradient": lambda: descended(ByGradient(problem)),
        "gradient, Adam": lambda: (adam(ByGradient(problem), GUESS, BOUNDS, most=WALK, pace=0.08), WALK),
        "differences": lambda: descended(ByDifferences(problem, DIFFERENCES)),
        "least squares": lambda: solved(learned),
        "MPM 1/24 m": lambda: solved(mpm(COARSE)),
        "MPM 1/36 m": lambda: solved(mpm(MIDDLE)),
        "MPM 1/48 m": lambda: solved(mpm(FINE)),
        "gradient, twin": lambda: descended(ByGradient(twin)),
    }
    for name in only:
        yield row(number, truth, name, *methods[name]())


def row(number: int, truth: tuple[float, float], method: str, fit: Fit, rollouts: int) -> dict[str, Any]:
    """Return what stands in docs/inverse.csv of one fit."""
    angle, found = (math.degrees(math.atan(each[0])) for each in (truth, fit.unknowns))
    return {
        "truth": number, "method": method, "angle_deg": f"{angle:.2f}", "speed": f"{truth[1]:.3f}",
        "found_angle_deg": f"{found:.2f}", "found_speed": f"{fit.unknowns[1]:.3f}", "misfit": f"{fit.misfit:.2e}",
        "evaluations": fit.evaluations, "rollouts": rollouts, "seconds": f"{fit.seconds:.1f}",
        "cpu_seconds": f"{fit.cpu_seconds:.3g}",
    }  # fmt: skip


def agreement(problem: Problem, number: int, truth: tuple[float, float]) -> Iterator[dict[str, Any]]:
    """Yield a row for every horizon: gradients half-way from guess to truth against narrow and wide differences."""
    exact = replace(problem, simulator=copy.deepcopy(problem.simulator).double())
    extent, halfway = BOUNDS.extent, (np.array(GUESS) + truth) / 2

    def slope(method: Any) -> np.ndarray:
        return np.asarray(method(halfway)[1]) * extent

    for steps in HORIZONS:
        short, short_exact = replace(problem, num_steps=steps), replace(exact, num_steps=steps)
        gradient, truly = slope(ByGradient(short)), slope(ByGradient(short_exact))
        narrow, wide = slope(ByDifferences(short_exact, (1e-7, 1e-7))), slope(ByDifferences(short, WIDE))
        size = np.linalg.norm
        yield {
            "truth": number, "steps": steps, "size": f"{size(gradient):.3g}",
            "to_narrow": f"{size(truly - narrow) / size(narrow):.1e}",
            "float32_to_float64": f"{size(gradient - truly) / size(truly):.1e}",
            "friction_to_narrow": f"{abs(truly[0] / narrow[0] - 1):.1e}",
            "to_wide": f"{size(gradient - wide) / size(wide):.2g}",
            "friction_share": f"{abs(wide[0]) / size(wide):.2g}",
            "friction_to_wide": f"{abs(gradient[0] / wide[0] - 1):.2g}",
            "friction_same_sign": int(gradient[0] * wide[0] > 0),
        }  # fmt: skip


def write_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write a table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    """Make tables, figure and page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ckpt", default="friction_plane", help="in plane strain, with tan φ as a material feature")
    parser.add_argument("--truths", type=int, default=6, help="hidden truths")
    parser.add_argument("--out", type=Path, default=Path("docs"))
    parser.add_argument("--from-table", action="store_true", help="page and figure from the tables alone")
    parser.add_argument(
        "--only", nargs="*", choices=[*METHODS, "slopes"], help="these anew, the others as in the tables"
    )
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    if not given.from_table:
        checkpoint = load_checkpoint(given.ckpt)
        hidden = list(enumerate(truths(given.truths)))
        only = [*METHODS, "slopes"] if given.only is None else given.only
        table = given.out / "inverse.csv"
        found = [each for each in read_text(table) if each["method"] not in only] if given.only is not None else []
        for number, truth in hidden:
            for each in fits(checkpoint, number, truth, [method for method in METHODS if method in only]):
                print(each, flush=True)
                found.append(each)
        write_rows(table, sorted(found, key=lambda each: (int(each["truth"]), list(METHODS).index(each["method"]))))
        slopes = []
        for number, truth in hidden if "slopes" in only else []:
            observed = deposit_of_mpm(checkpoint.data, np.array(truth), FINE, seed=1000 + number)
            slopes += agreement(problem_of(checkpoint, observed), number, truth)
            write_rows(given.out / "inverse_gradients.csv", slopes)
    write_figure(given.out)
    write_page(given.out)


if __name__ == "__main__":
    main()
