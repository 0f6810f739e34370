"""A view of a trajectory to turn and play in a notebook: all its data are in the figure, so that no server is needed.

plotly (extra `viz3d`) is imported inside the function that draws.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.trajectory import Trajectory
from gns_pl.viz.camera import (
    COLOURINGS,
    KINEMATIC_GREY,
    TOWARDS_EYE,
    Window,
    collapse_time,
    evenly,
    grain_diameters,
    in_space,
    limit_of,
    obstacle_solids,
    values_of,
    window_of,
)
from gns_pl.viz.raster import colour_map

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

HEIGHT = 560
"""Of the view [pixels]."""

RIM = {"width": 1, "color": "rgba(0,0,0,0.12)"}
"""Around a grain; plotly gives points no light, so that equal colours would run into one."""

BEAT = 70
"""Time that a frame stays while the view plays [ms]."""


def interactive(
    trajectory: Trajectory, *, colour: str = "displacement", max_particles: int = 5000, max_frames: int = 60
) -> Figure:
    """Return a figure of plotly's to turn, zoom and play, which also works in a saved or exported notebook.

    Args:
        trajectory: what to show.
        colour: "displacement" or "speed".
        max_particles: of more, so many are shown, drawn at random and always the same.
        max_frames: of more, so many are shown, evenly spaced, the first and the last among them.

    Raises:
        InputError: plotly or matplotlib missing, an unknown colouring, nothing to be shown.
    """
    for name, least in (("max_particles", max_particles), ("max_frames", max_frames)):
        if least < 1:
            raise InputError(f"view: {name} must be at least 1, not {least}.")
    try:
        import matplotlib  # noqa: F401
        import plotly.graph_objects as go
    except ImportError as error:
        raise InputError(
            f"view: {error.name} cannot be imported; pip install 'gns_pl[viz,viz3d]' brings it."
        ) from error
    window = window_of([trajectory])
    limit = limit_of(trajectory, colour)
    chosen = np.arange(trajectory.num_particles)
    if len(chosen) > max_particles:
        chosen = np.sort(np.random.default_rng(0).choice(chosen, max_particles, replace=False))
    kinematic = trajectory.particle_type[chosen] == ParticleType.KINEMATIC
    pixels_per_metre = 0.8 * HEIGHT / float(np.linalg.norm(window.upper - window.lower))
    size = max(2.0, 1.3 * pixels_per_metre * float(np.median(grain_diameters(trajectory))))
    scale = collapse_time(trajectory.scene)

    def grains(frame: int) -> dict[str, Any]:
        place = in_space(trajectory.position[frame])[chosen[~kinematic]]
        values = values_of(trajectory, frame, colour)[chosen[~kinematic]].astype(np.float32)
        return {"x": place[:, 0], "y": place[:, 1], "z": place[:, 2], "marker": {"color": values}}

    def scripted(frame: int) -> dict[str, Any]:
        place = in_space(trajectory.position[frame])[chosen[kinematic]]
        return {"x": place[:, 0], "y": place[:, 1], "z": place[:, 2]}

    bar = {"title": {"text": COLOURINGS[colour], "side": "right"}, "thickness": 12, "len": 0.6}
    stops = [[float(share), _css(colour_map()(float(share)))] for share in np.linspace(0, 1, 17)]
    first = grains(0)
    first["marker"] |= {"line": RIM, "size": size, "colorscale": stops, "cmin": 0, "cmax": limit, "colorbar": bar}
    traces = [
        go.Scatter3d(**first, mode="markers", hoverinfo="skip"),
        go.Scatter3d(
            **scripted(0),
            mode="markers",
            hoverinfo="skip",
            marker={"size": size, "line": RIM, "color": _css(np.array(KINEMATIC_GREY) / 255)},
        ),
        _outline(window.corners(), window.edges()),
    ]
    for points, triangles in obstacle_solids(trajectory.scene, window):
        x, y, z = points.T
        i, j, k = triangles.T
        traces.append(go.Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, color="#cfc8bb", flatshading=True, hoverinfo="skip"))
    moments = evenly(trajectory.num_frames, max_frames)
    frames = [
        go.Frame(data=[go.Scatter3d(**grains(frame)), go.Scatter3d(**scripted(frame))], traces=[0, 1], name=str(frame))
        for frame in moments
    ]
    figure = go.Figure(data=traces, frames=frames)
    labels = [_moment(frame * trajectory.dt, scale) for frame in moments]
    _lay_out(figure, trajectory.scene.dim, window)
    _add_controls(figure, [str(frame) for frame in moments], labels)
    return figure


def _css(colour: Any) -> str:
    """Return a colour of parts from 0 to 1 as the web writes it."""
    return "rgb({:.0f},{:.0f},{:.0f})".format(*(255 * part for part in list(colour)[:3]))


def _moment(time: float, scale: float | None) -> str:
    return f"{time:.3f} s" + ("" if scale is None else f" = {time / scale:.2f} τc")


def _outline(corners: Any, edges: list[tuple[int, int]]) -> Any:
    """Return the edges of a box as one broken line."""
    import plotly.graph_objects as go

    gap = np.full(3, np.nan)
    x, y, z = np.array([point for a, b in edges for point in (corners[a], corners[b], gap)]).T
    return go.Scatter3d(x=x, y=y, z=z, mode="lines", line={"color": "#707070", "width": 2}, hoverinfo="skip")


def _lay_out(figure: Any, dim: int, window: Window) -> None:
    """Set axes as long as the window and of true proportions, a white ground and the camera."""
    plain = {"showbackground": False, "showgrid": False, "zeroline": False, "showspikes": False, "nticks": 4}
    lengths = window.upper - window.lower
    share = lengths / np.linalg.norm(lengths) * 2.2
    ranges = [[float(low), float(high)] for low, high in zip(window.lower, window.upper, strict=True)]
    towards = np.array(TOWARDS_EYE[dim]) / np.linalg.norm(TOWARDS_EYE[dim])
    eye = dict(zip("xyz", (float(part) for part in 1.9 * towards), strict=True))
    figure.update_layout(
        height=HEIGHT,
        margin={"l": 0, "r": 0, "t": 10, "b": 10},
        paper_bgcolor="white",
        showlegend=False,
        scene={
            "xaxis": {"title": {"text": "x [m]"}, "range": ranges[0], **plain},
            "yaxis": {"title": {"text": "y [m]"}, "range": ranges[1], "visible": dim == 3, **plain},
            "zaxis": {"title": {"text": "z [m]"}, "range": ranges[2], **plain},
            "aspectmode": "manual",
            "aspectratio": dict(zip("xyz", (float(part) for part in share), strict=True)),
            "camera": {"eye": eye, "projection": {"type": "perspective"}},
            "dragmode": "turntable",
        },
    )


def _add_controls(figure: Any, names: list[str], labels: list[str]) -> None:
    """Add a slider with a stop per frame, and buttons that play and pause."""

    def show(duration: int) -> dict[str, Any]:
        return {"mode": "immediate", "frame": {"duration": duration, "redraw": True}, "transition": {"duration": 0}}

    steps = [
        {"method": "animate", "args": [[name], show(0)], "label": label}
        for name, label in zip(names, labels, strict=True)
    ]
    buttons = [
        {"method": "animate", "label": "▶", "args": [None, {**show(BEAT), "fromcurrent": True}]},
        {"method": "animate", "label": "❚❚", "args": [[None], show(0)]},
    ]
    figure.update_layout(
        sliders=[
            {
                "steps": steps,
                "x": 0.12,
                "len": 0.85,
                "y": 0.02,
                "pad": {"t": 0, "b": 10},
                "currentvalue": {"prefix": "t = ", "xanchor": "center", "font": {"color": "black"}},
                "ticklen": 0,
                "minorticklen": 0,
                "font": {"color": "rgba(0,0,0,0)"},  # sixty labels below a slider cannot be read
            }
        ],
        updatemenus=[
            {"type": "buttons", "buttons": buttons, "direction": "left", "x": 0.1, "xanchor": "right", "y": 0.0}
        ],
    )
