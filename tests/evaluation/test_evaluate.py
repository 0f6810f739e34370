"""A whole evaluation: a real simulator, untrained, against a made-up reference."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

import gns_pl.rollout
from gns_pl.checkpoint import Checkpoint, save_checkpoint
from gns_pl.errors import InputError
from gns_pl.evaluation import evaluate as module
from gns_pl.evaluation import references as module_references
from gns_pl.evaluation.curves import CURVES, read_curves
from gns_pl.evaluation.evaluate import evaluate_all
from gns_pl.evaluation.metrics import COMPARISON, SUMMARY
from gns_pl.scene import write_scene
from tests.conftest import make_simulator
from tests.evaluation.made_up import column, spreading
from tests.evaluation.test_scenes import DATA

SETTINGS = {
    "columns": {"short": {"length": 0.4, "height": 0.2}, "tall": {"length": 0.2, "height": 0.4}},
    "scenes": None,
    "split": None,
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
    assert stored["checkpoint"]["data"]["mpm"] == {"cell_size": 0.1}

    table = read_curves(out / "curves_short.csv")
    assert len(table) == 2 * len(CURVES) - 2
    assert table["reference.runout_99"][-1] == pytest.approx(scene["reference"]["runout_99"])
    assert table["learned.mean_height"][-1] == pytest.approx(scene["learned"]["mean_height"])


def test_films_and_series_in_three_dimensions(checkpoint, tmp_path) -> None:
    imageio = pytest.importorskip("imageio.v3")
    pyvista = pytest.importorskip("pyvista")
    from gns_pl.viz.studio import draws_without_screen

    if not draws_without_screen():
        pytest.skip("VTK finds no OpenGL to draw without a screen")
    out = tmp_path / "out"
    run(checkpoint, tmp_path, only="short", film="gif", paraview=True, animation={"num_frames": 4, "width": 401})
    assert len(imageio.imread(out / "film_short.gif")) == 4
    assert imageio.imread(out / "still_short.png").std() > 10
    reader = pyvista.get_reader(out / "paraview" / "learned_short.pvd")
    reader.set_active_time_value(reader.time_values[-1])
    arrays = reader.read()[0].point_data
    assert {"velocity", "displacement", "error"} <= set(arrays.keys())
    assert np.abs(arrays["error"]).max() > 0
    assert "error" not in pyvista.get_reader(out / "paraview" / "reference_short.pvd").read()[0].point_data
    with pytest.raises(InputError, match="must be mp4, gif or null"):
        run(checkpoint, tmp_path, film="avi")


def test_a_copy_elsewhere_gives_the_same_numbers(checkpoint, tmp_path, monkeypatch) -> None:
    here = run(checkpoint, tmp_path, only="tall")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    shutil.copy(checkpoint, elsewhere / "copy.ckpt")
    monkeypatch.chdir(elsewhere)
    settings = SETTINGS | {"out": module.Path("out"), "cache": module.Path("cache"), "only": "tall"}
    there = evaluate_all({"copy": module.Path("copy.ckpt")}, **settings)["copy"]
    assert (elsewhere / "out" / "metrics.json").is_file()
    for document in (here, there):
        del document["run"]
        for scene in document["scenes"].values():
            del scene["wall_seconds"], scene["made_by"]
    assert here == there


def test_every_kth_point_of_a_fine_reference_is_judged(checkpoint, tmp_path, references) -> None:
    mpm = {"cell_size": 0.1, "points_per_direction": 2, "courant": 0.3, "transfer": "apic", "damping_rate": 0}
    data = DATA | {"mpm": mpm | {"bulk_viscosity": 0.3, "jitter": 0}, "store_every": [4, 2]}
    # `spreading` has 8 x 10 x 4 points and moves them by as far as they stood from the wall; kept from 0 and from 1 on.
    for every, number, last in ((2, 4 * 5 * 2, 6), (None, 2 * 3 * 1, 5)):
        chosen = data | ({"every": every} if every else {})
        save_checkpoint(checkpoint, Checkpoint(make_simulator(dt=0.02, connectivity_radius=0.4), chosen, {"steps": 0}))
        scene = run(checkpoint, tmp_path, only="short")["scenes"]["short"]
        assert scene["num_particles"] == number
        assert scene["made_by"]["reference"]["every"] == (every or 4)
        assert scene["no_motion"]["runout_99"] == 0
        assert scene["reference"]["runout_99"] == pytest.approx((last + 0.5) / 8, rel=1e-4)
    assert {call[1]["cell_size"] for call in references} == {0.1}


def test_a_rollout_that_fails_is_reported_and_the_rest_goes_on(checkpoint, tmp_path, monkeypatch, capsys) -> None:
    def broken(simulator, start, num_steps, *, on_step=None):
        learned = spreading(start.scene, num_steps + 1, dt=start.dt)
        if start.scene.name == "tall":
            return learned
        position = learned.position.copy()
        position[4, 0] = np.nan
        return replace(learned, position=position)

    monkeypatch.setattr(gns_pl.rollout, "rollout", broken)
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
    assert list(folder.glob("*.wandb")) and not (tmp_path / "wandb").exists()


def test_other_refusals(checkpoint, tmp_path, monkeypatch) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="another folder with out="):
        run(checkpoint, tmp_path, out=tmp_path / "file")
    with pytest.raises(InputError, match=r"evaluation\.device=abacus"):
        run(checkpoint, tmp_path, device="abacus")
    write_scene(column(2), tmp_path / "flat.yaml")
    with pytest.raises(InputError, match="has 2 dimensions"):
        run(checkpoint, tmp_path, scenes=[str(tmp_path / "flat.yaml")])
    save_checkpoint(tmp_path / "foreign.ckpt", Checkpoint(make_simulator(), {"name": "imported"}, {}))
    with pytest.raises(InputError, match="by which MPM"):
        run(tmp_path / "foreign.ckpt", tmp_path)
    monkeypatch.setattr("gns_pl.viz.missing_packages", lambda: ["matplotlib"])
    with pytest.raises(InputError, match=r"pip install 'gns_pl\[viz\]'"):
        module.check_figures()
