"""Pictures and films of scenes in three dimensions, drawn by VTK without a screen and set in a figure by matplotlib.

PyVista, imageio and matplotlib (extra `viz3d`) are imported inside the functions that draw.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.io.atomic import atomic_path
from gns_pl.trajectory import Trajectory
from gns_pl.viz.notebook import interactive
from gns_pl.viz.plots import STYLE
from gns_pl.viz.stage import (
    COLOURINGS,
    Camera,
    Window,
    camera_of,
    collapse_time,
    colours_of,
    evenly,
    grain_diameters,
    in_space,
    limit_of,
    obstacle_solids,
    window_of,
)

__all__ = ["interactive", "render_film", "render_still"]

Pixels = NDArray[np.uint8]

PROBE = (
    "import vtkmodules.vtkRenderingOpenGL2; from vtkmodules.vtkRenderingCore import vtkRenderWindow as Window; "
    "window = Window(); window.SetOffScreenRendering(1); window.Render()"
)
"""Tried in a process of its own, since VTK takes a process down where it finds no OpenGL."""

INCHES = 7.0
"""Width of a figure, that of a page: letters are as large as in the other figures."""

PLAY_SECONDS = 4.0
"""Playing time of a film."""

OVERSAMPLING = 2
"""Pixels drawn along a side of a pixel kept."""


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
    width: int = 2100,
) -> Path:
    """Write a picture of one moment as a PNG.

    Args:
        path: file to write.
        trajectory: what to show.
        time: of the moment [s]; the nearest frame is shown.
        frame: number of the frame instead; without either it is the last.
        colour: "displacement" or "speed".
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
    if time is None:
        number = trajectory.num_frames - 1 if frame is None else frame
        if not 0 <= number < trajectory.num_frames:
            raise InputError(f"picture: frame must lie in 0 … {trajectory.num_frames - 1}, not {number}.")
        time = number * trajectory.dt
    elif not -0.5 <= time / trajectory.dt <= trajectory.num_frames - 0.5:
        raise InputError(f"picture: time must lie in 0 … {trajectory.time[-1]:g} s, not {time:g}.")
    with _Sheet({title: trajectory, **(side_by_side or {})}, colour, width, limit) as sheet:
        from PIL import Image

        with atomic_path(path) as temporary:
            Image.fromarray(sheet.draw(time)).save(temporary, format="PNG", dpi=(width / INCHES,) * 2)
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
        trajectories: title → trajectory of one box; the last one is the reference, which sets the moments and the colour
            scale. One that ends earlier leaves its place empty from there on.
        num_frames: at most this many, evenly spaced in time from the first to the last.
        colour: "displacement" or "speed".
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
    _require("imageio", "imageio_ffmpeg")
    with _Sheet(trajectories, colour, width, limit) as sheet, atomic_path(path) as temporary:
        reference = list(trajectories.values())[-1]
        moments = [frame * reference.dt for frame in evenly(reference.num_frames, num_frames)]
        with _open_film(temporary, path.suffix, len(moments) / PLAY_SECONDS) as film:
            for moment in moments:
                film.append_data(sheet.draw(moment))
    return path


def _open_film(temporary: Path, suffix: str, frames_per_second: float) -> Any:
    """Return imageio's writer of a file whose name does not say its format."""
    import imageio.v2 as imageio

    if suffix == ".gif":
        return imageio.get_writer(temporary, format="GIF", duration=1000 / frames_per_second, loop=0)  # type: ignore[arg-type]
    return imageio.get_writer(
        temporary,
        format="FFMPEG",  # type: ignore[arg-type]
        fps=frames_per_second,
        codec="libx264",
        macro_block_size=2,
        ffmpeg_log_level="error",
        output_params=["-crf", "18", "-f", "mp4", "-movflags", "+faststart"],
    )


def _require(*modules: str) -> None:
    """Raise an `InputError` that says what to install if one of these cannot be imported."""
    for module in modules:
        try:
            __import__(module)
        except ImportError as error:
            raise InputError(
                f"picture: {module} cannot be imported ({error}); pip install 'gns_pl[viz3d]' brings it."
            ) from error


@cache
def _draws_without_screen() -> bool:
    return subprocess.run([sys.executable, "-c", PROBE], capture_output=True, check=False).returncode == 0


class _Sheet:
    """A figure with a picture per trajectory, whose scenery is drawn once and whose grains at every moment."""

    def __init__(self, trajectories: Mapping[str, Trajectory], colour: str, width: int, limit: float | None) -> None:
        self.trajectories = dict(trajectories)
        self.colour = colour
        window = window_of(list(self.trajectories.values()))
        reference = list(self.trajectories.values())[-1]
        self.limit = limit_of(reference, colour) if limit is None else limit
        _require("pyvista", "matplotlib", "PIL")
        self.camera = camera_of(window, reference.scene.dim)
        self.time_scale = collapse_time(reference.scene)
        self.diameters = [grain_diameters(trajectory) for trajectory in self.trajectories.values()]
        self.width, self.resolution = width + width % 2, width / INCHES
        gap, top, bottom = 0.15, 0.42, 0.5
        panel = (INCHES - 0.1 - gap * (len(self.trajectories) - 1)) / len(self.trajectories)
        self.columns = round(panel * self.resolution)
        self.rows = round(self.columns / self.camera.ratio)
        self.top = round(top * self.resolution)
        height = self.top + self.rows + round(bottom * self.resolution)
        self.height = height + height % 2
        self.lefts = [round((0.05 + index * (panel + gap)) * self.resolution) for index in range(len(self.diameters))]
        self.scenery = self._scenery(window)
        self.studio = _Studio(window, self.camera, reference, (self.columns, self.rows))

    def __enter__(self) -> _Sheet:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.studio.close()

    def draw(self, time: float) -> Pixels:
        """Return the figure at a time [s] as pixels [rows, columns, 3]."""
        page = np.full((self.height, self.width, 3), 255, dtype=np.uint8)
        for left, diameters, trajectory in zip(self.lefts, self.diameters, self.trajectories.values(), strict=True):
            frame = round(time / trajectory.dt)
            shown = frame < trajectory.num_frames
            picture = self.studio.picture(
                in_space(trajectory.position[frame]) if shown else np.empty((0, 3), dtype=np.float32),
                colours_of(trajectory, frame, self.colour, self.limit) if shown else np.empty((0, 3), dtype=np.uint8),
                diameters if shown else np.empty(0),
            )
            page[self.top : self.top + self.rows, left : left + self.columns] = picture
        alpha = self.scenery[..., 3:].astype(np.float32) / 255
        page = np.asarray((page * (1 - alpha) + self.scenery[..., :3] * alpha).round(), dtype=np.uint8)
        stamp = self._stamp(time)
        page[: len(stamp), -stamp.shape[1] :] = np.minimum(page[: len(stamp), -stamp.shape[1] :], stamp)
        return page

    def _stamp(self, time: float) -> Pixels:
        """Return the line over the pictures that says the time."""
        scale = "" if self.time_scale is None else f" = {time / self.time_scale:.2f} $\\tau_c$"
        figure = _figure(self.width / 2, 0.22 * self.resolution, self.resolution)
        figure.text(1 - 0.05 / (INCHES / 2), 0.4, f"$t$ = {time:.3f} s{scale}", size=8, ha="right", va="center")
        return _pixels(figure)[..., :3]

    def _scenery(self, window: Window) -> Pixels:
        """Return titles, lengths of the box and the colour bar, on nothing [rows, columns, 4]."""
        import matplotlib as mpl
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        from gns_pl.viz.raster import colour_map

        with mpl.rc_context(STYLE):
            figure = _figure(self.width, self.height, self.resolution)
            figure.patch.set_alpha(0)
            for left, title in zip(self.lefts, self.trajectories, strict=True):
                place = (left / self.width, 1 - (self.top + self.rows) / self.height)
                axes = figure.add_axes((*place, self.columns / self.width, self.rows / self.height))
                axes.set(xlim=(0, 1), ylim=(0, 1))
                axes.axis("off")
                axes.set_title(title, loc="left", pad=2, fontweight="bold")
                _write_lengths(axes, window, self.camera)
            bar = figure.add_axes((0.33, 0.3 / (self.height / self.resolution), 0.34, 0.07 * self.resolution / self.height))
            figure.colorbar(
                ScalarMappable(Normalize(0, self.limit), colour_map()), cax=bar, orientation="horizontal", extend="max"
            )
            bar.set_xlabel(COLOURINGS[self.colour], labelpad=1)
            bar.tick_params(width=0.6, length=2, pad=1.5, labelsize=7)
            bar.locator_params(nbins=5)
            return _pixels(figure)


def _figure(width: float, height: float, resolution: float) -> Any:
    """Return an empty figure of a size in pixels."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width / resolution, height / resolution), dpi=resolution)


def _pixels(figure: Any) -> Pixels:
    """Return a figure's pixels [rows, columns, 4]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)  # untyped in matplotlib
    canvas.draw()
    return np.array(canvas.buffer_rgba(), dtype=np.uint8)


def _write_lengths(axes: Any, window: Window, camera: Camera) -> None:
    """Write how long the box's edges are, along its front, its right and its left."""
    lower, upper = window.lower, window.upper
    ends = {
        "x": ([lower[0], lower[1], lower[2]], [upper[0], lower[1], lower[2]], "center", "top"),
        "y": ([upper[0], lower[1], lower[2]], [upper[0], upper[1], lower[2]], "left", "top"),
        "z": ([lower[0], lower[1], lower[2]], [lower[0], lower[1], upper[2]], "right", "center"),
    }
    for axis in window.sides:
        start, end, horizontal, vertical = ends[axis]
        seen = camera.project(np.array([start, end]))
        length = float(np.abs(np.subtract(end, start)).sum())
        axes.text(*seen.mean(axis=0), f" ${axis}$: {length:.3g} m ", size=7, color="0.25", ha=horizontal, va=vertical)


class _Studio:
    """VTK's window, with the box and its obstacles in it, for pictures of any grains."""

    def __init__(self, window: Window, camera: Camera, reference: Trajectory, size: tuple[int, int]) -> None:
        if not _draws_without_screen():
            raise InputError(
                "picture: VTK finds no OpenGL to draw without a screen; install one (on Debian: apt install libegl1 "
                "libgl1-mesa-dri) or draw on another machine."
            )
        import pyvista as pv
        from vtkmodules.vtkRenderingCore import vtkActor
        from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLSphereMapper

        self.size = size
        with pv.vtk_verbosity("off"):  # it says at length that there is no screen
            self.plotter = pv.Plotter(off_screen=True, window_size=[OVERSAMPLING * length for length in size])
        self.plotter.set_background("white")
        corners = window.corners()
        floor = pv.PolyData(corners[[0, 4, 6, 2]], faces=[4, 0, 1, 2, 3])
        self.plotter.add_mesh(floor, color="#ececec", lighting=False)
        for a, b in window.edges():
            self.plotter.add_mesh(pv.Line(corners[a], corners[b]), color="#707070", line_width=2, lighting=False)
        for points, triangles in obstacle_solids(reference.scene, window):
            faces = np.insert(triangles, 0, 3, axis=1).ravel()
            self.plotter.add_mesh(pv.PolyData(points, faces=faces), color="#c9c2b6", smooth_shading=False)
        # one quad per grain, whose pixels find the sphere themselves: no mesh of any sphere is made
        self.mapper = vtkOpenGLSphereMapper()
        self.mapper.SetScalarModeToUsePointFieldData()
        self.mapper.SelectColorArray("colour")
        self.mapper.SetColorModeToDirectScalars()
        self.mapper.ScalarVisibilityOn()
        self.mapper.SetScaleArray("radius")
        actor = vtkActor()
        actor.SetMapper(self.mapper)
        self.plotter.add_actor(actor, reset_camera=False)
        diameter = float(np.median(grain_diameters(reference)))
        self.plotter.enable_ssao(radius=4 * diameter, bias=0.2 * diameter, kernel_size=32, blur=True)
        view = self.plotter.camera
        view.position = tuple(camera.eye)
        view.focal_point = tuple(camera.eye + camera.forward * np.linalg.norm(camera.eye - corners.mean(axis=0)))
        view.up = tuple(camera.up)
        view.view_angle = camera.view_angle_deg

    def picture(self, position: NDArray[np.float32], colours: Pixels, diameters: NDArray[np.floating]) -> Pixels:
        """Return a picture of grains [rows, columns, 3]; those that are nowhere are left out."""
        import pyvista as pv

        somewhere = np.isfinite(position).all(axis=1)
        grains = pv.PolyData(position[somewhere])
        grains["colour"] = colours[somewhere]
        grains["radius"] = (0.5 * diameters[somewhere]).astype(np.float32)
        self.mapper.SetInputData(grains)
        with pv.vtk_verbosity("off"):
            self.plotter.reset_camera_clipping_range()
            self.plotter.render()
            image = self.plotter.screenshot(return_img=True)
        columns, rows = self.size
        fine = image[..., :3].reshape(rows, OVERSAMPLING, columns, OVERSAMPLING, 3)
        return np.asarray(fine.mean(axis=(1, 3)).round(), dtype=np.uint8)

    def close(self) -> None:
        """Give the window back."""
        self.plotter.close()
