"""Pictures and films in three dimensions: their pixels are where the grains are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.scene import Plane, Wall
from gns_pl.trajectory import Trajectory
from gns_pl.viz import render_film, render_still, scene3d, vtk_renderer
from gns_pl.viz.camera import KINEMATIC_GREY
from tests.evaluation.made_up import column, moved, spreading, standing
from tests.viz.test_figures import hopper

pytest.importorskip("pyvista")
ffmpeg = pytest.importorskip("imageio_ffmpeg")

WIDTH = 400


@pytest.fixture(autouse=True)
def screenless() -> None:
    if not vtk_renderer.draws_without_screen():
        pytest.skip("VTK finds no OpenGL to draw without a screen")


def coloured(image: np.ndarray) -> np.ndarray:
    """Where grains are; the colour bar in the lowest of the page's half inches is left out."""
    grains = np.ptp(image.astype(int), axis=2) > 30
    grains[-round(0.5 * image.shape[1] / 7) :] = False
    return grains


def picture(path: Path, *arguments: object, **options: object) -> np.ndarray:
    render_still(path, *arguments, **{"width": WIDTH, **options})
    with Image.open(path) as image:
        return np.asarray(image)


def middle(image: np.ndarray) -> float:
    """The mean column of the grains, from 0 to 1."""
    return float(np.nonzero(coloured(image))[1].mean()) / image.shape[1]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene3d, "FINE", 1)


def test_a_still_shows_the_grains_where_they_are(tmp_path: Path) -> None:
    image = picture(tmp_path / "a.png", standing(), title="MPM")
    assert image.shape[1:] == (WIDTH, 3) and 150 < image.shape[0] < WIDTH
    left = middle(image)
    assert 0.1 < left < 0.4 and coloured(image).mean() > 0.02
    shifted = picture(tmp_path / "b.png", moved(standing(), np.full((5, 3), [1.1, 0, 0])))
    assert 0.6 < middle(shifted) < 0.9
    # nothing coloured beyond the middle, where the column is not
    assert not coloured(image)[:, WIDTH // 2 + 20 :].any()


def test_materials_have_their_colours(tmp_path: Path) -> None:
    image = picture(tmp_path / "a.png", standing(hopper(3)), colour="material").astype(int)
    red, _, blue = np.moveaxis(image[: int(0.85 * len(image))], 2, 0)
    orange, sea = (np.nonzero(mask)[0] for mask in (red > blue + 60, blue > red + 60))
    assert min(len(orange), len(sea)) > 50 and sea.mean() < orange.mean()  # the gravel lies on the sand
    with pytest.raises(InputError, match="no materials to tell apart"):
        render_still(tmp_path / "b.png", standing(), colour="material")


def test_a_still_is_of_its_moment(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    flow = spreading(frames=11)
    last = picture(tmp_path / "a.png", flow)
    assert np.array_equal(last, picture(tmp_path / "b.png", flow, frame=10))
    assert np.array_equal(last, picture(tmp_path / "c.png", flow, time=10.3 * flow.dt))
    assert middle(picture(tmp_path / "d.png", flow, frame=3)) < middle(last)
    assert capfd.readouterr().err == ""  # VTK says nothing of a missing screen


def test_flows_side_by_side_share_camera_and_colours(tmp_path: Path) -> None:
    flow = spreading(frames=5)
    still = standing(frames=5)
    image = picture(tmp_path / "a.png", flow, title="one", side_by_side={"two": flow, "three": still, "four": flow})
    width = image.shape[1] / 4
    grains = coloured(image)
    panels = [grains[:, round(k * width) : round((k + 1) * width)] for k in range(4)]
    assert abs(int(panels[0].sum()) - int(panels[3].sum())) < 0.1 * panels[0].sum()
    assert panels[2].any(axis=0).sum() < 0.8 * panels[0].any(axis=0).sum()  # it has not spread
    short = replace(flow, position=flow.position[:2])
    gone = picture(tmp_path / "b.png", flow, title="one", side_by_side={"two": short})
    assert coloured(gone)[:, : WIDTH // 2].any() and not coloured(gone)[:, WIDTH // 2 :].any()


def test_scripted_particles_are_grey_and_lost_ones_left_out(tmp_path: Path) -> None:
    flow = standing()
    scripted = replace(flow, particle_type=np.full(flow.num_particles, ParticleType.KINEMATIC))
    image = picture(tmp_path / "a.png", scripted).astype(int)
    assert not coloured(image).any()
    dark = (image.max(axis=2) < KINEMATIC_GREY[0] + 20) & (np.ptp(image, axis=2) < 6)
    assert dark[60:-70, : WIDTH // 2].mean() > 0.1
    lost = picture(tmp_path / "b.png", moved(flow, np.full((5, 3), np.nan)))
    assert not coloured(lost).any() and lost.std() > 1


@pytest.mark.parametrize("obstacles", [(), (Plane((0.0, 0.3), (0.5, 1.0), Wall("slip")),)])
def test_two_dimensions_are_a_slice(tmp_path: Path, obstacles: tuple[Plane, ...]) -> None:
    scene = column(2).replace(obstacles=obstacles) if obstacles else column(2)
    flow: Trajectory = moved(standing(scene), np.full((5, 2), [0.9, 0.0]))
    image = picture(tmp_path / "a.png", flow)
    rows, columns = np.nonzero(coloured(image))
    assert columns.min() > WIDTH / 2
    if not obstacles:
        assert np.ptp(columns) / np.ptp(rows) == pytest.approx(0.4 / 0.2, rel=0.1)  # seen straight on
    tan = (image.astype(int)[..., 0] - image[..., 2] > 8) & ~coloured(image)
    assert tan[40:-70, : WIDTH // 3].any() == bool(obstacles)


def frames_of(path: Path) -> np.ndarray:
    """Return the pictures of a film [T, rows, columns, 3]."""
    if path.suffix == ".gif":
        with Image.open(path) as film:
            return np.stack([np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(film)])
    described, *pictures = ffmpeg.read_frames(str(path))
    columns, rows = described["size"]
    return np.stack([np.frombuffer(picture, np.uint8).reshape(rows, columns, 3) for picture in pictures])


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_film_moves_and_has_its_frames(tmp_path: Path, suffix: str) -> None:
    flow = spreading(frames=20)
    path = render_film(
        tmp_path / f"a{suffix}",
        {"learned": standing(frames=20), "MPM": flow},
        num_frames=6,
        colour="speed",
        width=WIDTH,
    )
    frames = frames_of(path)
    assert len(frames) == 6 and frames.shape[2] == WIDTH
    half = WIDTH // 2
    fronts = [
        np.flatnonzero((np.ptp(frame.astype(int), axis=2) > 60)[:-60, half:].any(axis=0)).max() for frame in frames
    ]
    assert fronts == sorted(fronts) and fronts[-1] > fronts[0] + 20
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_a_film_has_no_more_frames_than_the_flow(tmp_path: Path) -> None:
    render_film(tmp_path / "a.gif", {"": standing(frames=3)}, num_frames=60, width=200)
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames <= 3  # equal frames may be joined


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time": 0.1, "frame": 1}, "either a time or a frame"),
        ({"frame": 5}, "frame must lie in 0 … 4, not 5"),
        ({"time": 9.0}, "time must lie in 0 … 0.08 s, not 9"),
        ({"colour": "hue"}, "colour must be one of displacement, speed"),
        ({"side_by_side": {"flat": standing(column(2))}}, "different boxes"),
    ],
)
def test_what_cannot_be_shown_is_said(tmp_path: Path, options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        render_still(tmp_path / "a.png", standing(), **options)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_filmed_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"must end in .mp4 or .gif, not 'a.avi'"):
        render_film(tmp_path / "a.avi", {"": standing()}, num_frames=3)
    with pytest.raises(InputError, match="num_frames must be at least 1"):
        render_film(tmp_path / "a.gif", {"": standing()}, num_frames=0)


def test_missing_packages_and_a_missing_opengl_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vtk_renderer.draws_without_screen.cache_clear()
    with monkeypatch.context() as patched:
        patched.setattr(vtk_renderer, "PROBE", "import os; os.abort()")  # as VTK does
        with pytest.raises(InputError, match="no OpenGL to draw without a screen"):
            render_still(tmp_path / "a.png", standing())
    vtk_renderer.draws_without_screen.cache_clear()
    monkeypatch.setitem(__import__("sys").modules, "pyvista", None)
    with pytest.raises(InputError, match=r"pip install 'gns_pl\[viz3d\]'"):
        render_still(tmp_path / "a.png", standing())
    assert not list(tmp_path.iterdir())
