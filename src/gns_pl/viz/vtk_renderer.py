"""VTK, without a screen: the box of a scene, its obstacles and any grains, as pixels.

PyVista and VTK (extra `viz3d`) are imported inside the functions that draw.
"""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gns_pl.errors import InputError
from gns_pl.trajectory import Trajectory
from gns_pl.viz.camera import Camera, Window, grain_diameters, obstacle_solids

Pixels = NDArray[np.uint8]

PROBE = (
    "import vtkmodules.vtkRenderingOpenGL2; from vtkmodules.vtkRenderingCore import vtkRenderWindow as Window; "
    "window = Window(); window.SetOffScreenRendering(1); window.Render()"
)
"""Tried in a process of its own, since VTK takes a process down where it finds no OpenGL."""


def require(*modules: str) -> None:
    """Raise an `InputError` that says what to install if one of these cannot be imported."""
    for module in modules:
        try:
            __import__(module)
        except ImportError as error:
            raise InputError(
                f"picture: {module} cannot be imported ({error}); pip install 'gns_pl[viz3d]' brings it."
            ) from error


@cache
def draws_without_screen() -> bool:
    """True if VTK can draw here."""
    return subprocess.run([sys.executable, "-c", PROBE], capture_output=True, check=False).returncode == 0


class VTKRenderer:
    """VTK's window, with the box and its obstacles in it, for pictures of any grains."""

    def __init__(
        self, window: Window, camera: Camera, reference: Trajectory, size: tuple[int, int], oversampling: int
    ) -> None:
        if not draws_without_screen():
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
