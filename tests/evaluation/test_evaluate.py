"""A whole evaluation: a real simulator, untrained, against a made-up reference."""

import errno
import json
import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

import gns_pl.rollout
from gns_pl.errors import InputError
from gns_pl.evaluation import evaluate as module
from gns_pl.evaluation import references as module_references
from gns_pl.evaluation.evaluate import evaluate_all
from gns_pl.evaluation.figures import of_columns
from gns_pl.evaluation.tracking import _table
from gns_pl.io import read_trajectory, tracking
from gns_pl.metrics.curves import CURVES, compute_curves, cut, read_curves
from gns_pl.metrics.measures import position_mse, rollout_mse
from gns_pl.metrics.summary import COMPARISON, SUMMARY, profile_l1, summarise
from gns_pl.models.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from gns_pl.scene import read_raster, scene_from_dict, write_scene
from gns_pl.solvers.learned import LearnedSolver
from tests.conftest import make_simulator
from tests.evaluation.made_up import column, spreading
from tests.evaluation.test_scenes import DATA
from tests.offline_run import media, read_offline_run

SETTINGS = {
    "columns": {"short": {"length": 0.4, "height": 0.2}, "tall": {"length": 0.2, "height": 0.4}},
    "scenes": None,
    "split": None,
    "start": "scene",
    "speed": False,
    "root": None,
    "spread": [],
    "only": None,
    "domain": [1.5, 0.5, 0.7],
    "duration": 1.5,
    "seed": 3,
    "placements": 0,
    "device": "cpu",
    "figures": False,
    "snapshots": [0, 1],
    "animation": {"num_frames": 6, "width": 400},
    "film": None,
    "paraview": False,
    "maps": False,
    "reached": None,
    "save_trajectories": False,
    "logger": None,
    "stabilise": {},
}


@pytest.fixture
def checkpoint(tmp_path):
    path = tmp_path / "run" / "last.ckpt"
    path.parent.mkdir()
    save_checkpoint(path, Checkpoint(make_simulator(dt=0.02), DATA | {"mpm": {"cell_size": 0.1}}, {"steps": 0}))
    return path


@pytest.fixture(autouse=True)
def one_thread():
    """Threads that wait for one another cost more than these few particles."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(autouse=True)
def references(monkeypatch):
    """Stand-in for the MPM; returns the calls made."""
    calls = []

    def made_up(scene, mpm, *, frame_interval, seed, cache_directory):
        calls.append((scene.name, dict(mpm), frame_interval, seed, cache_directory))
        return spreading(scene, round(scene.duration / frame_interval) + 1, dt=frame_interval)

    monkeypatch.setattr(
        module_references, "reference_trajectory", lambda scene, *, mpm, **rest: made_up(scene, mpm, **rest)
    )
    return calls


class Tables:
    """Stand-in for W&B: a table that keeps its rows."""

    class Table:
        def __init__(self, columns) -> None:
            self.columns, self.rows = columns, []

        def add_data(self, *row) -> None:
            assert len(row) == len(self.columns)
            self.rows.append(row)


def run(checkpoint, tmp_path, **changes):
    settings = {"out": tmp_path / "out", "cache": tmp_path / "cache"} | SETTINGS | changes
    return evaluate_all({"run": checkpoint}, **settings)["run"]


def test_what_is_made(checkpoint, tmp_path, references, capsys) -> None:
    out = tmp_path / "out"
    document = run(checkpoint, tmp_path, figures=True, save_trajectories=True)
    assert references[0] == ("short", {"cell_size": 0.1}, 0.02, 3, tmp_path / "cache")
    made = [path.name for path in out.iterdir()]
    expected = {"metrics.json", "table.md", "report.html", "runout_height.png", "runout_height.pdf", "energy.png"}
    for name in SETTINGS["columns"]:
        expected |= {f"curves_{name}.csv", f"evolution_{name}.png", f"evolution_{name}.pdf", f"{name}.gif"}
        expected |= {f"reference_{name}.h5", f"learned_{name}.h5"}
    assert set(made) == expected
    assert all((out / name).stat().st_size > 500 for name in made)
    with Image.open(out / "short.gif") as gif:
        assert gif.n_frames == 6
    printed = capsys.readouterr().out
    assert all(str(out / name) in printed for name in expected)

    stored = json.loads((out / "metrics.json").read_text(), parse_constant=pytest.fail)
    assert stored == document
    scene = stored["scenes"]["short"]
    assert set(scene["reference"]) == set(scene["learned"]) == {quantity.name for quantity in SUMMARY}
    assert set(scene["errors"]["learned"]) == set(scene["errors"]["no_motion"]) == {q.name for q in COMPARISON}
    assert scene["failed_at"] is None and scene["aspect_ratio"] == pytest.approx(0.5)
    assert scene["no_motion"]["runout_99"] == 0
    assert scene["wall_seconds"]["learned"] > 0
    assert stored["checkpoint"]["data"]["mpm"] == {"cell_size": 0.1} and stored["checkpoint"]["name"] == "run"

    table = read_curves(out / "curves_short.csv")
    assert len(table) == 2 * len(CURVES) - 2
    assert table["reference.runout_99"][-1] == pytest.approx(scene["reference"]["runout_99"])
    assert table["learned.mean_height"][-1] == pytest.approx(scene["learned"]["mean_height"])


def test_films_and_series_in_three_dimensions(checkpoint, tmp_path) -> None:
    pyvista = pytest.importorskip("pyvista")
    from gns_pl.viz.vtk_renderer import draws_without_screen

    if not draws_without_screen():
        pytest.skip("VTK finds no OpenGL to draw without a screen")
    out = tmp_path / "out"
    run(checkpoint, tmp_path, only="short", film="gif", paraview=True, animation={"num_frames": 4, "width": 401})
    with Image.open(out / "film_short.gif") as film, Image.open(out / "still_short.png") as still:
        assert film.n_frames == 4 and np.asarray(still).std() > 10
    reader = pyvista.get_reader(out / "paraview" / "learned_short.pvd")
    reader.set_active_time_value(reader.time_values[-1])
    arrays = reader.read()[0].point_data
    assert {"velocity", "displacement", "error"} <= set(arrays.keys())
    assert np.abs(arrays["error"]).max() > 0
    assert "error" not in pyvista.get_reader(out / "paraview" / "reference_short.pvd").read()[0].point_data
    with pytest.raises(InputError, match="must be mp4, gif or null"):
        run(checkpoint, tmp_path, film="avi")


def test_maps_of_rollout_and_reference_are_on_the_same_cells(checkpoint, tmp_path) -> None:
    run(checkpoint, tmp_path, only="short", maps=True, reached=0.03)
    learned, reference = (
        read_raster(tmp_path / "out" / "maps" / f"{name}_short_deposit.asc") for name in ("learned", "reference")
    )
    assert (learned.corner, learned.cell) == (reference.corner, reference.cell)
    for deposit in (learned, reference):
        assert deposit.values.sum() * deposit.cell**2 == pytest.approx(0.4 * 0.5 * 0.2, rel=1e-3)


def test_a_copy_elsewhere_gives_the_same_numbers(checkpoint, tmp_path, monkeypatch) -> None:
    here = run(checkpoint, tmp_path, only="tall")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    shutil.copy(checkpoint, elsewhere / "copy.ckpt")
    monkeypatch.chdir(elsewhere)
    settings = SETTINGS | {"out": module.Path("out"), "cache": module.Path("cache"), "only": "tall"}
    there = evaluate_all({"run": module.Path("copy.ckpt")}, **settings)["run"]
    assert (elsewhere / "out" / "metrics.json").is_file()
    for document in (here, there):
        del document["run"]
        for scene in document["scenes"].values():
            del scene["wall_seconds"], scene["made_by"]
    assert here == there


def test_numbers_of_the_reference_are_of_all_its_points_and_the_rollout_has_every_kth(
    checkpoint, tmp_path, references
) -> None:
    mpm = {"cell_size": 0.1, "points_per_direction": 2, "courant": 0.3, "transfer": "apic", "damping_rate": 0}
    data = DATA | {"mpm": mpm | {"bulk_viscosity": 0.3, "jitter": 0}, "store_every": [4, 2]}
    # `spreading` has 8 x 10 x 4 points and moves them by as far as they stood from the wall.
    for every, number in ((2, 4 * 5 * 2), (None, 2 * 3 * 1)):
        chosen = data | ({"every": every} if every else {})
        save_checkpoint(checkpoint, Checkpoint(make_simulator(dt=0.02, connectivity_radius=0.4), chosen, {"steps": 0}))
        scene = run(checkpoint, tmp_path, only="short", save_trajectories=True)["scenes"]["short"]
        assert scene["num_particles"] == number
        assert scene["reference_points"] == {"number": 320, "spacing": pytest.approx(0.05, rel=1e-3), "all": True}
        assert scene["made_by"]["reference"]["every"] == (every or 4)
        assert scene["no_motion"]["runout_99"] == 0
        out = tmp_path / "out"
        kept, learned = (read_trajectory(out / f"{key}_short.h5") for key in ("reference", "learned"))
        assert kept.num_particles == number
        whole = spreading(kept.scene, kept.num_frames, dt=0.02)
        expected, other, got = (summarise(each) for each in (whole, kept, learned))
        assert abs(other["runout_99"] - expected["runout_99"]) > 0.01  # by which the kept points are wrong
        for name in ("runout_99", "runout_max", "height_99", "mean_height", "kinetic_energy_peak", "density"):
            assert scene["reference"][name] == pytest.approx(expected[name], rel=1e-5), name
        assert read_curves(out / "curves_short.csv")["reference.runout_99"][-1] == pytest.approx(expected["runout_99"])
        assert f"| {expected['runout_99']:.3g} |" in (out / "table.md").read_text()
        assert of_columns([scene])["MPM"][0][1] == pytest.approx(expected["runout_99"])
        logged = {(row[0], row[1]): row[2] for row in _table(Tables, {"scenes": {"short": scene}}).rows}
        assert logged["short", "runout_99"] == pytest.approx(expected["runout_99"])
        errors = scene["errors"]["learned"]
        for name in ("runout_99", "height_99", "mean_height", "kinetic_energy_peak"):
            assert errors[f"{name}_error"] == pytest.approx(got[name] / expected[name] - 1, abs=1e-5), name
        assert errors["profile_l1"] == pytest.approx(profile_l1(learned, whole), rel=1e-5)
        assert errors["mse_end"] == pytest.approx(rollout_mse(position_mse(learned, kept), kept.num_frames - 1))
    assert {call[1]["cell_size"] for call in references} == {0.1}


def test_the_headline_is_the_mean_over_placements(checkpoint, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(
        "gns_pl.rollout.failure.first_failure", lambda run: None
    )  # untrained, it reaches unphysical states
    mpm = {"cell_size": 0.1, "points_per_direction": 2, "jitter": 0.5}
    save_checkpoint(checkpoint, Checkpoint(make_simulator(dt=0.02), DATA | {"mpm": mpm}, {"steps": 0}))
    document = run(checkpoint, tmp_path, only="short", placements=3, seed=5)
    judged = load_checkpoint(checkpoint)
    scene, found = scene_from_dict(document["scenes"]["short"]["scene"]), document["scenes"]["short"]
    starts = [LearnedSolver.of(judged).start(scene, seed) for seed in (5, 6, 7)]
    runs = [gns_pl.rollout.rollout(judged.simulator, start, found["num_steps"]) for start in starts]
    curves = [compute_curves(each) for each in runs]
    ends = np.array([each["runout_99"][-1] for each in curves])
    truth = found["reference"]["runout_99"]
    assert ends.std() > 0 and found["placements"]["runout_99"] == pytest.approx(ends)
    assert found["learned"]["runout_99"] == pytest.approx(ends.mean())
    assert found["errors"]["learned"]["runout_99_error"] == pytest.approx(ends.mean() / truth - 1)
    assert found["placements"]["std"]["runout_99_error"] == pytest.approx(ends.std() / truth)
    mean, std, largest = (100 * value for value in (ends.mean() / truth - 1, ends.std() / truth, min(ends / truth - 1)))
    out = tmp_path / "out"
    assert f"{mean:+.1f} ± {std:.1f} %" in (out / "table.md").read_text()
    page = (out / "report.html").read_text(encoding="utf-8")
    assert (
        f"{-mean:.1f} % shorter than by MPM in the mean of 3 placements (± {std:.1f} %, at most {largest:+.1f} %)"
        in page
    )
    column = read_curves(out / "curves_short.csv")["learned.runout_99"]
    np.testing.assert_allclose(column, np.mean([each["runout_99"] for each in curves], axis=0), rtol=1e-6, atol=1e-9)


def test_placements_that_fail_are_counted_and_left_out(checkpoint, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("gns_pl.rollout.failure.first_failure", lambda run: None)
    whole = LearnedSolver.run

    def broken(solver, start, **others):
        learned = whole(solver, start, **others)
        if start.provenance == {} and np.isclose(start.position[0, 0, 0], second):
            return cut(learned, 4)
        return learned

    mpm = {"cell_size": 0.1, "points_per_direction": 2, "jitter": 0.5}
    judged = Checkpoint(make_simulator(dt=0.02), DATA | {"mpm": mpm}, {"steps": 0})
    save_checkpoint(checkpoint, judged)
    scene = scene_from_dict(run(checkpoint, tmp_path, only="short")["scenes"]["short"]["scene"])
    second = LearnedSolver.of(judged).start(scene, 4).position[0, 0, 0]
    monkeypatch.setattr(LearnedSolver, "run", broken)
    found = run(checkpoint, tmp_path, only="short", placements=3)["scenes"]["short"]
    assert found["placements"]["failed"] == 1 and found["placements"]["runout_99"][1] is None
    others = [found["placements"]["runout_99"][number] for number in (0, 2)]
    assert found["learned"]["runout_99"] == pytest.approx(np.mean(others))
    assert "1 of 3 placements failed" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_rollouts_go_on_from_true_frames(checkpoint, tmp_path) -> None:
    """Four positions are what a step of this simulator needs; from the fourth on the frames are its own."""
    out = tmp_path / "out"
    found = run(checkpoint, tmp_path, only="tall", start="frames", placements=2, save_trajectories=True)
    scene = found["scenes"]["tall"]
    kept, learned = (read_trajectory(out / f"{key}_tall.h5") for key in ("reference", "learned"))
    assert scene["given_frames"] == 4 and learned.num_frames == kept.num_frames
    np.testing.assert_array_equal(learned.position[:4], kept.position[:4])
    judged = load_checkpoint(checkpoint).simulator
    history = torch.from_numpy(kept.position[:4]).transpose(0, 1).contiguous()
    with torch.no_grad():
        following = judged(history, gns_pl.rollout.static_of(kept))
    np.testing.assert_allclose(learned.position[4], following.numpy(), atol=1e-6)
    squared = position_mse(learned, kept)
    assert squared[:4].max() == 0 and scene["errors"]["learned"]["mse_1"] == pytest.approx(squared[4])
    # Of other placements MPM runs these frames alone; its stand-in is the same for every seed.
    start = spreading(kept.scene, 4, dt=0.02)
    placed = gns_pl.rollout.rollout(judged, start, kept.num_frames - 4, given=4)
    assert scene["placements"]["runout_99"] == pytest.approx([summarise(placed)["runout_99"]] * 2)
    assert "go on from 4 frames of MPM" in (out / "table.md").read_text()
    for wrong in ("middle", ["scene", "middle"], []):
        with pytest.raises(InputError, match="start must be one of scene, frames, or a list of them, not "):
            run(checkpoint, tmp_path, start=wrong)
    with pytest.raises(InputError, match=r"has 3 frames, too few to go on from 4"):
        run(checkpoint, tmp_path, only="tall", start="frames", duration=0.18)


def test_both_starts_stand_on_one_page(checkpoint, tmp_path) -> None:
    settings = SETTINGS | {"out": tmp_path / "out", "cache": tmp_path / "cache", "only": "tall"}
    found = evaluate_all({"run": checkpoint}, **settings | {"start": ["scene", "frames"]})
    given = {name: document["scenes"]["tall"]["given_frames"] for name, document in found.items()}
    assert given == {"run_from_scene": 1, "run_from_frames": 4}
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert all(name in page and (tmp_path / "out" / name / "metrics.json").is_file() for name in found)


def test_a_rollout_that_fails_is_reported_and_the_rest_goes_on(checkpoint, tmp_path, monkeypatch, capsys) -> None:
    def broken(solver, start, *, num_steps, **others):
        learned = spreading(start.scene, num_steps + 1, dt=start.dt)
        if start.scene.name == "tall" or num_steps < 4:
            return learned
        position = learned.position.copy()
        position[4, 0] = np.nan
        return replace(learned, position=position)

    monkeypatch.setattr(LearnedSolver, "run", broken)
    document = run(checkpoint, tmp_path, figures=True)
    short, tall = document["scenes"]["short"], document["scenes"]["tall"]
    assert short["failed_at"] == pytest.approx(0.08)
    assert set(short["learned"].values()) == {None}
    assert short["errors"]["learned"]["finite_fraction"] < 1
    assert tall["failed_at"] is None and tall["errors"]["learned"]["position_error"] == 0
    assert "not finite from t = 0.08 s on" in (tmp_path / "out" / "table.md").read_text()
    assert "not finite from t = 0.08 s on" in capsys.readouterr().out


def test_an_offline_wandb_run_needs_no_account(checkpoint, tmp_path, monkeypatch) -> None:
    monkeypatch.delenv("WANDB_API_KEY", raising=False)
    monkeypatch.chdir(tmp_path)
    run(checkpoint, tmp_path, only=["short"], figures=True, logger={"offline": True, "project": "test"})
    import wandb

    assert wandb.run is None
    [folder] = (tmp_path / "out" / "wandb").glob("offline-run-*")
    kinds = {path.suffix for path in folder.rglob("media/**/*") if path.is_file()}
    assert kinds == {".png", ".gif", ".json"}
    assert not (tmp_path / "wandb").exists()
    offline, metrics = read_offline_run(folder), json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert offline.job_type == "evaluation" and {"metrics", "runout_height"} < media(folder, offline)
    for group in ("learned", "reference"):
        for name, value in metrics["scenes"]["short"][group].items():
            assert offline.summary[f"short/{group}/{name}"] == value


def test_wandb_is_switched_off_by_its_own_variable(checkpoint, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("WANDB_MODE", "disabled")
    run(checkpoint, tmp_path, only=["short"], logger={"offline": False, "project": "test"})
    assert (tmp_path / "out" / "metrics.json").is_file() and not (tmp_path / "out" / "wandb").exists()


@pytest.mark.parametrize(
    ("variable", "offline", "mode"),
    [
        (None, True, "offline"),
        (None, False, "online"),
        ("disabled", False, "disabled"),
        ("offline", False, "offline"),
        ("dryrun", False, "offline"),
        ("online", True, "offline"),
        ("online", False, "online"),
    ],
)
def test_the_variable_of_wandb_may_only_ask_for_less(variable, offline, mode, monkeypatch) -> None:
    monkeypatch.delenv("WANDB_MODE", raising=False)
    if variable is not None:
        monkeypatch.setenv("WANDB_MODE", variable)
    assert tracking.wandb_mode(offline) == mode
    monkeypatch.setenv("WANDB_MODE", "of")
    with pytest.raises(InputError, match="WANDB_MODE=of: W&B knows online, offline and disabled"):
        tracking.wandb_mode(offline)


def test_what_wandb_cannot_write_costs_no_result(checkpoint, tmp_path, monkeypatch, capsys) -> None:
    """Its tables go through a folder of its own, which may lie on a file system that cannot sync."""

    def refuse(*args: object) -> None:
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(os, "fsync", refuse)
    run(checkpoint, tmp_path, only=["short"], logger={"offline": True, "project": "test"})
    assert "W&B could not write its files ([Errno 22] Invalid argument)" in capsys.readouterr().err
    import wandb

    assert wandb.run is None and (tmp_path / "out" / "metrics.json").is_file()


def test_other_refusals(checkpoint, tmp_path, monkeypatch) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="another folder with out="):
        run(checkpoint, tmp_path, out=tmp_path / "file")
    with pytest.raises(InputError, match=r"evaluation\.placements must be 0 or more, not -1"):
        run(checkpoint, tmp_path, placements=-1)
    with pytest.raises(InputError, match=r"evaluation\.device=abacus"):
        run(checkpoint, tmp_path, device="abacus")
    write_scene(column(2), tmp_path / "flat.yaml")
    with pytest.raises(InputError, match="has 2 dimensions"):
        run(checkpoint, tmp_path, scenes=[str(tmp_path / "flat.yaml")])
    save_checkpoint(tmp_path / "foreign.ckpt", Checkpoint(make_simulator(), {"name": "imported"}, {}))
    with pytest.raises(InputError, match=r"by which MPM.*data\.root=FOLDER evaluation\.split=test"):
        run(tmp_path / "foreign.ckpt", tmp_path)
    with pytest.raises(InputError, match="by which MPM they were made, so none can be timed"):
        run(tmp_path / "foreign.ckpt", tmp_path, speed=True)
    monkeypatch.setattr("gns_pl.viz.missing_packages", lambda: ["matplotlib"])
    with pytest.raises(InputError, match=r"pip install 'gns_pl\[viz\]'"):
        module.check_figures()
