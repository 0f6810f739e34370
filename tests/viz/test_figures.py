"""Figures and animations: they exist, show something, and survive what goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gns_pl.evaluation.curves import compute_curves, cut
from gns_pl.evaluation.laws import LAWS
from gns_pl.viz import plot_curves, plot_evolution, plot_familiarity, plot_laws, write_animation
from gns_pl.viz.animation import COLOURS, GREYS, TONES, _palette
from gns_pl.viz.plots import PANELS, failure_surface
from tests.evaluation.made_up import SPACING, column, spreading, standing

SCALE = 0.14


def pixels(path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def test_curves_are_drawn_for_every_scene_and_format(tmp_path) -> None:
    one = {"MPM": compute_curves(spreading()), "learned": compute_curves(cut(spreading(share=0.8), 9))}
    paths = [tmp_path / "a.png", tmp_path / "a.pdf"]
    plot_curves({"short": one, "tall": one}, ("runout", "height"), paths)
    assert paths[1].read_bytes().startswith(b"%PDF")
    image = pixels(paths[0])
    assert image.shape[0] > 800 and (image < 128).any(axis=2).mean() > 0.002
    orange = (image == (0xD5, 0x5E, 0x00)).all(axis=2)
    assert orange.any()


def test_every_panel_can_be_drawn(tmp_path) -> None:
    still = {"MPM": compute_curves(standing())}
    plot_curves({"still": still}, tuple(PANELS), [tmp_path / "all.png"])
    assert (tmp_path / "all.png").stat().st_size > 5000


@pytest.mark.parametrize("dim", [2, 3])
def test_evolution_shows_grains_in_every_panel(tmp_path, dim) -> None:
    flows = {"learned": spreading(column(dim), share=0.7), "MPM": spreading(column(dim))}
    plot_evolution(flows, [tmp_path / "e.png"], time_scale=SCALE, times=[0, 1, 99], diameter=SPACING)
    image = pixels(tmp_path / "e.png").astype(int)
    coloured = np.ptp(image, axis=2) > 40
    half = image.shape[1] // 2
    assert coloured[:, : half - 50].mean() > 0.02 and coloured[:, half - 50 :].mean() > 0.02


def test_a_rollout_that_ended_early_is_said_to(tmp_path) -> None:
    flows = {"learned": cut(spreading(), 3), "MPM": spreading()}
    plot_evolution(flows, [tmp_path / "e.png"], time_scale=SCALE, times=[0], diameter=SPACING)
    write_animation(flows, tmp_path / "e.gif", time_scale=SCALE, diameter=SPACING, num_frames=5, width=500)
    with Image.open(tmp_path / "e.gif") as gif:
        assert gif.n_frames == 5


def test_animation_moves_at_the_stated_size_and_pace(tmp_path) -> None:
    flows = {"learned": spreading(share=0.5), "MPM": spreading()}
    write_animation(flows, tmp_path / "a.gif", time_scale=SCALE, diameter=SPACING, num_frames=10, width=600)
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == 10 and gif.size[0] == 600 and gif.info["loop"] == 0
        frames, durations = [], []
        for index in range(gif.n_frames):
            gif.seek(index)
            frames.append(np.asarray(gif.convert("RGB")).astype(int))
            durations.append(gif.info["duration"])
    assert sum(durations[:-1]) == pytest.approx(5000, rel=0.15) and durations[-1] == 1500
    coloured = [np.ptp(frame, axis=2)[:-60] > 30 for frame in frames]  # without the colour bar
    columns = [np.flatnonzero(image.any(axis=0)) for image in coloured]
    assert columns[0].max() < columns[-1].max()
    assert not np.array_equal(frames[0], frames[1])
    # the panels: the column's shape in pixels has the real aspect
    left = coloured[0][:, :300]
    extent = [np.ptp(np.flatnonzero(left.any(axis=axis))) + 1 for axis in (0, 1)]
    assert extent[0] / extent[1] == pytest.approx(0.4 / 0.2, rel=0.1)


def test_an_animation_has_no_more_frames_than_the_flow(tmp_path) -> None:
    write_animation(
        {"MPM": standing()}, tmp_path / "s.gif", time_scale=SCALE, diameter=SPACING, num_frames=80, width=300
    )
    with Image.open(tmp_path / "s.gif") as gif:
        assert gif.n_frames <= 5


def test_palette_is_full() -> None:
    assert GREYS + COLOURS * TONES == 256 and len(_palette()) == 768


def test_the_failure_surface_is_where_motion_begins() -> None:
    """Everything above the line z = 0.3 − x/2 has slid away along the slope."""
    still = standing(column(2, length=0.5, height=0.4), spacing=0.01)
    position = still.position.astype(np.float64)
    moving = position[0, :, 1] > 0.3 - position[0, :, 0] / 2
    position[1:, moving] += [0.02, 0.0]
    x, z = failure_surface(replace(still, position=position.astype(np.float32)), 1, 0.01)
    inside = (x > 0.03) & (x < 0.47)
    np.testing.assert_allclose(z[inside], 0.3 - x[inside] / 2, atol=0.016)
    assert np.isnan(z[x > 0.53]).all()


def test_nothing_moves_and_all_is_static() -> None:
    x, z = failure_surface(standing(column(2, length=0.5, height=0.4), spacing=0.01), 1, 0.01)
    np.testing.assert_allclose(z[x < 0.49], 0.4, atol=0.02)


def test_runouts_beside_laws_and_distances_over_time(tmp_path) -> None:
    runouts = {"MPM": [(0.8, 1.0, 0.1), (2.0, 3.0, 0.2)], "learned": [(0.8, 1.1, 0.0), (2.0, float("nan"), 0.0)]}
    plot_laws(runouts, {law.source: law for law in LAWS}, [tmp_path / "laws.png", tmp_path / "laws.pdf"])
    assert (tmp_path / "laws.pdf").read_bytes().startswith(b"%PDF")
    orange = (pixels(tmp_path / "laws.png") == (0xD5, 0x5E, 0x00)).all(axis=2)
    assert orange.any()
    time = np.linspace(0, 6, 10)
    plot_familiarity({"a": (time, 0.1 * time, 0.01 * time)}, 0.1, tmp_path / "far.png")
    assert (pixels(tmp_path / "far.png") < 128).any()
