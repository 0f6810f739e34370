"""The tables of fitted solvers in docs and on cards, from what `python fit.py` left in runs/NAME.

    python benchmarks/fitted_tables.py docs/retuned.md runs/mpm-retuned-5 runs/mpm-retuned-7.6
    python benchmarks/fitted_tables.py docs/shallow.md runs/shallow-fitted
    python benchmarks/fitted_tables.py src/gns_pl/pretrained/shallow-fitted.md runs/shallow-fitted

Tables go between marks, of those that the file has: `<!-- factors -->`, `<!-- held -->` (errors on held-out scenes) and
`<!-- fitted -->` (on those that were fitted to).
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

import yaml

from gns_pl.inverse.fit_errors import Row, rms_cells
from gns_pl.io.tables import read_table
from gns_pl.solvers.fitted_files import read_fitted


def factors(folders: Sequence[Path]) -> str:
    """Return the factors of solvers of one kind, a row each."""
    rows = []
    for folder in folders:
        path = folder / f"{folder.name}.yaml"
        solver, runs = read_fitted(path), yaml.safe_load(path.read_text(encoding="utf-8"))["fitted"]["runs"]
        values = [f"× {value:.3f}" for value in vars(solver.factors).values()]
        rows.append(f"| `{solver.name}` | √(L0 H0)/{solver.cells:g} | {' | '.join(values)} | {runs} |")
    names = [f"`{name}`" for name in vars(solver.factors)]
    return "\n".join(
        [f"| solver | cells | {' | '.join(names)} | runs of the fit |", "|---" * (len(names) + 3) + "|", *rows]
    )


def errors(folders: Sequence[Path], held_out: bool) -> str:
    """Return the errors of solvers, side by side, a row a scene."""
    tables = [read_table(folder / f"{folder.name}.csv", Row, "is no table of fit.py") for folder in folders]
    tables = [[row for row in rows if row.held_out == held_out] for rows in tables]
    several = len(folders) > 1
    heads = [f"{f'`{folder.name}` ' if several else ''}front | mean height | map" for folder in folders]
    lines = [f"| scene | {' | '.join(heads)} |", "|---" * (1 + 3 * len(folders)) + "|"]
    for of_scene in zip(*tables, strict=True):
        lines.append(f"| {of_scene[0].scene} | {' | '.join(row.cells for row in of_scene)} |")
    return "\n".join([*lines, f"| **rms** | {' | '.join(rms_cells(rows) for rows in tables)} |"])


def main() -> None:
    """Write the tables into a file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", type=Path)
    parser.add_argument("folders", type=Path, nargs="+", help="of solvers of one kind, as fit.py made them")
    arguments = parser.parse_args()
    tables = {
        "factors": factors(arguments.folders),
        "held": errors(arguments.folders, held_out=True),
        "fitted": errors(arguments.folders, held_out=False),
    }
    text = arguments.page.read_text(encoding="utf-8")
    for mark, table in tables.items():
        between = re.compile(f"(<!-- {mark} -->\n).*?(<!-- /{mark} -->)", re.DOTALL)
        text = between.sub(lambda found, table=table: f"{found[1]}{table}\n{found[2]}", text)
    arguments.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
