"""Names beside the marks of a figure: none covers a mark, another name or the edge of its axes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]
Booleans = NDArray[np.bool_]

GAPS = (3.0, 7.0, 12.0, 18.0, 25.0, 34.0, 45.0, 58.0, 74.0, 92.0)
"""Distances of a name from its mark [pt], the nearest first."""

DIRECTIONS = 24
COVERED, CROSSED_NAME, CROSSED_LEADER, CROSSED_MARK = 1e4, 300.0, 200.0, 200.0
ON_LINE, NEARER_TO_ANOTHER, NOT_RIGHT = 70.0, 20.0, 3.0
"""What is to be avoided costs as much as a leader line of so many points."""

LEADER_FROM = 6.0
"""A name farther from its mark than this has a leader line [pt]."""
PLACES, STARTS = 80, 16
"""Places of a name that are looked at, the best by themselves, and searches among them, the best of which counts."""

TEMPERATURES = (*np.geomspace(60, 2, 30), 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Label:
    """A name and where it belongs: text, place in data coordinates, colour of text and leader line."""

    text: str
    place: tuple[float, float]
    colour: tuple[float, float, float]


def write_labels(
    axes: Any, labels: Sequence[Label], *, marks: Floats, lines: Floats, size: float, radius: float
) -> list[Any]:
    """Write names beside their marks, with thin leader lines where they had to go farther.

    Every name has places on rectangles around its mark. Near ones are best; a name on a line, a leader line across
    others, and a name that is nearer to another mark cost something. A name without a free place is not written.

    Args:
        axes: at their final place in the figure, with final limits.
        labels: names.
        marks: centres of all marks in data coordinates, [M, 2].
        lines: start and end of all straight lines that names should not lie on, in data coordinates, [S, 2, 2].
        size: of the font [pt].
        radius: of a mark [pt].

    Returns:
        The texts that were written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    if not labels:
        return []
    to_points = 72 / axes.figure.dpi
    renderer: Any = FigureCanvasAgg(axes.figure).get_renderer()  # type: ignore[no-untyped-call]
    texts = [axes.annotate(label.text, label.place, fontsize=size, color=label.colour) for label in labels]
    extents = [text.get_window_extent(renderer) for text in texts]
    for text in texts:
        text.remove()
    sizes = to_points * np.array([(extent.width, extent.height) for extent in extents]) + (2.0, 0.0)
    spots = to_points * axes.transData.transform(np.array([label.place for label in labels]))
    centres = to_points * axes.transData.transform(marks)
    ends = to_points * axes.transData.transform(lines.reshape(-1, 2)).reshape(-1, 2, 2)
    inside = to_points * axes.bbox.get_points().reshape(4)

    places = _choose(spots, sizes, centres, ends, inside, radius)
    written = []
    for label, spot, box in zip(labels, spots, places, strict=True):
        if box is None:
            continue
        near = np.clip(spot, box[:2], box[2:])
        if np.hypot(*(near - spot)) > LEADER_FROM + radius:
            line = {"arrowstyle": "-", "color": label.colour, "linewidth": 0.5, "shrinkA": 0.5, "shrinkB": radius}
            axes.annotate(
                "", label.place, xytext=near - spot, textcoords="offset points", arrowprops=line, annotation_clip=False
            )
        offset = (box[:2] + box[2:]) / 2 - spot
        written.append(
            axes.annotate(
                label.text, label.place, xytext=offset, textcoords="offset points", fontsize=size, color=label.colour,
                ha="center", va="center", annotation_clip=False,
            )
        )  # fmt: skip
    return written


def _choose(
    spots: Floats, sizes: Floats, marks: Floats, lines: Floats, inside: Floats, radius: float
) -> list[Floats | None]:
    """Return the box of every name, or none where all are covered; everything in points.

    Args:
        spots: centres of the marks that the names belong to, [L, 2].
        sizes: width and height of the names, [L, 2].
        marks: centres of all marks, [M, 2].
        lines: start and end, [S, 2, 2].
        inside: left, bottom, right and top of the axes.
        radius: of a mark.
    """
    mark_boxes = np.concatenate([marks - radius - 0.5, marks + radius + 0.5], axis=1)
    boxes, leaders, costs = [], [], []
    for spot, extent in zip(spots, sizes, strict=True):
        own = _candidates(spot, extent, radius)
        leader = np.stack([np.broadcast_to(spot, (len(own), 2)), np.clip(spot, own[:, :2], own[:, 2:])], axis=1)
        length = np.hypot(*(leader[:, 1] - leader[:, 0]).T)
        away = np.maximum(np.maximum(own[:, None, :2] - marks, marks - own[:, None, 2:]), 0)  # [C, M, 2]
        foreign = np.hypot(*(marks - spot).T) > 0.5
        outside = (own[:, :2] < inside[:2]).any(1) | (own[:, 2:] > inside[2:]).any(1)
        cost = length + COVERED * (10 * outside + _overlap(own, mark_boxes).sum(1))
        nearer = np.hypot(*away.transpose(2, 0, 1))[:, foreign] < length[:, None]
        cost += NEARER_TO_ANOTHER * nearer.sum(1).clip(max=3)
        cost += CROSSED_MARK * (_hit(leader, mark_boxes)[:, foreign] & (length > LEADER_FROM + radius)[:, None]).sum(1)
        cost += NOT_RIGHT * (own[:, 0] < spot[0])
        if len(lines):
            cost += ON_LINE * _hit(lines, own).sum(0)
        best = np.argsort(cost, kind="stable")[:PLACES]
        boxes.append(own[best])
        leaders.append(leader[best])
        costs.append(cost[best])

    chosen = _least(_pairs(boxes, leaders), np.stack(costs))
    found: list[Floats | None] = []
    for index, own in enumerate(boxes):
        box = own[chosen[index]]
        written = [other for other in found if other is not None]
        covers = bool(written) and _overlap(box[None], np.stack(written)).any()
        found.append(None if covers or costs[index][chosen[index]] >= COVERED else box)
    return found


def _pairs(boxes: Sequence[Floats], leaders: Sequence[Floats]) -> Floats:
    """Return what two names cost each other in all of their places, [L, C, L, C]."""
    number, places = len(boxes), len(boxes[0])
    flat, lines = np.concatenate(boxes).astype(np.float32), np.concatenate(leaders).astype(np.float32)
    through = _hit(lines, flat)
    apart = np.array([-2, -0.5, 2, 0.5], dtype=np.float32)
    cost = COVERED * _overlap(flat, flat + apart).astype(np.float32)
    cost += CROSSED_LEADER * _crossed(lines, lines)
    cost += CROSSED_NAME * (through | through.T)
    cost = cost.reshape(number, places, number, places)
    cost[np.arange(number), :, np.arange(number)] = 0
    return cost


def _least(pairs: Floats, alone: Floats) -> NDArray[np.intp]:
    """Return the place of every name, [L], by simulated annealing: one name at a time is drawn anew given the others.

    Args:
        pairs: what two names cost each other, [L, C, L, C].
        alone: what each costs by itself, [L, C].
    """
    generator, every = np.random.default_rng(0), np.arange(len(alone))
    best: NDArray[np.intp] = np.argmin(alone, axis=1)
    least = math.inf
    for _ in range(STARTS):
        chosen = np.argmin(alone, axis=1)
        for temperature in TEMPERATURES:
            for index in generator.permutation(every):
                cost = alone[index] + pairs[index][:, every, chosen].sum(1)
                chosen[index] = np.argmin(cost + temperature * generator.gumbel(size=len(cost)))
        total = alone[every, chosen].sum() + 0.5 * pairs[every, chosen][:, every, chosen].sum()
        if total < least:
            best, least = chosen, total
    return best


def _candidates(spot: Floats, extent: Floats, radius: float) -> Floats:
    """Return left, bottom, right and top of all boxes of a name around its mark, [C, 4]."""
    angle = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    around /= np.abs(around).max(axis=1, keepdims=True)
    gaps = radius + np.array(GAPS)
    centres = spot + (around * (extent / 2 + gaps[:, None, None])).reshape(-1, 2)
    return np.concatenate([centres - extent / 2, centres + extent / 2], axis=1)


def _overlap(boxes: Floats, others: Floats) -> Booleans:
    """Return whether boxes share an area, [A, 4] and [B, 4] → [A, B]."""
    left, bottom, right, top = boxes.T[:, :, None]
    return np.asarray((left < others[:, 2]) & (right > others[:, 0]) & (bottom < others[:, 3]) & (top > others[:, 1]))


def _hit(segments: Floats, boxes: Floats) -> Booleans:
    """Return whether segments run through boxes, [S, 2, 2] and [B, 4] → [S, B]; by the slabs of each axis."""
    enter, leave = np.zeros_like(segments[:, :1, 0]), np.ones_like(segments[:, :1, 0])
    for axis in (0, 1):
        start, along = segments[:, None, 0, axis], segments[:, None, 1, axis] - segments[:, None, 0, axis]
        along = 1 / np.where(np.abs(along) < 1e-9, 1e-9, along)
        one, two = (boxes[:, axis] - start) * along, (boxes[:, axis + 2] - start) * along
        enter, leave = np.maximum(enter, np.minimum(one, two)), np.minimum(leave, np.maximum(one, two))
    return np.asarray(enter < leave)


def _crossed(segments: Floats, others: Floats) -> Booleans:
    """Return whether segments cross, [A, 2, 2] and [B, 2, 2] → [A, B]."""

    def apart(lines: Floats, points: Floats) -> Booleans:
        start, along = lines[:, 0], lines[:, 1] - lines[:, 0]
        one, two = (
            along[:, :1] * (points[:, end, 1] - start[:, 1:]) - along[:, 1:] * (points[:, end, 0] - start[:, :1])
            for end in (0, 1)
        )
        return np.asarray(one * two < 0)

    return apart(segments, others) & apart(others, segments).T
