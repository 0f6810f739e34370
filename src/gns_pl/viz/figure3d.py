"""The figure around pictures in three dimensions, by matplotlib: titles, time, lengths of the box, colour bar."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.trajectory import Trajectory
from gns_pl.viz.camera import (
    COLOURINGS,
    Camera,
    Window,
    camera_of,
    collapse_time,
    colours_of,
    grain_diameters,
    in_space,
    limit_of,
    window_of,
)
from gns_pl.viz.colouring import Colouring, material_names
from gns_pl.viz.plots import STYLE
from gns_pl.viz.raster import colour_map
from gns_pl.viz.vtk_renderer import Pixels, VTKRenderer, require

INCHES = 7.0
"""Width of a figure, that of a page: letters are as large as in the other figures."""

GAP, SIDE = 0.1, 0.2
"""Between pictures, and beside and below each for the lengths of its edges [inches]."""


class Figure3D:
    """A figure with a picture per trajectory, whose scenery is drawn once and whose grains at every moment."""

    def __init__(
        self, trajectories: Mapping[str, Trajectory], colour: str, width: int, limit: float | None, oversampling: int
    ) -> None:
        self.trajectories = dict(trajectories)
        self.colour = colour
        window = window_of(list(self.trajectories.values()))
        reference = list(self.trajectories.values())[-1]
        self.materials = Colouring(material_names(reference), 1.0) if colour == "material" else None
        if self.materials is not None and not self.materials.names:
            raise InputError("picture: there are no materials to tell apart; choose another colour.")
        self.limit = limit_of(reference, colour) if limit is None and self.materials is None else limit or 1.0
        require("pyvista", "matplotlib", "PIL")
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
        self.renderer = VTKRenderer(window, self.camera, reference, (self.columns, self.rows), oversampling)
        self.scenery = self._scenery(window)

    def __enter__(self) -> Figure3D:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.renderer.close()

    def draw(self, time: float) -> Pixels:
        """Return the figure at a time [s] as pixels [rows, columns, 3]."""
        page = self.scenery.copy()
        for left, diameters, trajectory in zip(self.lefts, self.diameters, self.trajectories.values(), strict=True):
            frame = round(time / trajectory.dt)
            if frame < trajectory.num_frames:
                if self.materials is not None:
                    colours = self.materials.pixels(trajectory, frame)
                else:
                    colours = colours_of(trajectory, frame, self.colour, self.limit)
                picture = self.renderer.picture(in_space(trajectory.position[frame]), colours, diameters)
            else:
                picture = self.renderer.picture(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8), np.empty(0))
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
            if self.materials is not None:
                number = len(self.materials.names)
                values = ScalarMappable(Normalize(0, number), self.materials.colour_map())
                figure.colorbar(values, cax=bar, orientation="horizontal")
                bar.set_xticks(np.arange(number) + 0.5, self.materials.names, fontsize=8)
                bar.tick_params(length=0)
                return _pixels(figure)
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
