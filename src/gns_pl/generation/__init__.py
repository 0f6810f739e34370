"""From a specification to a folder of trajectories made by the material point method, and single references on demand.

`spec` reads the specification, `families` draws the scenes, `thinning` keeps one of k^D points of a fine one, `produce`
makes the files of one, `pool` runs many at once on the CPU and `batches` on a GPU, `dataset` does all of it safely,
`stored` finds what is there already, and `reference` keeps single runs. No learning happens here, and the solver is
imported only when there is something to simulate.
"""

from gns_pl.generation.dataset import generate_dataset, missing_bytes
from gns_pl.generation.families import Planned, draw_plan
from gns_pl.generation.reference import reference_trajectory
from gns_pl.generation.spec import DatasetSpec, chosen_every
from gns_pl.generation.stored import find_dataset, is_dataset, is_imported, resolved_data
from gns_pl.generation.thinning import thin_trajectory

__all__ = [
    "DatasetSpec",
    "Planned",
    "chosen_every",
    "draw_plan",
    "find_dataset",
    "generate_dataset",
    "is_dataset",
    "is_imported",
    "missing_bytes",
    "reference_trajectory",
    "resolved_data",
    "thin_trajectory",
]
