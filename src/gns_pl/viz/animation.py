"""Animated GIFs of flows side by side, drawn in palette indices: quick to make and small.

The scenery (axes, titles, colour bar) is drawn once by matplotlib; every frame adds grains and the time.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.trajectory import Trajectory
from gns_pl.viz.colouring import Colouring
from gns_pl.viz.raster import AMBIENT, View, draw_grains, obstacle_outlines, side_window

Pixels = NDArray[np.uint8]

GREYS = 16
"""Palette entries 0 to GREYS − 1 run from black to white and hold the scenery."""

COLOURS, SHADES = 30, 5
"""Steps of the colour map and of the brightness of pixels that grains cover."""

COVERAGE = (0.75, 0.5, 0.25)
"""Steps of the part of a pixel at a grain's edge that is covered, the rest being white."""

TONES = SHADES + len(COVERAGE)
"""Palette entries per colour; GREYS + COLOURS · TONES = 256."""

FIXED = 9
"""Grey of what is on no scale: kinematic particles."""

TALLEST = 0.7
"""Largest height of a panel over the width of the image."""

DOTS_PER_INCH = 100
PLAY_SECONDS, HOLD_SECONDS = 5.0, 1.5
"""Playing time of the motion, and how long the last frame stays."""


def write_animation(
    trajectories: Mapping[str, Trajectory],
    path: Path,
    *,
    time_scale: float,
    diameter: float,
    num_frames: int,
    width: int,
) -> None:
    """Write a GIF with one panel per simulator, seen from the side, coloured as `plot_evolution` does.

    Args:
        trajectories: title → trajectory of one scene; the last one is the reference, which sets the frames and the
            colour scale. One that ends earlier leaves its panel empty from there on.
        path: file to write.
        time_scale: τc [s].
        diameter: of a grain [m].
        num_frames: at most this many frames, evenly spaced in time.
        width: of the image [pixels].
    """
    from PIL import Image

    reference = list(trajectories.values())[-1]
    window = side_window(list(trajectories.values()), diameter)
    colouring = Colouring.of(reference)
    palette = _palette(colouring)
    canvas, corners, view = _scenery(trajectories, window, colouring, width)
    chosen = np.unique(np.linspace(0, reference.num_frames - 1, min(num_frames, reference.num_frames)).round())
    images = []
    for frame in chosen.astype(int):
        pixels = canvas.copy()
        for (top, left), trajectory in zip(corners, trajectories.values(), strict=True):
            if frame < trajectory.num_frames:
                _stamp_grains(pixels[top:, left:], trajectory, frame, view, diameter, colouring)
        time = frame * reference.dt
        _stamp_text(pixels, f"t = {time:.2f} s = {time / time_scale:.1f} τc")
        image = Image.fromarray(pixels)
        image.putpalette(palette)
        images.append(image)
    beat = max(20, round(1000 * PLAY_SECONDS / len(images) / 10) * 10)
    durations = [beat] * (len(images) - 1) + [round(1000 * HOLD_SECONDS)]
    # `optimize` lets Pillow store the pixels that stay as transparent ones: half of the size, and no colour changes.
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations, loop=0, optimize=True)


def _palette(colouring: Colouring) -> list[int]:
    """Return the 256 colours of all frames: greys, then every colour in every tone."""
    greys = np.repeat(np.linspace(0, 1, GREYS)[:, None], 3, axis=1)
    colours = np.asarray(colouring.colour_map()(np.linspace(0, 1, COLOURS)))[:, None, :3]
    lit = colours * np.linspace(AMBIENT, 1, SHADES)[:, None]
    edge = np.array(COVERAGE)[:, None]
    faint = colours * 0.5 * (1 + AMBIENT) * edge + 1 - edge
    tones = np.concatenate([lit, faint], axis=1).reshape(-1, 3)
    return [int(level) for level in (255 * np.concatenate([greys, tones])).round().ravel()]


def _colour_index(share: NDArray[np.floating], tone: NDArray[np.integer]) -> Pixels:
    """Return palette indices of colours at `share` (0 to 1) of the scale in a tone from 0 to TONES − 1."""
    colour = np.clip(share * COLOURS, 0, COLOURS - 1).astype(np.int64)
    return np.asarray(GREYS + colour * TONES + tone, dtype=np.uint8)


def _stamp_grains(
    pixels: Pixels, trajectory: Trajectory, frame: int, view: View, diameter: float, colouring: Colouring
) -> None:
    """Draw the grains of one frame from the upper left corner of `pixels` on, two by two samples a pixel."""
    rows, columns = view.shape
    fine = View(view.lower, view.upper, 2 * view.resolution)
    drawn = draw_grains(trajectory.position[frame], colouring.shares(trajectory, frame), fine, diameter)
    values, shades = (_by_fours(image, rows, columns) for image in drawn)
    covered = np.isfinite(values).sum(axis=-1)
    grain = covered > 0
    count = covered[grain]
    share, light = (np.nansum(image[grain], axis=-1) / count for image in (values, shades))
    if colouring.names:  # between two materials there is no third
        share = np.nanmax(values[grain], axis=-1)
    shade = np.clip((light - AMBIENT) / (1 - AMBIENT) * SHADES, 0, SHADES - 1).astype(np.int64)
    index = _colour_index(share, np.where(count == 4, shade, TONES - count))
    pixels[:rows, :columns][grain] = np.where(share < 0, FIXED, index)


def _by_fours(image: NDArray[np.float32], rows: int, columns: int) -> NDArray[np.float32]:
    """Return the four samples of every pixel [rows, columns, 4] of an image of twice the resolution."""
    padded = np.full((2 * rows, 2 * columns), np.nan, dtype=np.float32)
    height, width = min(image.shape[0], 2 * rows), min(image.shape[1], 2 * columns)
    padded[:height, :width] = image[:height, :width]
    return padded.reshape(rows, 2, columns, 2).swapaxes(1, 2).reshape(rows, columns, 4)


def _stamp_text(pixels: Pixels, text: str) -> None:
    """Write `text` in black on white, in the middle of the upper edge."""
    import matplotlib as mpl
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), 15)
    left, top, right, bottom = font.getbbox(text)
    mask = Image.new("L", (int(right - left) + 4, int(bottom - top) + 4), 255)
    ImageDraw.Draw(mask).text((2 - left, 2 - top), text, fill=0, font=font)
    stamp = np.asarray(mask, dtype=np.float64) / 255 * (GREYS - 1)
    start = (pixels.shape[1] - stamp.shape[1]) // 2
    pixels[6 : 6 + stamp.shape[0], start : start + stamp.shape[1]] = stamp.round()


def _scenery(
    trajectories: Mapping[str, Trajectory],
    window: tuple[tuple[float, float], tuple[float, float]],
    colouring: Colouring,
    width: int,
) -> tuple[Pixels, list[tuple[int, int]], View]:
    """Draw what stays: returns the canvas, the upper left pixel of every panel, and the panels' view."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    lower, upper = window
    left, gap, right, top, bottom = 52, 40, 18, 54, 96
    panel = (width - left - right - gap * (len(trajectories) - 1)) // len(trajectories)
    view = View(lower, upper, min(panel / (upper[0] - lower[0]), TALLEST * width / (upper[1] - lower[1])))
    rows, columns = view.shape
    height = top + rows + bottom
    figure = Figure(figsize=(width / DOTS_PER_INCH, height / DOTS_PER_INCH), dpi=DOTS_PER_INCH)
    corners = []
    for index, (title, trajectory) in enumerate(trajectories.items()):
        start = left + index * (panel + gap) + (panel - columns) // 2
        corners.append((top, start))
        axes = figure.add_axes((start / width, bottom / height, columns / width, rows / height))
        _dress(axes, trajectory, lower, upper, title)
        if index:
            axes.set_yticklabels([])
        else:
            axes.set_ylabel("z [m]", fontsize=9)
    reference = list(trajectories.values())[-1]
    bar = figure.add_axes((0.3, 40 / height, 0.4, 10 / height))
    if colouring.names:
        number = len(colouring.names)
        bar.set(xlim=(0, number), yticks=[])
        bar.set_xticks(np.arange(number) + 0.5, colouring.names, fontsize=9)
        bar.tick_params(length=0)
    else:
        bar.set(xlim=(0, colouring.limit), yticks=[])
        bar.tick_params(labelsize=8, length=3)
        bar.set_xlabel("displacement [m]", fontsize=9, labelpad=1)
    short = [title for title, trajectory in trajectories.items() if trajectory.num_frames < reference.num_frames]
    if short:
        figure.text(0.01, 0.02, f"not finite to the end: {', '.join(short)}", fontsize=8)
    agg: Any = FigureCanvasAgg(figure)  # untyped in matplotlib
    agg.draw()
    grey = np.asarray(agg.buffer_rgba())[..., :3].mean(axis=2)
    canvas = np.asarray((grey / 255 * (GREYS - 1)).round(), dtype=np.uint8)
    box = bar.get_window_extent()
    columns_of_bar = np.arange(int(box.x0) + 1, int(box.x1))
    share = (columns_of_bar - box.x0) / box.width
    canvas[height - int(box.y1) + 1 : height - int(box.y0), columns_of_bar] = _colour_index(
        share, np.full(share.shape, SHADES - 1)
    )
    return canvas, corners, view


def _dress(
    axes: Any, trajectory: Trajectory, lower: tuple[float, float], upper: tuple[float, float], title: str
) -> None:
    axes.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]))
    axes.set_title(title, fontsize=10, loc="left", pad=4)
    axes.set_xlabel("x [m]", fontsize=9, labelpad=1)
    axes.tick_params(labelsize=8, length=3)
    axes.spines[["top", "right"]].set_visible(False)
    for outline in obstacle_outlines(trajectory.scene, lower, upper):
        axes.fill(*outline.T, facecolor="0.8", edgecolor="0.4", linewidth=0.6)
    for body in trajectory.scene.bodies:
        (x0, z0), (x1, z1) = ((corner[0], corner[-1]) for corner in (body.position, body.upper))
        axes.plot([x0, x0, x1, x1], [z0, z1, z1, z0], color="0.6", linewidth=0.8, linestyle=(0, (4, 3)))
