"""Pictures and films of scenes in three dimensions, drawn by VTK without a screen and set in a figure by matplotlib.

PyVista, Pillow, imageio-ffmpeg and matplotlib (extra `viz3d`) are imported inside the functions that draw.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from gns_pl.errors import InputError
from gns_pl.io.atomic import atomic_path
from gns_pl.trajectory import Trajectory
from gns_pl.viz.camera import evenly
from gns_pl.viz.figure3d import INCHES, Figure3D
from gns_pl.viz.notebook import interactive
from gns_pl.viz.vtk_renderer import Pixels, require

__all__ = ["interactive", "render_film", "render_still"]

PLAY_SECONDS = 4.0
"""Playing time of a film."""

FINE, QUICK = 2, 1
"""Pixels drawn along a side of a pixel kept, in a still and in a film."""


def render_still(
    path: str | Path,
    trajectory: Trajectory,
    *,
    time: float | None = None,
    frame: int | None = None,
    colour: str = "displacement",
    title: str = "",
    side_by_side: Mapping[str, Trajectory] | None = None,
    limit: float | None = None,
    width: int = 1680,
) -> Path:
    """Write a picture of one moment as a PNG.

    Args:
        path: file to write.
        trajectory: what to show.
        time: of the moment [s]; the nearest frame is shown.
        frame: number of the frame instead; without either it is the last.
        colour: "displacement", "speed" or "material".
        title: over the picture of `trajectory`.
        side_by_side: title → more trajectories of the same box, to the right of it. The last one sets the colour scale.
        limit: upper end of the colour scale [m or m/s]; what 99 % of the grains never exceed if None.
        width: of the picture [pixels].

    Returns:
        `path`.

    Raises:
        InputError: packages or OpenGL missing, an unknown colouring, both a time and a frame or one that there is not.
        StorageError: the disk refused.
    """
    if time is not None and frame is not None:
        raise InputError("picture: give either a time or a frame, not both.")
    last = trajectory.num_frames - 1
    if time is not None and not -0.5 <= time / trajectory.dt <= last + 0.5:
        raise InputError(f"picture: time must lie in 0 … {last * trajectory.dt:g} s, not {time:g}.")
    if frame is not None and not 0 <= frame <= last:
        raise InputError(f"picture: frame must lie in 0 … {last}, not {frame}.")
    number = round(time / trajectory.dt) if time is not None else last if frame is None else frame
    number = min(max(number, 0), last)
    with Figure3D({title: trajectory, **(side_by_side or {})}, colour, width, limit, FINE) as figure:
        from PIL import Image

        with atomic_path(path) as temporary:
            Image.fromarray(figure.draw(number * trajectory.dt)).save(
                temporary, format="PNG", dpi=(width / INCHES,) * 2
            )
    return Path(path)


def render_film(
    path: str | Path,
    trajectories: Mapping[str, Trajectory],
    *,
    num_frames: int,
    colour: str = "displacement",
    limit: float | None = None,
    width: int = 1280,
) -> Path:
    """Write a film, trajectories side by side, as .mp4 (H.264) or .gif.

    Args:
        path: file to write; its ending says the format.
        trajectories: title → trajectory of one box; the last one is the reference, which sets the moments and the
            colour scale. One that ends earlier leaves its place empty from there on.
        num_frames: at most this many, evenly spaced in time from the first to the last.
        colour: "displacement", "speed" or "material".
        limit: upper end of the colour scale [m or m/s]; what 99 % of the grains never exceed if None.
        width: of the film [pixels]; even.

    Returns:
        `path`.

    Raises:
        InputError: packages or OpenGL missing, an unknown format or colouring, no frames.
        StorageError: the disk refused.
    """
    path = Path(path)
    if path.suffix not in (".mp4", ".gif"):
        raise InputError(f"film: its name must end in .mp4 or .gif, not {path.name!r}.")
    if num_frames < 1:
        raise InputError(f"film: num_frames must be at least 1, not {num_frames}.")
    require("PIL" if path.suffix == ".gif" else "imageio_ffmpeg")
    with Figure3D(trajectories, colour, width, limit, QUICK) as figure, atomic_path(path) as temporary:
        reference = list(trajectories.values())[-1]
        moments = [frame * reference.dt for frame in evenly(reference.num_frames, num_frames)]
        pictures = (figure.draw(moment) for moment in moments)
        beat = PLAY_SECONDS / len(moments)
        if path.suffix == ".gif":
            _write_gif(temporary, pictures, beat)
        else:
            _write_mp4(temporary, pictures, beat, figure.shape)
    return path


def _write_gif(path: Path, pictures: Iterator[Pixels], beat: float) -> None:
    """Write pictures that stay for `beat` [s] each, over and over again."""
    from PIL import Image

    first, *others = map(Image.fromarray, pictures)
    first.save(path, format="GIF", save_all=True, append_images=others, duration=1000 * beat, loop=0)


def _write_mp4(path: Path, pictures: Iterator[Pixels], beat: float, shape: tuple[int, int]) -> None:
    """Write pictures of a shape that stay for `beat` [s] each, as H.264."""
    from imageio_ffmpeg import write_frames

    film = write_frames(
        str(path),
        shape[::-1],
        fps=1 / beat,
        codec="libx264",
        quality=None,
        macro_block_size=2,
        ffmpeg_log_level="error",
        output_params=["-crf", "18", "-f", "mp4", "-movflags", "+faststart"],
    )
    film.send(None)
    try:
        for picture in pictures:
            film.send(np.ascontiguousarray(picture))
    finally:
        film.close()
