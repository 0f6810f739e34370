"""The picture of the rooms by floors, docs/architecture.svg, from the import contract and the rooms' own sentences.

    python docs/site/architecture.py    # writes it anew

It is as wide as a telephone's screen and shown in its own size, so that its text is never smaller than text.
"""

from __future__ import annotations

import textwrap
from html import escape
from pathlib import Path

from rooms import first_sentence, floors

FILE = Path(__file__).parents[1] / "architecture.svg"
WIDTH, MARGIN, INDENT = 380, 6, 38
"""Of the picture, around a floor, and from the left edge to the text [pixels]."""

NAME, LINE, PAD, GAP = 18, 15, 7, 8
"""Heights of a room's name and of a line of text; space around a room and between floors [pixels]."""

CHARACTERS = 53
"""Of a line: as many as fit in a sans-serif of 11.5 pixels."""

STYLE = """
text { font-family: system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; font-size: 11.5px; fill: #24292f }
.room { font-family: ui-monospace, Menlo, "DejaVu Sans Mono", monospace; font-size: 14px; font-weight: bold }
.floor { font-size: 15px; fill: #57606a }
rect { fill: #f3f6f9; stroke: #8c96a1 }
line { stroke: #8c96a1; stroke-dasharray: 3 3 }
@media (prefers-color-scheme: dark) {
  text { fill: #e6edf3 } .floor { fill: #9aa4ae } rect { fill: #1c232b; stroke: #5b6570 } line { stroke: #5b6570 }
}
"""


def room(name: str, top: float) -> tuple[list[str], float]:
    """Return a room's name and purpose as SVG elements from a height `top` on, and the height where they end."""
    height = top + PAD + NAME
    elements = [f'<text class="room" x="{INDENT}" y="{height - 5}">{name}</text>']
    for line in textwrap.wrap(first_sentence(name).replace("`", ""), CHARACTERS):
        height += LINE
        elements.append(f'<text x="{INDENT}" y="{height - 4}">{escape(line, quote=False)}</text>')
    return elements, height + PAD


def architecture() -> str:
    """Return the picture: a box for each floor, the ground floor last, with rooms that do not see each other."""
    elements: list[str] = []
    top = MARGIN
    for floor, rooms in floors():
        inside, height = [], top
        for number, name in enumerate(rooms):
            if number:
                inside.append(f'<line x1="{INDENT}" y1="{height}" x2="{WIDTH - 2 * MARGIN}" y2="{height}"/>')
            texts, height = room(name, height)
            inside += texts
        size = f'width="{WIDTH - 2 * MARGIN}" height="{height - top}" rx="6"'
        elements += [f'<rect x="{MARGIN}" y="{top}" {size}/>', *inside]
        middle = (top + height) / 2 + 5
        elements.append(f'<text class="floor" x="{MARGIN + 17}" y="{middle:g}" text-anchor="middle">{floor}</text>')
        top = height + GAP
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{top}" viewBox="0 0 {WIDTH} {top}">'
    return "\n".join([head, f"<style>{STYLE}</style>", *elements, "</svg>"]) + "\n"


if __name__ == "__main__":
    FILE.write_text(architecture(), encoding="utf-8")
