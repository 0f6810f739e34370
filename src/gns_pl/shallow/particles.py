"""Particles of equal volume under a layer, and back to a `Trajectory`'s positions.

Particle number n has a share of the volume before it along x, a share of its row's volume before it along y, and a
share of its column's volume below it, all three fixed for the whole run: a Hammersley set, evenly spread in the unit
cube (Halton 1960). In every frame the shares are mapped through the layer's volume, the Knothe–Rosenblatt map. In one
horizontal dimension it is the motion of the layer's columns itself; in two it gives the layer in every frame, while
single particles need not move as the layer's columns do.
"""

# ruff: noqa: D417 (arguments of one kind share a line)
# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gns_pl.shallow.compiled import compiled

Floats = NDArray[np.float64]


def hammersley(number: int, seed: int) -> Floats:
    """Return evenly spread points of the unit cube [number, 3], all shifted by one random vector, the first rising."""
    index = np.arange(number)
    shift = np.random.default_rng(seed).random(3)
    points = np.stack([(index + shift[0]) / number, radical_inverse(index, 3), radical_inverse(index, 2)], axis=1)
    points[:, 1:] = (points[:, 1:] + shift[1:]) % 1.0
    return points


def radical_inverse(index: NDArray[np.int64], base: int) -> Floats:
    """Return numbers mirrored at their point, van der Corput's sequence [N]."""
    value, digit, rest = np.zeros(len(index)), 1.0, index.copy()
    while rest.any():
        digit /= base
        value += digit * (rest % base)
        rest //= base
    return value


@compiled
def place(shares, layer, falling, bottom, height, x_edges, y_edges, position):
    """Write the particles' positions.

    Args:
        shares: along x, along z, along y [N, 3], the first column rising.
        layer: thickness of every cell [C] [m].
        falling: thickness that is still in the air over every cell [C] [m].
        bottom: least height over the bed at which what is in the air begins [C] [m].
        height: of the bed [C] [m].
        x_edges, y_edges: edges of the cells [NX + 1], [NY + 1] [m].
        position: x, y and z of every particle [N, 3] [m].
    """
    nx, ny = len(x_edges) - 1, len(y_edges) - 1
    rows = np.zeros(nx)
    total = 0.0
    for i in range(nx):
        for j in range(ny):
            rows[i] += (layer[i * ny + j] + falling[i * ny + j]) * (y_edges[j + 1] - y_edges[j])
        rows[i] *= x_edges[i + 1] - x_edges[i]
        total += rows[i]
    i, before = 0, 0.0
    for n in range(len(shares)):
        wanted = shares[n, 0] * total
        while i < nx - 1 and (rows[i] <= 0.0 or before + rows[i] <= wanted):
            before += rows[i]
            i += 1
        while rows[i] <= 0.0:  # rounding led beyond the last row that holds anything
            i -= 1
            before -= rows[i]
        part = min(max((wanted - before) / rows[i], 0.0), 1.0)
        position[n, 0] = x_edges[i] + part * (x_edges[i + 1] - x_edges[i])
        wanted = shares[n, 2] * rows[i] / (x_edges[i + 1] - x_edges[i])
        j, last, side, column = 0, 0, 0.0, 0.0
        while j < ny:
            thickness = layer[i * ny + j] + falling[i * ny + j]
            if thickness > 0.0:
                last, side = j, side + column
                column = thickness * (y_edges[j + 1] - y_edges[j])
                if side + column > wanted:
                    break
            j += 1
        part = min(max((wanted - side) / column, 0.0), 1.0)
        position[n, 1] = y_edges[last] + part * (y_edges[last + 1] - y_edges[last])
        cell = i * ny + last
        up = shares[n, 1] * (layer[cell] + falling[cell])
        if up > layer[cell]:
            up += max(bottom[cell] - layer[cell], 0.0)
        position[n, 2] = height[cell] + up
