"""Figures and animations: they exist, show something, and survive what goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from gns_pl.fields import ParticleType
from gns_pl.metrics.curves import compute_curves, cut
from gns_pl.metrics.laws import LAWS
from gns_pl.scene import Body, Box, Plane, Scene, Wall
from gns_pl.scene.definition import FACES
from gns_pl.viz import plot_curves, plot_evolution, plot_laws, plot_ood, write_animation
from gns_pl.viz.animation import COLOURS, GREYS, TONES, _palette
from gns_pl.viz.colouring import Colouring, material_names, material_numbers
from gns_pl.viz.evolution import failure_surface, snapshot_times, stands_on_floor
from gns_pl.viz.plots import PANELS
from gns_pl.viz.raster import obstacle_outlines
from tests.evaluation.made_up import SAND, SPACING, column, spreading, standing

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
    assert GREYS + COLOURS * TONES == 256 and len(_palette(Colouring((), 1.0))) == 768


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
    plot_ood({"a": (time, 0.1 * time, 0.01 * time)}, 0.1, tmp_path / "far.png")
    assert (pixels(tmp_path / "far.png") < 128).any()


def hopper(dim: int = 2) -> Scene:
    """A tall box with a body of two sands over an opening between two blocks."""
    flat = dim == 2
    place = (lambda x, z: (x, z)) if flat else (lambda x, z: (x, 0.0, z))
    size = (lambda x, z: (x, z)) if flat else (lambda x, z: (x, 0.2, z))
    steep = replace(SAND, friction_angle_deg=40)
    return Scene(
        name="hopper",
        lower=place(0.0, 0.0),
        upper=(0.6, 3.0) if flat else (0.6, 0.2, 3.0),
        gravity=place(0.0, -9.81),
        duration=1.0,
        materials={"sand": SAND, "gravel": steep},
        bodies=(
            Body(place(0.1, 1.2), size(0.4, 0.4), place(0.0, 0.0), "sand"),
            Body(place(0.1, 1.6), size(0.4, 0.4), place(0.0, 0.0), "gravel"),
        ),
        walls={face: Wall("slip") for face in FACES[dim]},
        obstacles=(
            Box(place(0.0, 1.0), size(0.2, 0.2), Wall("slip")),
            Box(place(0.4, 1.0), size(0.2, 0.2), Wall("slip")),
        ),
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_obstacles_are_drawn_and_materials_have_their_colours(tmp_path, dim) -> None:
    """Each material in its colour beside a legend, blocks grey where they stand, and no failure surface in mid-air."""
    flow = standing(hopper(dim), frames=3)
    assert material_names(flow) == ("sand", "gravel")
    number = material_numbers(flow, ("sand", "gravel"))
    np.testing.assert_array_equal(number, (flow.position[0, :, -1] > 1.6).astype(int))
    plot_evolution({"MPM": flow}, [tmp_path / "h.png"], time_scale=SCALE, times=[], diameter=SPACING)
    write_animation({"MPM": flow}, tmp_path / "h.gif", time_scale=SCALE, diameter=SPACING, num_frames=2, width=400)
    for path, grey in ((tmp_path / "h.png", (204, 204, 204)), (tmp_path / "h.gif", (204, 204, 204))):
        image = pixels(path).astype(int)
        red, green, blue = np.moveaxis(image, 2, 0)
        orange, sea = (red > blue + 60) & (red > green + 20), blue > red + 60  # E69F00 and 0072B2, lit and in shade
        block = np.abs(image - grey).max(axis=2) <= 4
        counts = [mask[: int(0.85 * len(image))].sum(axis=1) for mask in (sea, orange, block)]  # without the legend
        panel = [np.flatnonzero(count > 0.3 * count.max()) for count in counts]
        assert panel[0].max() < panel[1].max() and panel[1].max() <= panel[2].min() + 3
        # Blocks are 0.2 m high, bodies 0.4 m.
        assert np.ptp(panel[2]) / np.ptp(panel[1]) == pytest.approx(0.5, abs=0.08)
    assert not stands_on_floor(flow.scene, SPACING) and stands_on_floor(column(dim), SPACING)
    assert not stands_on_floor(replace(column(dim), gravity=(0.0,) * dim), SPACING)


def test_figures_have_a_bounded_size_and_no_time_twice(tmp_path) -> None:
    flow = standing(hopper(), frames=40)
    times = [0, 1, 2.5, 39 * flow.dt / SCALE - 0.01, 1.01]
    plot_evolution({"MPM": flow}, [tmp_path / "h.png"], time_scale=SCALE, times=times, diameter=SPACING)
    write_animation({"MPM": flow}, tmp_path / "h.gif", time_scale=SCALE, diameter=SPACING, num_frames=2, width=400)
    assert max(pixels(tmp_path / "h.png").shape) < 2400 and pixels(tmp_path / "h.gif").shape[0] < 450
    assert snapshot_times([0, 1, 2.5, 2.55, 5.9, 6.0, 7.0, 1.01], 6.0) == [0, 1, 2.5, 6.0]
    assert snapshot_times([0, 1], 0.0) == [0.0]
    one = {"MPM": compute_curves(cut(flow, 5))}
    plot_curves({str(number): one for number in range(30)}, ("runout",), [tmp_path / "many.png"])
    assert pixels(tmp_path / "many.png").shape[0] < 4000


def test_a_slope_is_grey_below_its_surface() -> None:
    flat = column(2)
    slope = flat.replace(obstacles=(Plane((0.0, 0.1), (0.6, 0.8), Wall("slip")),), bodies=flat.bodies)
    [outline] = obstacle_outlines(slope, slope.lower, slope.upper)
    # 0.6 x + 0.8 (z - 0.1) = 0 meets the wall at z = 0.1 and the floor at x = 4/30.
    expected = {(0.0, 0.0), (0.0, 0.1), (0.1333, 0.0)}
    assert {tuple(corner) for corner in outline.round(4).tolist()} == expected
    space = column(3).replace(obstacles=(Plane((0.0, 0.0, 0.1), (0.6, 0.0, 0.8), Wall("slip")),))
    [outline] = obstacle_outlines(space, (0.0, 0.0), (1.5, 0.7))
    assert {tuple(corner) for corner in outline.round(4).tolist()} == expected
    outside = flat.replace(obstacles=(Plane((0.0, -0.1), (0.0, 1.0), Wall("slip")),))
    assert obstacle_outlines(outside, outside.lower, outside.upper) == []


def test_kinematic_particles_are_grey_and_imported_sands_differ() -> None:
    flow = standing(column(2))
    kinds = np.where(flow.position[0, :, 0] > 0.3, ParticleType.KINEMATIC, ParticleType.SAND)
    scripted = replace(flow, particle_type=kinds.astype(np.int64))
    shares = Colouring.of(scripted).shares(scripted, 2)
    np.testing.assert_array_equal(shares < 0, kinds == ParticleType.KINEMATIC)
    tangent = np.where(flow.position[0, :, 0] > 0.2, np.tan(np.radians(40)), np.tan(np.radians(25)))
    two = replace(flow, material=tangent[:, None].astype(np.float32))
    assert material_names(two) == ("φ = 25°", "φ = 40°")
    np.testing.assert_array_equal(material_numbers(two, material_names(two)), (tangent > 0.7).astype(int))
    assert material_names(flow) == ()
