"""What solvers err by on terrains, and what the errors on some say of another: tables of docs/terrain.md.

    only="threads=1 placements=3 choice.cells=[5.09,7.64,10.2] choice.learned=[ground] choice.hybrid=null
        choice.fitted=[] variants.cells=[] variants.points.cells=[] variants.courant.cells=[] batches.sizes=[]
        ratios.turns=0 logger.enabled=false records=src/gns_pl/solvers/records.csv"
    python benchmark.py evaluation=terrain $only out=runs/charts/terrain
    python benchmark.py evaluation=terrain $only evaluation.scenes=[hillside] frame_interval=0.25 \
        reference.terrain.cells_per_metre=[0.21,0.147] out=runs/charts/hillside
    python benchmarks/terrain_records.py --sand runs            # scene files: five terrains, sand of learned ones
    python benchmark.py evaluation=terrain $only choice.cells=[5.09,7.64] out=runs/charts/sand \
        evaluation.scenes=[runs/runout.yaml,runs/gully.yaml,runs/bowl.yaml,runs/mound.yaml,runs/sheet.yaml]
    python benchmarks/terrain_records.py     # writes the tables, of the package's records; nothing is run

A terrain is judged by others, so the last table leaves every terrain out in turn, with either sand: the cheapest solver
that met a tolerance on all other terrains is taken for it, and the promise is held if its error on this one is within
it, too.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

from gns_pl.scene import read_scene, write_scene
from gns_pl.solvers.selection import RECORDS, WORSE, Record, largest_errors, read_records

PAGE = Path(__file__).parents[1] / "docs" / "terrain.md"
SAND = "_sand"
"""What the name of a terrain with the sand of learned simulators ends with."""

TERRAINS = ("runout", "gully", "bowl", "mound", "sheet")
"""Those that are of the size of their data."""

TOLERANCES = (0.4, 0.3, 0.2, 0.15, 0.1)


def records_on_terrain() -> list[Record]:
    """Return the package's records of scenes on a terrain, on one thread."""
    return [each for each in read_records(RECORDS) if each.kind == "terrain" and each.threads == 1]


def left_out(records: Sequence[Record], scene: str, tolerance: float) -> Record | None:
    """Return the record on a scene of what is taken by those on all others; None if none meets the tolerance there."""
    options = []
    for record in (each for each in records if each.scene == scene):
        terrain = scene.removesuffix(SAND)
        others = [each for each in records if each.solver == record.solver and each.scene.removesuffix(SAND) != terrain]
        if others and largest_errors(others)[WORSE] <= tolerance:
            options.append(record)
    return min(options, key=lambda each: each.seconds, default=None)


def write_sand(folder: Path) -> None:
    """Write scene files of the terrains with the sand that learned simulators are trained on."""
    folder.mkdir(parents=True, exist_ok=True)
    sand = read_scene("barrier").materials
    for name in TERRAINS:
        write_scene(read_scene(name).replace(name=name + SAND, materials=sand), folder / f"{name}.yaml")


def errors_table(records: Sequence[Record]) -> str:
    """Return front and map of every solver on every terrain, and its time, as Markdown."""
    scenes = list(dict.fromkeys(each.scene for each in records))
    lines = [f"| solver | {' | '.join(f'`{scene}`' for scene in scenes)} |", "|---" * (len(scenes) + 1) + "|"]
    found = {(each.solver, each.scene): each for each in records}
    for solver in dict.fromkeys(each.solver for each in sorted(records, key=lambda each: each.seconds)):
        cells = []
        for scene in scenes:
            record = found.get((solver, scene))
            cells.append(
                "–" if record is None
                else f"{round(100 * record.runout_error):+d} %, {100 * record.map_error:.0f} %, {record.seconds:.2g} s"
            )  # fmt: skip
        lines.append(f"| `{solver}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def promise_table(records: Sequence[Record]) -> str:
    """Return what was taken for every terrain by the others, and what it erred by there, as Markdown."""
    scenes = list(dict.fromkeys(each.scene for each in records))
    lines = [
        f"| terrain | {' | '.join(f'{100 * tolerance:g} %' for tolerance in TOLERANCES)} |",
        "|---" * (len(TOLERANCES) + 1) + "|",
    ]
    held = broken = 0
    for scene in scenes:
        cells = []
        for tolerance in TOLERANCES:
            taken = left_out(records, scene, tolerance)
            if taken is None:
                cells.append("refused")
                continue
            error = largest_errors([taken])[WORSE]
            held, broken = held + (error <= tolerance), broken + (error > tolerance)
            mark = "" if error <= tolerance else "**broken** "
            cells.append(f"{mark}`{taken.solver}` {100 * error:.0f} %")
        lines.append(f"| `{scene}` | {' | '.join(cells)} |")
    said = (
        f"With every terrain left out in turn, the errors on the others held on it in {held} of {held + broken} cases."
    )
    return "\n".join([said, "", *lines])


def main() -> None:
    """Write the tables, or scene files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sand", type=Path, metavar="FOLDER", help="write scene files there, and nothing else")
    folder = parser.parse_args().sand
    if folder is not None:
        write_sand(folder)
        return
    records, text = records_on_terrain(), PAGE.read_text(encoding="utf-8")
    tables = {
        "terrain_records": errors_table([each for each in records if not each.scene.endswith(SAND)]),
        "terrain_sand": errors_table([each for each in records if each.scene.endswith(SAND)]),
        "terrain_promise": promise_table(records),
    }
    for name, table in tables.items():
        marked = re.compile(rf"(<!-- {name} -->\n).*?(\n<!-- /{name} -->)", re.DOTALL)
        if not marked.search(text):
            raise SystemExit(f"{PAGE}: has no <!-- {name} --> to fill.")
        text = marked.sub(lambda match, table=table: match[1] + table + match[2], text)  # type: ignore[misc]
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
