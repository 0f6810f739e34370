"""Docstrings as this project writes them, for the API pages.

`[N, D] [m]` is a shape and a unit, not a link to something called "m". In a module's docstring, a name in code is that
of one of its parts.
"""

import re
from typing import Any

import griffe

CODE_OR_PAIR = re.compile(r"`[^`]*`|\](\s?)\[(?!\]|gns_pl\.)")
NAME = re.compile(r"`([a-z_]+)`")


def plain_brackets(text: str) -> str:
    """Return the text with the second of two neighbouring brackets escaped, outside code."""
    return CODE_OR_PAIR.sub(lambda match: match[0] if match[0][0] == "`" else rf"]{match[1]}\[", text)


def with_parts(text: str, module: str) -> str:
    """Return a module's docstring with names in it leading to the module's parts, where they are on a page."""
    return NAME.sub(rf'<autoref identifier="{module}.\1" optional>\g<0></autoref>', text)


class HouseStyle(griffe.Extension):
    """Both, in all docstrings that are read."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of one object."""
        if obj.docstring:
            obj.docstring.value = plain_brackets(obj.docstring.value)
            if obj.is_module:
                obj.docstring.value = with_parts(obj.docstring.value, obj.path)
