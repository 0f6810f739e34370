"""Whether a learned run can be told to be wrong without MPM: what is known early against the true error, many scenes.

    OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 python benchmarks/trust.py --members CKPT …    # as in docs/trust.md
    python benchmarks/trust.py --add collapse_plane datasets/collapse_plane/every_3 new.ckpt
    python benchmarks/trust.py --from-table                                              # judge docs/trust.csv again

Every scene in plane strain is run by MPM on cells of 1/48 m (kept), by the checkpoint, by the members and from other
placements, all stabilised, from points of the reference's first frame, as `evaluate.py` does; runouts and heights are
compared with those of all points of MPM. What could be chosen was chosen on
scenes of even numbers; figures that count are those of odd ones. `--add` writes a checkpoint again with what its
network saw in training.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np
from scipy.stats import rankdata, spearmanr

from gns_pl.evaluation.bands import ensemble_bands
from gns_pl.generation import chosen_every, reference_trajectory, thin_trajectory
from gns_pl.metrics.curves import compute_curves, cut
from gns_pl.metrics.measures import particle_spacing
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint
from gns_pl.rollout import rollout
from gns_pl.rollout.policy import Policy
from gns_pl.scene import Body, Material, Scene, Wall
from gns_pl.scene.extent import characteristic_time
from gns_pl.solvers.ood import compute_ood
from gns_pl.training.distribution import add_distribution

SAND = Material(
    density=1800, youngs_modulus=2e6, poisson_ratio=0.3, friction_angle_deg=30, cohesion=100, tension_cutoff=50
)
FRICTION, GRAVITY = 0.385, 9.81


@dataclass(frozen=True)
class Trial:
    """A scene to be judged on.

    Attributes:
        group: what of it may be beyond the data.
        scene: the scene.
        coarseness: spacing over that of the data.
    """

    group: str
    scene: Scene
    coarseness: float = 1.0


def scene_of(
    name: str,
    bodies: list[Body],
    *,
    box: tuple[float, float],
    duration: float,
    floor: Wall | None = None,
    tilt: float = 0.0,
    gravity: float = GRAVITY,
    angle: float = 30.0,
) -> Scene:
    """Return a scene in plane strain; `tilt` [degrees] turns gravity towards x+, `angle` is the sand's friction."""
    rough = Wall("friction", FRICTION)
    tilt = math.radians(tilt)
    sand = Material(**{**vars(SAND), "friction_angle_deg": angle})
    return Scene(
        name=name, lower=(0.0, 0.0), upper=box, duration=0.02 * math.ceil(duration / 0.02),
        gravity=(gravity * math.sin(tilt), -gravity * math.cos(tilt)), materials={"sand": sand}, bodies=tuple(bodies),
        walls={"x-": rough, "x+": rough, "z-": floor or rough, "z+": rough},
    )  # fmt: skip


def column(name: str, length: float, ratio: float, taus: float = 7.0, **other: object) -> Scene:
    """Return a column against the x- wall in a box that it cannot cross."""
    height = length * ratio
    wide = 8.0 if other.get("tilt") else max(2.5, length * (1.5 + 3 * ratio))
    box = (wide, max(1.1, height + 0.2))
    taken = taus * math.sqrt(height / float(other.get("gravity", GRAVITY)))  # type: ignore[arg-type]
    body = Body((0.0, 0.0), (length, height), (0.0, 0.0))
    return scene_of(name, [body], box=box, duration=taken, **other)  # type: ignore[arg-type]


def trials() -> Iterator[Trial]:
    """Yield the scenes, those of a group one after the other, drawn from a seed; only drops meet the far wall."""
    draw = np.random.default_rng(5).uniform
    for number in range(14):
        yield Trial("inside", column(f"inside_column_{number}", draw(0.22, 0.36), [0.5, 1, 1.5, 2.5, 3.5, 0.7, 2][number % 7] * draw(0.95, 1.05)))  # fmt: skip  # noqa: E501
    for number in range(6):
        length = draw(0.2, 0.35)
        body = Body((draw(0.2, 0.8), 0.0), (length, length * draw(0.6, 1.7)), (0.0, 0.0))
        yield Trial("inside", scene_of(f"inside_block_{number}", [body], box=(1.5, 1.0), duration=1.2))
    for number in range(6):
        side = draw(0.25, 0.4)
        body = Body((draw(0.1, 0.5), draw(0, 0.2)), (side, side), (draw(-1, 1), draw(-1, 1)))
        yield Trial("inside", scene_of(f"inside_drop_{number}", [body], box=(1.0, 1.0), duration=1.0))
    for number, ratio in enumerate((0.3, 0.3, 4.5, 4.5, 5.0, 5.0, 6.0, 6.0)):
        length = draw(0.3, 0.5) if ratio < 1 else draw(0.2, 0.24)
        yield Trial("aspect ratio", column(f"ratio_{number}", length, ratio))
    for number, (length, ratio) in enumerate(
        ((0.12, 1), (0.15, 1), (0.12, 2), (0.15, 2), (0.7, 0.5), (0.7, 1), (0.9, 0.5), (0.9, 1), (0.6, 2), (0.6, 1.5))
    ):
        yield Trial("size", column(f"size_{number}", length, ratio))
    for number, height in enumerate((0.35, 0.35, 0.5, 0.5, 0.7, 0.7, 0.9, 0.9)):
        side = draw(0.25, 0.4)
        body = Body((draw(0.4, 0.8), height), (side, side), (0.0, 0.0))
        yield Trial("drop height", scene_of(f"height_{number}", [body], box=(1.6, 1.4), duration=1.3))
    for number, speed in enumerate((1.7, 1.7, 2.5, 2.5, 3.5, 3.5, 4.5, 4.5)):
        side = draw(0.25, 0.4)
        body = Body((draw(0.1, 0.3), draw(0, 0.2)), (side, side), (speed, draw(-1, 0.5)))
        yield Trial("speed", scene_of(f"speed_{number}", [body], box=(6.0, 1.1), duration=1.6))
    floors = [Wall("slip"), Wall("slip"), *(Wall("friction", each) for each in (0.1, 0.1, 0.2, 0.2, 0.6, 0.6))]
    for number, floor in enumerate([*floors, Wall("stick"), Wall("stick")]):
        yield Trial("floor", column(f"floor_{number}", draw(0.25, 0.35), draw(0.8, 2.5), floor=floor))
    for number, tilt in enumerate((-15, -15, 4, 4, 8, 8, 12, 12, 15, 15)):
        yield Trial("tilt", column(f"tilt_{number}", draw(0.25, 0.35), draw(0.8, 2.5), tilt=tilt))
    for number, gravity in enumerate((1.62, 1.62, 3.7, 3.7, 20.0, 20.0)):
        yield Trial("gravity", column(f"gravity_{number}", draw(0.25, 0.35), draw(0.8, 2.5), gravity=gravity))
    for number, angle in enumerate((18, 18, 23, 23, 26, 26, 35, 35, 42, 42)):
        yield Trial("sand", column(f"sand_{number}", draw(0.25, 0.35), draw(0.8, 2.5), angle=angle))
    for number in range(8):
        length, gap = draw(0.22, 0.3), draw(0.05, 0.5)
        first = Body((0.0, 0.0), (length, length * draw(0.8, 2)), (0.0, 0.0))
        corner = (length + gap, 0.0) if number // 2 % 2 else (draw(0.0, length), first.size[1] + draw(0.05, 0.2))
        second = Body(corner, (draw(0.2, 0.3), draw(0.2, 0.3)), (0.0, 0.0))
        yield Trial("two bodies", scene_of(f"bodies_{number}", [first, second], box=(2.5, 1.3), duration=1.4))
    for number, coarseness in enumerate((0.8, 0.8, 0.9, 0.9, 1.1, 1.1, 1.2, 1.2)):
        scene = column(f"spacing_{number}", draw(0.25, 0.4), draw(0.6, 3.0))
        yield Trial("spacing", scene, coarseness)


@dataclass(frozen=True)
class Row:
    """What a scene gave.

    Attributes:
        scene: its name.
        group: what of it may be beyond the data.
        number: of the scene; even ones were tuned on.
        particles: of the learned run.
        runout: final, 99 % [L0].
        reference: that of MPM [L0].
        runout_error: |difference| over the reference, or over 0.5 L0 where it is less.
        height_error: of the final mean height, relative.
        position_error: root mean square distance of the particles in the last frame [spacings].
        start: mean distance of the first frame's states.
        early: largest mean distance up to τc.
        far: largest 99 % distance up to τc.
        share: largest share of particles beyond 1 up to τc.
        scene_beyond: 1 if `training_range.out_of_range` yields anything.
        members: width of the band of several trainings, as the error is.
        placements: the same of several placements.
        left: time at which the run left the training range [τc]; NaN if never.
        wrong: time from which the front was off by more than 10 % of the final runout [τc], likewise.
        lost: time from which the particles were off by more than 2 spacings, root mean square [τc], likewise.
        frames: of a τc.
    """

    scene: str
    group: str
    number: int
    particles: int
    runout: float
    reference: float
    runout_error: float
    height_error: float
    position_error: float
    start: float
    early: float
    far: float
    share: float
    scene_beyond: int
    members: float
    placements: float
    left: float
    wrong: float
    lost: float
    frames: float


INDICATORS = ("start", "early", "far", "share", "scene_beyond", "members", "placements", "joined")
WRONG = {"runout_error": 0.1, "height_error": 0.1, "position_error": 3.0}
OFFSETS = ((0, 0), (2, 2), (0, 2))


def judge(number: int, trial: Trial, checkpoint: Checkpoint, members: list[Checkpoint], cache: Path) -> Row:
    """Run a scene by all and compare."""
    interval, scene = checkpoint.simulator.config.dt, trial.scene
    mpm, every = checkpoint.data["mpm"], chosen_every(checkpoint.data)
    mpm = {**mpm, "cell_size": mpm["cell_size"] * trial.coarseness}
    whole = reference_trajectory(scene, mpm, frame_interval=interval, seed=0, cache_directory=cache, progress=False)
    fine = thin_trajectory(whole, mpm, 0, every, [(every - 1) // 2] * 2)
    start, steps = cut(fine, 1), fine.num_frames - 1
    own, *further = [Policy().stepper(each) for each in (checkpoint, *members)]
    made, tau = rollout(own, start, steps), characteristic_time(scene)
    seen = compute_ood(checkpoint, made)
    if seen is None:
        raise SystemExit("this checkpoint does not say what it saw; see --add")
    ours, theirs = compute_curves(made), compute_curves(whole)
    reference, shown = theirs["runout_99"], len(ours["runout_99"])
    scale, failed = max(abs(float(reference[-1])), 0.5), shown <= steps
    distance = made.position.astype(np.float64) - fine.position[:shown]
    away = np.sqrt(np.square(distance).sum(axis=2).mean(axis=1)) / particle_spacing(fine)

    def error(value: float) -> float:
        return math.inf if failed else abs(value)

    def first(found: np.ndarray) -> float:
        return float(seen.time[np.flatnonzero(found)[0]] / tau) if found.any() else math.nan

    early = seen.time <= tau + 1e-9
    others = [cut(thin_trajectory(whole, mpm, 0, every, offset), 1) for offset in OFFSETS]
    duration = steps * interval
    return Row(
        scene=scene.name, group=trial.group, number=number, particles=made.num_particles,
        runout=float(ours["runout_99"][-1]), reference=float(reference[-1]),
        runout_error=error(float(ours["runout_99"][-1] - reference[-1]) / scale),
        height_error=error(float(ours["mean_height"][-1] / theirs["mean_height"][-1] - 1)),
        position_error=error(float(away[-1])),
        start=float(seen.mean[0]), early=seen.early_score(tau), far=float(seen.far[early].max()),
        share=float(seen.share[early].max()), scene_beyond=int(bool(seen.reasons)),
        members=ensemble_bands([own, *further], [start], duration=duration).width / scale,
        placements=ensemble_bands([own], [start, *others], duration=duration).width / scale,
        left=math.nan if seen.exit_time is None else seen.exit_time / tau,
        wrong=first(np.abs(ours["runout_99"] - reference[:shown]) / scale > 0.1), lost=first(away > 2),
        frames=tau / interval,
    )  # fmt: skip


def area(score: np.ndarray, wrong: np.ndarray) -> float:
    """Return the area under the ROC curve: how often a wrong run has the larger score."""
    if wrong.all() or not wrong.any():
        return math.nan
    ranks, number = rankdata(score), int(wrong.sum())
    return float((ranks[wrong].sum() - number * (number + 1) / 2) / (number * (len(wrong) - number)))


def values(rows: list[Row], name: str) -> np.ndarray:
    """Return a column; "joined" is the early distance, raised to 1 by a scene beyond, plus the widths of both bands."""
    if name == "joined":
        parts = [np.maximum(values(rows, "early"), values(rows, "scene_beyond"))]
        parts += [values(rows, "members"), values(rows, "placements")]
        return np.asarray(sum(parts))
    return np.array([getattr(row, name) for row in rows], dtype=float)


def report(rows: list[Row]) -> None:
    """Print correlations, areas and lead times of each half."""
    halves = {"even": [r for r in rows if r.number % 2 == 0], "odd": [r for r in rows if r.number % 2]}
    for half, some in halves.items():
        print(f"\n{half} numbers: {len(some)} scenes; Spearman's correlation | area under ROC")
        for name, limit in WRONG.items():
            print(f"  wrong by {name} > {limit:g}: {int((values(some, name) > limit).sum())}")
        print(f"{'':14}" + "".join(f"{name:>18}" for name in WRONG) + " |" + "".join(f"{name:>16}" for name in WRONG))
        for each in INDICATORS:
            score = values(some, each)
            right = [spearmanr(score, values(some, name)).statistic for name in WRONG]
            under = [area(score, values(some, name) > limit) for name, limit in WRONG.items()]
            print(f"{each:14}" + "".join(f"{v:18.2f}" for v in right) + " |" + "".join(f"{v:16.2f}" for v in under))
    for what in ("wrong", "lost"):
        for half, some in halves.items():
            late = [row for row in some if not math.isnan(getattr(row, what))]
            told = [row for row in late if row.left <= getattr(row, what)]
            lead = np.array([(getattr(row, what) - row.left) * row.frames for row in told])
            quiet = [row for row in some if math.isnan(getattr(row, what))]
            alarms = sum(not math.isnan(row.left) for row in quiet)
            middle = f"{np.median(lead):.0f} frames before (quartiles {np.quantile(lead, 0.25):.0f}, {np.quantile(lead, 0.75):.0f})"  # noqa: E501
            print(
                f"{half}: {what} in {len(late)}, told before in {len(told)}, {middle}; {alarms} of {len(quiet)} false"
            )
    print(
        f"\n{'group':14}{'n':>3}{'runout':>9}{'height':>9}{'position':>9}{'early':>8}{'beyond':>8}{'left':>6}{'members':>9}{'places':>8}"
    )
    for group in dict.fromkeys(row.group for row in rows):
        some = [row for row in rows if row.group == group]
        middle = {n: float(np.median(values(some, n))) for n in (*WRONG, "early", "members", "placements")}
        left = sum(not math.isnan(row.left) for row in some)
        print(
            f"{group:14}{len(some):3}{middle['runout_error']:9.2f}{middle['height_error']:9.2f}"
            f"{middle['position_error']:9.1f}{middle['early']:8.2f}{sum(row.scene_beyond for row in some):8}{left:6}"
            f"{middle['members']:9.2f}{middle['placements']:8.2f}"
        )


def draw(rows: list[Row], path: Path) -> None:
    """Draw errors against the early distance and the bands' width."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    figure, axes = plt.subplots(1, 3, figsize=(14, 4.4), layout="constrained")
    panels = (("early", "position_error"), ("early", "runout_error"), ("members", "runout_error"))
    words = {
        "early": "largest mean distance to training until τc",
        "members": "width of the band of several trainings, over the runout",
        "position_error": "position error at the end [spacings]",
        "runout_error": "error of the final 99 % runout",
    }
    for axis, (across, up) in zip(axes, panels, strict=True):
        for place, group in enumerate(dict.fromkeys(row.group for row in rows)):
            some = [row for row in rows if row.group == group]
            marker = "o" if group == "inside" else "^vs<>DpX*P"[place % 10]
            x, y = np.maximum(values(some, across), 3e-3), np.maximum(values(some, up), 3e-3)
            axis.plot(x, y, marker, label=group, color=f"C{place % 10}" if place < 10 else "k", markersize=5)
        odd = [row for row in rows if row.number % 2]
        rho = spearmanr(values(odd, across), values(odd, up)).statistic
        axis.axhline(WRONG[up], color="0.7", linestyle="--", linewidth=0.8)
        axis.set(
            xscale="log", yscale="log", xlabel=words[across], ylabel=words[up], title=f"odd numbers: ρ = {rho:.2f}"
        )
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=7)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Run, or judge a table again."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ckpt", default="collapse_plane")
    parser.add_argument("--members", nargs="*", default=[], help="further trainings")
    parser.add_argument("--cache", type=Path, default=Path("runs/references"))
    parser.add_argument("--out", type=Path, default=Path("docs/trust.csv"))
    parser.add_argument("--from-table", action="store_true", help="judge --out again, run nothing")
    parser.add_argument("--add", nargs=3, metavar=("CKPT", "DATA", "OUT"), help="add to a checkpoint what it saw")
    args = parser.parse_args()
    if args.add:
        print(add_distribution(args.add[0], Path(args.add[1]), Path(args.add[2])) or f"{args.add[2]}: written")
        return
    types = {"int": int, "float": float, "str": str}
    if args.from_table:
        with args.out.open(newline="") as file:
            rows = [Row(**{f.name: types[str(f.type)](r[f.name]) for f in fields(Row)}) for r in csv.DictReader(file)]
    else:
        checkpoint, members = load_checkpoint(args.ckpt), [load_checkpoint(each) for each in args.members]
        rows = []
        for number, trial in enumerate(trials()):
            rows.append(judge(number, trial, checkpoint, members, args.cache))
            row = rows[-1]
            print(
                f"{row.scene:18} error {row.runout_error:.2f}, early {row.early:.2f}, left {row.left:.2f}", flush=True
            )
        with args.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, [each.name for each in fields(Row)])
            writer.writeheader()
            writer.writerows({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in asdict(r).items()} for r in rows)
    report(rows)
    draw(rows, args.out.with_suffix(".png"))


if __name__ == "__main__":
    main()
