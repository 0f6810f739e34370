"""What a simulator does with the trajectories of its data that were held out for tests: a table, a row for each.

OMP_NUM_THREADS=1 python examples/held_out.py friction_plane docs/friction_plane.csv
"""

from __future__ import annotations

import csv
import math
import sys
from pathlib import Path

import numpy as np

from gns_pl.generation import find_dataset
from gns_pl.io import read_manifest, read_trajectory
from gns_pl.metrics.summary import rollout_errors
from gns_pl.models.checkpoint import load_checkpoint
from gns_pl.rollout import rollout

ERRORS = ("position_error", "runout_99_error", "runout_99_difference", "mean_height_error")


def main(name: str, table: Path) -> None:
    """Roll out every test trajectory of the data of a checkpoint; what is missing of the data is made."""
    checkpoint, rows = load_checkpoint(name), []
    folder = find_dataset(checkpoint.data)
    for file in read_manifest(folder).splits["test"]:
        truth = read_trajectory(folder / file)
        errors = rollout_errors(rollout(checkpoint.simulator, truth, truth.num_frames - 1), truth)
        angle = math.degrees(math.atan(float(truth.material[0, 0])))
        row = {"scene": truth.scene.name, "friction_angle_deg": f"{angle:.1f}"}
        rows.append(row | {each: f"{errors[each]:.4f}" for each in (*ERRORS, "speed_mean")})
    with table.open("w", newline="", encoding="utf-8") as out:
        writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    for each in ERRORS:
        values = np.array([float(row[each]) for row in rows])
        print(f"{each}: mean {np.nanmean(values):.3f}, mean absolute {np.nanmean(np.abs(values)):.3f}")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
