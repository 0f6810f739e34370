"""Pictures and films of scenes in three dimensions, drawn by VTK without a screen and set in a figure by matplotlib.

PyVista, imageio and matplotlib (extra `viz3d`) are imported inside the functions that draw.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Mapping
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
from gns_pl.viz.raster import colour_map
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

FINE, QUICK = 2, 1
"""Pixels drawn along a side of a pixel kept, in a still and in a film."""

GAP, SIDE = 0.1, 0.2
"""Between pictures, and beside and below each for the lengths of its edges [inches]."""


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
    last = trajectory.num_frames - 1
    if time is not None and not -0.5 <= time / trajectory.dt <= last + 0.5:
        raise InputError(f"picture: time must lie in 0 … {last * trajectory.dt:g} s, not {time:g}.")
    if frame is not None and not 0 <= frame <= last:
        raise InputError(f"picture: frame must lie in 0 … {last}, not {frame}.")
    number = round(time / trajectory.dt) if time is not None else last if frame is None else frame
    number = min(max(number, 0), last)
    with _Sheet({title: trajectory, **(side_by_side or {})}, colour, width, limit, FINE) as sheet:
        from PIL import Image

        with atomic_path(path) as temporary:
            Image.fromarray(sheet.draw(number * trajectory.dt)).save(temporary, format="PNG", dpi=(width / INCHES,) * 2)
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
    with _Sheet(trajectories, colour, width, limit, QUICK) as sheet, atomic_path(path) as temporary:
        reference = list(trajectories.values())[-1]
        moments = [frame * reference.dt for frame in evenly(reference.num_frames, num_frames)]
        pictures = (sheet.draw(moment) for moment in moments)
        beat = PLAY_SECONDS / len(moments)
        if path.suffix == ".gif":
            _write_gif(temporary, pictures, beat)
        else:
            _write_mp4(temporary, pictures, beat, sheet.shape)
    return path


def _write_gif(path: Path, pictures: Iterator[Pixels], beat: float) -> None:
    """Write pictures that stay for `beat` [s] each, over and over again."""
    import imageio.v2 as imageio

    with imageio.get_writer(path, format="GIF", duration=1000 * beat, loop=0) as film:
        for picture in pictures:
            film.append_data(picture)


def _write_mp4(path: Path, pictures: Iterator[Pixels], beat: float, shape: tuple[int, int]) -> None:
    """Write pictures of a shape that stay for `beat` [s] each; imageio itself goes by a file's ending."""
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

    def __init__(
        self, trajectories: Mapping[str, Trajectory], colour: str, width: int, limit: float | None, oversampling: int
    ) -> None:
        self.trajectories = dict(trajectories)
        self.colour = colour
        window = window_of(list(self.trajectories.values()))
        reference = list(self.trajectories.values())[-1]
        self.limit = limit_of(reference, colour) if limit is None else limit
        _require("pyvista", "matplotlib", "PIL")
        self.camera = camera_of(window, reference.scene.dim)
        self.time_scale = collapse_time(reference.scene)
        self.diameters = [grain_diameters(trajectory) for trajectory in self.trajectories.values()]
        number = len(self.trajectories)
        self.resolution = width / INCHES
        panel = (INCHES - GAP * (number - 1)) / number - 2 * SIDE
        self.columns = round(panel * self.resolution)
        self.rows = round(self.columns / self.camera.ratio)
        self.lefts = [round((SIDE + index * (panel + 2 * SIDE + GAP)) * self.resolution) for index in range(number)]
        self.top = round((0.42 if any(self.trajectories) else 0.25) * self.resolution)
        height = self.top + self.rows + round((SIDE + 0.5) * self.resolution)
        self.shape = (height + height % 2, width + width % 2)  # H.264 wants even numbers
        self.studio = _Studio(window, self.camera, reference, (self.columns, self.rows), oversampling)
        self.scenery = self._scenery(window)

    def __enter__(self) -> _Sheet:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.studio.close()

    def draw(self, time: float) -> Pixels:
        """Return the figure at a time [s] as pixels [rows, columns, 3]."""
        page = self.scenery.copy()
        for left, diameters, trajectory in zip(self.lefts, self.diameters, self.trajectories.values(), strict=True):
            frame = round(time / trajectory.dt)
            if frame < trajectory.num_frames:
                colours = colours_of(trajectory, frame, self.colour, self.limit)
                picture = self.studio.picture(in_space(trajectory.position[frame]), colours, diameters)
            else:
                picture = self.studio.picture(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8), np.empty(0))
            place = page[self.top : self.top + self.rows, left : left + self.columns]
            np.minimum(place, picture, out=place)  # ink of the scenery stays
        stamp = self._stamp(time)
        page[: len(stamp)] = np.minimum(page[: len(stamp)], stamp)
        return page

    def _stamp(self, time: float) -> Pixels:
        """Return the line over the pictures that says the time."""
        scale = "" if self.time_scale is None else f" = {time / self.time_scale:.2f} $\\tau_c$"
        figure = _figure(self.shape[1], round(0.24 * self.resolution), self.resolution)
        figure.text(0.5, 0.4, f"$t$ = {time:.3f} s{scale}", size=8, ha="center", va="center")
        return _pixels(figure)

    def _scenery(self, window: Window) -> Pixels:
        """Return titles, lengths of the box and the colour bar on white [rows, columns, 3]."""
        import matplotlib as mpl
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        height, width = self.shape
        inch = self.resolution / height
        with mpl.rc_context(STYLE):
            figure = _figure(width, height, self.resolution)
            for left, title in zip(self.lefts, self.trajectories, strict=True):
                place = (left / width, 1 - (self.top + self.rows) / height, self.columns / width, self.rows / height)
                axes = figure.add_axes(place, xlim=(0, 1), ylim=(0, 1))
                axes.axis("off")
                axes.set_title(title, loc="left", pad=3, fontweight="bold")
                _write_lengths(axes, window, self.camera)
            bar = figure.add_axes((0.33, 0.36 * inch, 0.34, 0.08 * inch))
            values = ScalarMappable(Normalize(0, self.limit), colour_map())
            figure.colorbar(values, cax=bar, orientation="horizontal", extend="max", extendfrac=0.03)
            bar.set_xlabel(COLOURINGS[self.colour], labelpad=1)
            bar.tick_params(width=0.6, length=2, pad=1.5, labelsize=7)
            bar.locator_params(nbins=5)
            return _pixels(figure)


def _figure(width: int, height: int, resolution: float) -> Any:
    """Return an empty figure of a size in pixels."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width / resolution, height / resolution), dpi=resolution)


def _pixels(figure: Any) -> Pixels:
    """Return a figure's pixels [rows, columns, 3]."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)  # untyped in matplotlib
    canvas.draw()
    return np.array(canvas.buffer_rgba(), dtype=np.uint8)[..., :3]


def _write_lengths(axes: Any, window: Window, camera: Camera) -> None:
    """Write how long the box is along the edges nearest to the reader, outside the box and along the edge."""
    lower, upper = window.lower, window.upper
    starts = {"x": lower, "y": np.array([upper[0], lower[1], lower[2]]), "z": lower}
    _, _, columns, rows = axes.get_window_extent().bounds
    for axis in window.sides:
        index = "xyz".index(axis)
        length = float(upper[index] - lower[index])
        start, end = camera.project(starts[axis] + length * np.array([[0.0], [1.0]]) * np.eye(3)[index])
        along = (end - start) * [columns, rows]
        along /= np.linalg.norm(along)
        outwards = np.array([-along[1], along[0]]) if axis == "z" else np.array([along[1], -along[0]])
        axes.annotate(
            f"{length:.3g} m",
            0.5 * (start + end),
            xytext=tuple(7 * outwards),
            textcoords="offset points",
            rotation=float(np.degrees(np.arctan2(along[1], along[0]))),
            rotation_mode="anchor",
            ha="center",
            va="center",
            size=7,
            color="0.25",
        )


class _Studio:
    """VTK's window, with the box and its obstacles in it, for pictures of any grains."""

    def __init__(
        self, window: Window, camera: Camera, reference: Trajectory, size: tuple[int, int], oversampling: int
    ) -> None:
        if not _draws_without_screen():
            raise InputError(
                "picture: VTK finds no OpenGL to draw without a screen; install one (on Debian: apt install libegl1 "
                "libgl1-mesa-dri) or draw on another machine."
            )
        import pyvista as pv

        self.size, self.oversampling = size, oversampling
        with pv.vtk_verbosity("off"):  # it says at length that there is no screen
            self.plotter = pv.Plotter(off_screen=True, window_size=[oversampling * length for length in size])
        self.plotter.set_background("white")
        corners = window.corners()
        lines = np.array([(2, a, b) for a, b in window.edges()])
        floor = pv.PolyData(corners[[0, 4, 6, 2]], faces=[4, 0, 1, 2, 3])
        self.plotter.add_mesh(floor, color="#ececec", lighting=False)
        outline = pv.PolyData(corners, lines=lines.ravel())
        self.plotter.add_mesh(outline, color="#707070", line_width=1.2 * oversampling, lighting=False)
        for points, triangles in obstacle_solids(reference.scene, window):
            solid = pv.PolyData(points, faces=np.insert(triangles, 0, 3, axis=1).ravel())
            self.plotter.add_mesh(solid, color="#cfc8bb", ambient=0.35, diffuse=0.7)
        self.mapper = _sphere_mapper()
        self.grains = self._add(self.mapper)
        diameter = float(np.median(grain_diameters(reference)))
        self.plotter.enable_ssao(radius=4 * diameter, bias=0.2 * diameter, kernel_size=32, blur=True)
        view = self.plotter.camera
        view.position = tuple(camera.eye)
        view.focal_point = tuple(camera.eye + camera.forward * np.linalg.norm(camera.eye - corners.mean(axis=0)))
        view.up = tuple(camera.up)
        view.view_angle = camera.view_angle_deg

    def _add(self, mapper: Any) -> Any:
        from vtkmodules.vtkRenderingCore import vtkActor

        actor = vtkActor()
        actor.SetMapper(mapper)
        surface = actor.GetProperty()
        surface.SetAmbient(0.3)  # colours in the shade can still be told apart
        surface.SetDiffuse(0.8)
        self.plotter.add_actor(actor, reset_camera=False)
        return actor

    def picture(self, position: NDArray[np.float32], colours: Pixels, diameters: NDArray[np.floating]) -> Pixels:
        """Return a picture of grains [rows, columns, 3]; those that are nowhere are left out."""
        import pyvista as pv

        somewhere = np.isfinite(position).all(axis=1)
        self.grains.SetVisibility(bool(somewhere.any()))
        if somewhere.any():
            grains = pv.PolyData(position[somewhere])
            grains["colour"] = colours[somewhere]
            grains["radius"] = (0.5 * diameters[somewhere]).astype(np.float32)
            self.mapper.SetInputData(grains)
        with pv.vtk_verbosity("off"):
            self.plotter.reset_camera_clipping_range()
            self.plotter.render()  # a screenshot alone is of what was drawn before
            image = self.plotter.screenshot(return_img=True)
        if self.oversampling == 1:
            return np.asarray(image[..., :3], dtype=np.uint8)
        columns, rows = self.size
        fine = image[..., :3].reshape(rows, self.oversampling, columns, self.oversampling, 3)
        return np.asarray(fine.mean(axis=(1, 3)).round(), dtype=np.uint8)

    def close(self) -> None:
        """Give the window back."""
        self.plotter.close()


def _sphere_mapper() -> Any:
    """Return what draws a quad per grain, whose pixels find the sphere themselves: no sphere is ever meshed."""
    from vtkmodules.vtkRenderingOpenGL2 import vtkOpenGLSphereMapper

    mapper = vtkOpenGLSphereMapper()
    mapper.SetScalarModeToUsePointFieldData()
    mapper.SelectColorArray("colour")
    mapper.SetColorModeToDirectScalars()
    mapper.ScalarVisibilityOn()
    mapper.SetScaleArray("radius")
    return mapper
