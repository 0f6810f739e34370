"""The view for notebooks: its numbers are the trajectory's, and they are all in it."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from gns_pl.errors import InputError
from gns_pl.fields import ParticleType
from gns_pl.scene import Box, Wall
from gns_pl.trajectory import Trajectory
from gns_pl.viz import interactive
from gns_pl.viz.camera import limit_of
from tests.evaluation.made_up import column, spreading, standing

pytest.importorskip("plotly")


def places(trace: object) -> np.ndarray:
    return np.stack([trace.x, trace.y, trace.z], axis=1)


@pytest.fixture
def flow() -> Trajectory:
    flow = spreading(column().replace(obstacles=(Box((1.2, 0.1, 0.0), (0.1, 0.3, 0.1), Wall("slip")),)), frames=9)
    types = flow.particle_type.copy()
    types[:2] = ParticleType.KINEMATIC
    return replace(flow, particle_type=types)


def test_the_frames_are_the_trajectory(flow: Trajectory) -> None:
    figure = interactive(flow, colour="speed")
    assert len(figure.frames) == len(figure.layout.sliders[0].steps) == 9
    speed = np.linalg.norm(flow.velocity(), axis=2)
    for index, frame in enumerate(figure.frames):
        grains, scripted = frame.data
        assert np.array_equal(places(grains), flow.position[index, 2:])
        assert np.array_equal(places(scripted), flow.position[index, :2])
        np.testing.assert_allclose(grains.marker.color, speed[index, 2:], rtol=1e-5, atol=1e-6)
        assert frame.name == figure.layout.sliders[0].steps[index].args[0][0]
    assert np.array_equal(places(figure.data[0]), flow.position[0, 2:])
    assert figure.data[0].marker.cmax == pytest.approx(limit_of(flow, "speed")) and figure.data[0].marker.cmin == 0
    assert "0.160 s = 1.12 τc" in figure.layout.sliders[0].steps[-1].label


def test_proportions_are_those_of_the_box(flow: Trajectory) -> None:
    figure = interactive(flow)
    share = figure.layout.scene.aspectratio
    assert figure.layout.scene.aspectmode == "manual"
    assert share.x / share.y == pytest.approx(1.5 / 0.5) and share.x / share.z == pytest.approx(1.5 / 0.25)
    drawn = np.concatenate([places(figure.data[2]), places(figure.data[3])])
    for axis, name in enumerate("xyz"):
        low, high = figure.layout.scene[f"{name}axis"].range
        assert (low, high) == pytest.approx((np.nanmin(drawn[:, axis]), np.nanmax(drawn[:, axis])))


def test_more_particles_and_frames_than_wanted_are_thinned(flow: Trajectory) -> None:
    figure = interactive(flow, max_particles=50, max_frames=3)
    assert [frame.name for frame in figure.frames] == ["0", "4", "8"]
    shown = sum(len(trace.x) for trace in figure.frames[0].data)
    assert shown == 50
    again = interactive(flow, max_particles=50, max_frames=3)
    assert np.array_equal(figure.frames[1].data[0].x, again.frames[1].data[0].x)
    assert np.isin(figure.frames[2].data[0].z, flow.position[8, :, 2]).all()


def test_a_saved_view_needs_no_server(flow: Trajectory) -> None:
    content = interactive(flow, max_frames=2).to_json()
    assert len(json.loads(content)["frames"]) == 2
    assert "http" not in content


def test_two_dimensions_are_a_slice() -> None:
    figure = interactive(standing(column(2)))
    assert not np.any(figure.data[0].y) and figure.layout.scene.yaxis.visible is False


def test_what_cannot_be_shown_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="max_frames must be at least 1"):
        interactive(standing(), max_frames=0)
    with pytest.raises(InputError, match="colour must be one of"):
        interactive(standing(), colour="hue")
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with pytest.raises(InputError, match=r"pip install 'gns_pl\[viz,viz3d\]'"):
        interactive(standing())
