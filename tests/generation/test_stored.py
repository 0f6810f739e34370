"""A fine set stored with every k-th point: a data set for each k, of the same scenes and frames, safe to kill."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gns_pl.data.datamodule import TrajectoryDataModule
from gns_pl.errors import InputError
from gns_pl.fields import OBSERVED
from gns_pl.generation import DatasetSpec, draw_plan, generate_dataset
from gns_pl.generation.records import read_timings
from gns_pl.io import read_header, read_manifest, read_observables, read_trajectory, verify_dataset
from gns_pl.metrics.observables import compute_observables
from gns_pl.mpm import settings as solver
from gns_pl.mpm.settings import place_points
from tests.generation.fake import DROPS, FINE, fake_solver, make_spec, make_thinned_spec
from tests.generation.test_dataset import sums, times

REPOSITORY = Path(__file__).parents[2]
EVERY = (2, 3)


def generate(root: Path, **changes: Any) -> Path:
    spec = {**make_thinned_spec(), **changes}
    return generate_dataset(spec, root=root, num_workers=1, progress=False)


def all_sums(root: Path) -> dict[int, dict[str, str]]:
    return {every: sums(root / f"every_{every}") for every in EVERY}


@pytest.fixture
def root(faked: None, tmp_path: Path) -> Path:
    generate(tmp_path / "set")
    return tmp_path / "set"


def test_there_is_a_data_set_for_every_k(root: Path) -> None:
    assert {path.name for path in root.iterdir()} == {"every_2", "every_3", "generation.json", "timings.csv", ".lock"}
    lines = (root / "timings.csv").read_text().splitlines()
    assert len(lines) == 1 + 8
    spent = sum(float(line.split(",")[1]) for line in lines[1:])
    assert read_timings(root) == pytest.approx(spent) == read_timings(root / "every_2")
    two, three = (verify_dataset(root / f"every_{every}") for every in EVERY)
    assert (two.spacing, three.spacing) == (2 / 16, 3 / 16)
    assert two.spec == three.spec == make_thinned_spec()
    assert two.splits == three.splits
    assert two.statistics["velocity"]["count"] > two.statistics["acceleration"]["count"] > 0
    assert two.statistics["velocity"]["count"] > three.statistics["velocity"]["count"]
    for name in two.files:
        first, second = (read_header(root / f"every_{every}" / name) for every in EVERY)
        assert (first.scene, first.dt, first.num_frames) == (second.scene, second.dt, second.num_frames)
        assert first.num_particles > second.num_particles > 0


@pytest.mark.parametrize("every", EVERY)
def test_the_files_hold_lattice_points_of_the_whole_run(root: Path, tmp_path: Path, every: int) -> None:
    fine = generate_dataset(make_spec(mpm=FINE), root=tmp_path / "fine", num_workers=1, progress=False)
    for planned in draw_plan(DatasetSpec.from_dict(make_thinned_spec())):
        whole, kept = (
            read_trajectory(fine / planned.file_name),
            read_trajectory(root / f"every_{every}" / planned.file_name),
        )
        places = place_points(planned.scene, FINE, planned.seed).lattice
        wanted = (places % every == planned.offsets[every] % np.minimum(every, places.max(axis=0) + 1)).all(axis=1)
        np.testing.assert_array_equal(kept.position, whole.position[:, wanted])
        assert kept.mass.sum(dtype=np.float64) == pytest.approx(whole.mass.sum(dtype=np.float64), rel=1e-6)
        assert kept.provenance == {**whole.provenance, "every": every, "offset": list(planned.offsets[every])}


@pytest.mark.parametrize("sampling", ["lattice", "stratified"])
def test_the_observables_are_those_of_all_points_whichever_are_kept(faked: None, tmp_path: Path, sampling: str) -> None:
    spec = make_thinned_spec(sampling=sampling)
    generate_dataset(spec, root=tmp_path / "set", num_workers=1, progress=False)
    fine = generate_dataset(make_spec(mpm=FINE), root=tmp_path / "fine", num_workers=1, progress=False)
    for planned in draw_plan(DatasetSpec.from_dict(spec)):
        whole = read_trajectory(fine / planned.file_name)
        for every in EVERY:
            wanted = compute_observables(whole, 2 * every / 16)
            found = read_observables(tmp_path / "set" / f"every_{every}" / planned.file_name)
            assert found is not None and found.cell == 2 * every / 16
            for field in OBSERVED:
                np.testing.assert_array_equal(getattr(found, field.name), getattr(wanted, field.name))


def test_points_that_were_drawn_are_not_taken_for_a_lattice(root: Path, tmp_path: Path) -> None:
    drawn = tmp_path / "drawn"
    generate(drawn, sampling="stratified")
    manifest = verify_dataset(drawn / "every_2")
    assert manifest.spec["sampling"] == "stratified" and manifest.splits == read_manifest(root / "every_2").splits
    name = next(iter(manifest.files))
    assert read_header(drawn / "every_2" / name).provenance["sampling"] == "stratified"
    with pytest.raises(InputError, match="sampling is only asked for"):
        generate(root, sampling="stratified")
    (drawn / "every_2" / "manifest.json").unlink()
    shutil.copy(root / "every_2" / name, drawn / "every_2" / name)
    with pytest.raises(InputError, match="holds other points than this data set has there"):
        generate(drawn, sampling="stratified")


@pytest.mark.parametrize("every", EVERY)
def test_statistics_are_those_of_the_files(root: Path, every: int) -> None:
    folder = root / f"every_{every}"
    manifest = read_manifest(folder)
    velocity = [read_trajectory(folder / name).velocity().reshape(-1, 3) for name in manifest.splits["train"]]
    np.testing.assert_allclose(manifest.statistics["velocity"]["mean"], np.concatenate(velocity).mean(axis=0))
    np.testing.assert_allclose(manifest.statistics["velocity"]["std"], np.concatenate(velocity).std(axis=0))


@pytest.mark.parametrize(("every", "wanted"), [(None, 2), (2, 2), (3, 3)])
def test_the_one_to_train_on_is_returned_and_opens(root: Path, every: int | None, wanted: int) -> None:
    folder = generate(root, **({} if every is None else {"every": every}))
    assert folder == root / f"every_{wanted}"
    module = TrajectoryDataModule(
        folder,
        batch_size=2,
        num_steps=3,
        input_sequence_length=3,
        num_targets=1,
        stride=1,
        start_repeats=1,
        moving_repeats=1,
        num_workers=0,
        memory_limit=1e9,
        num_train=None,
        seed=0,
    )
    module.setup("fit")
    assert module.manifest.spacing == wanted / 16
    window = module.train_set[0]
    assert window.num_nodes == module.manifest.files[module.train_names[0]].num_particles
    assert len(list(module.train_dataloader())) == 3


@pytest.mark.parametrize("number", [1, 2, 3])
def test_a_kill_between_the_files_of_a_trajectory(root: Path, tmp_path: Path, number: int) -> None:
    killed = tmp_path / "killed"
    command = [sys.executable, "-m", "tests.generation.dying", str(killed), str(number)]
    assert subprocess.run(command, cwd=REPOSITORY, timeout=60).returncode == -signal.SIGKILL
    left = {every: times(killed / f"every_{every}") for every in EVERY}
    assert sum(map(len, left.values())) == number
    generate(killed)
    assert all_sums(killed) == all_sums(root)
    for every in EVERY:
        assert times(killed / f"every_{every}").items() >= left[every].items()


def test_a_lost_file_is_made_again_and_no_other(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, written = all_sums(root), {every: times(root / f"every_{every}") for every in EVERY}
    (root / "every_3" / "trajectory_0003.h5").unlink()
    runs = []

    def counting(scene: Any, *arguments: Any, **rest: Any) -> Any:
        runs.append(scene.name)
        return fake_solver(scene, *arguments, **rest)

    monkeypatch.setattr(solver, "run_solver", counting)
    monkeypatch.setattr(solver, "compile_solver", lambda *_, **__: None)
    generate(root)
    assert runs == ["cube_drop_0003"]
    assert all_sums(root) == before
    assert times(root / "every_2") == written[2]
    changed = {name for name, when in times(root / "every_3").items() if when != written[3][name]}
    assert changed == {"trajectory_0003.h5"}


def test_a_finished_set_is_left_alone(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gns_pl.generation.dataset.draw_plan", lambda _: pytest.fail("was drawn again"))
    assert generate(root) == root / "every_2"


def test_what_is_coming_is_told(faked: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    generate_dataset(make_thinned_spec(), root=tmp_path / "set", num_workers=1)
    number = sum(len(place_points(p.scene, FINE, 0).mass) for p in draw_plan(DatasetSpec.from_dict(make_spec())))
    told = capsys.readouterr().err
    assert f"small: 8 trajectories, {number:,} particles in all, into {tmp_path}/set; 8 to simulate (" in told
    assert " GB, every 2 and every 3) by 1 process." in told


def test_many_processes_are_told_their_memory(
    faked: None, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gns_pl.generation.dataset.NOTEWORTHY_BYTES", 0)
    generate_dataset(make_thinned_spec(), root=tmp_path / "set", num_workers=1)
    fine = [place_points(p.scene, FINE, 0).mass for p in draw_plan(DatasetSpec.from_dict(make_spec()))]
    held = 7 * 12 * max(map(len, fine)) / 1e9  # frames, bytes of a position
    assert f"by 1 process, each with up to {held:.2g} GB of positions in memory." in capsys.readouterr().err


@pytest.mark.parametrize("there", [[2, 3], None])
def test_other_lattices_are_another_data_set(faked: None, tmp_path: Path, there: list[int] | None) -> None:
    spec = make_spec(mpm=FINE) | ({"store_every": there} if there else {})
    generate_dataset(spec, root=tmp_path / "set", num_workers=1, progress=False)
    with pytest.raises(InputError, match=r"holds another data set \(store_every"):
        generate(tmp_path / "set", store_every=[2])


def test_all_points_are_stored_as_they_always_were(faked: None, tmp_path: Path) -> None:
    root = generate_dataset(make_spec(), root=tmp_path / "set", num_workers=1, progress=False)
    before = times(root)
    assert generate_dataset(make_spec(store_every=[1]), root=root) == root
    assert times(root) == before
    assert "store_every" not in (root / "generation.json").read_text()
    fine = generate_dataset(make_spec(mpm=FINE), root=tmp_path / "fine", num_workers=1, progress=False)
    both = generate(tmp_path / "both", store_every=[1, 2])
    assert both == tmp_path / "both" / "every_1"
    assert {**sums(both), "manifest": ""} == {**sums(fine), "manifest": ""}


def test_half_a_copy_is_named(root: Path) -> None:
    (root / "generation.json").unlink()
    (root / "every_2" / "trajectory_0001.h5").unlink()
    with pytest.raises(InputError, match=r"lacks files of its manifest and generation\.json"):
        generate(root)


def test_files_of_the_other_lattice_are_named_and_kept(root: Path) -> None:
    name = "trajectory_0001.h5"
    shutil.copy(root / "every_2" / name, root / "every_3" / name)
    (root / "every_2" / "manifest.json").unlink()
    with pytest.raises(InputError, match=r"1 of 8 trajectories failed .*every_3/.*: holds other points"):
        generate(root)
    assert (root / "every_3" / name).read_bytes() == (root / "every_2" / name).read_bytes()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"every": 4}, "every is 4, but the set is stored with every 2 or 3; choose one of these"),
        ({"every": "2"}, "every is '2'"),
        ({"every": True}, "every is True"),
        ({"store_every": 2}, "store_every must list different whole numbers of at least 1, not 2"),
        ({"store_every": []}, "store_every must list"),
        ({"store_every": [2, 2]}, "store_every must list"),
        ({"store_every": [0, 2]}, "store_every must list"),
        ({"store_every": [2.5]}, "store_every must list"),
        ({"store_every": [True]}, "store_every must list"),
        ({"store_every": [2, 9]}, "has 5 x 5 x 5 lattice places, too few to keep every 9"),
    ],
)
def test_wrong_input_is_one_sentence_and_leaves_nothing(
    faked: None, tmp_path: Path, changes: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence) as refused:
        generate(tmp_path / "set", **changes)
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "set").exists()


def test_two_workers_and_the_real_solver_give_what_one_worker_gives(tmp_path: Path) -> None:
    spec = make_thinned_spec(families={"cube_drop": {**DROPS, "count": 3, "duration": 0.03}})
    for name, workers in (("one", 1), ("two", 2)):
        generate_dataset(spec, root=tmp_path / name, num_workers=workers, progress=False)
    assert all_sums(tmp_path / "one") == all_sums(tmp_path / "two")
    assert read_trajectory(tmp_path / "one" / "every_3" / "trajectory_0000.h5").provenance["solver"] == "gns_pl.mpm"
