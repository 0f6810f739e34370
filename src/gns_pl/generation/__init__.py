"""From a specification to a folder of trajectories made by the material point method, and single references on demand.

`spec` reads the specification and draws the scenes, `solver` runs one of them, `produce` makes one file, `pool` runs
many at once, `dataset` does all of it safely and `reference` keeps single runs. No learning happens here, and the
solver is imported only when there is something to simulate.
"""

from gns_pl.generation.dataset import generate_dataset
from gns_pl.generation.reference import reference_trajectory
from gns_pl.generation.spec import DatasetSpec, Planned, draw_plan

__all__ = ["DatasetSpec", "Planned", "draw_plan", "generate_dataset", "reference_trajectory"]
