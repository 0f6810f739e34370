"""Others' data and weights become ours, and ours theirs.

`facts` works out from a `sample` what a source leaves open (units, axes, gravity, spacing), `recordings` brings its
frames into metres with gravity along the last axis, `sets` writes our data sets, `exports` those of others, `convert`
does it so that a target is there whole or not at all, `inspection` tells what a source is, `weights` and
`weights_export` carry models over, `program` exports a step for other runtimes. Formats are read in
`gns_pl.convert.formats`.
"""

from gns_pl.convert.convert import convert
from gns_pl.convert.inspection import inspect_source

__all__ = ["convert", "inspect_source"]
