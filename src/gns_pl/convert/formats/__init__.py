"""Other programs' trajectories, read and written: one file per foreign format, all behind one interface.

A reader takes a path and returns a `ForeignSet`: what the source says of itself, and its recordings, opened one at a
time and read in blocks of frames, in the source's own units and axes. `detect.open_set` finds the reader. Nothing here
guesses a unit or writes our own format; `gns_pl.convert` does.

What is read was written by others: no code in it runs, and no size it claims is believed (`limits`, `pickled`).
"""

from gns_pl.convert.formats.detect import open_set
from gns_pl.convert.formats.source import UNCERTAIN_MATERIAL, ForeignSet, Recording, Stated

__all__ = ["UNCERTAIN_MATERIAL", "ForeignSet", "Recording", "Stated", "open_set"]
