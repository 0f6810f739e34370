"""One page about an evaluation, for people: figures, tables and provenance in an HTML file that needs no other."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gns_pl.evaluation.report import NOTE, describe, describe_start, header, scene_rows
from gns_pl.evaluation.speed import speed_sentence
from gns_pl.io import atomic_path
from gns_pl.text import number, percent

TEMPLATE = "report.html"

SHARED = (
    ("runout_height", "Runout and height over time; shaded is the range of the placements"),
    ("laws", "Runout beside published laws"),
    ("energy", "Energy and speed"),
    ("ood", "Distance of each run from the training data; above the dashed line it is out of range (docs/trust.md)"),
)
"""Figures of all scenes together: name of the file, caption."""

OF_SCENE = (
    (
        "evolution_{}.png",
        "Snapshots of the run from MPM's own points, those that the network has; where bodies stand on the floor the "
        "line is the failure surface",
    ),
    ("still_{}.png", "The end in three dimensions"),
    ("{}.gif", "The whole run"),
)
"""Figures of one scene: name of the file, caption."""

COMPARED = (
    ("runout 99 %", "runout_99_error"),
    ("height 99 %", "height_99_error"),
    ("mean height", "mean_height_error"),
    ("deposit profile", "profile_l1"),
)
"""Errors by which checkpoints are compared: label, key."""


def write_page(path: Path, documents: Mapping[str, Mapping[str, Any]], folders: Mapping[str, Path]) -> Path:
    """Write the page and return its path.

    Args:
        path: of the HTML file.
        documents: name of a checkpoint → content of its metrics.json.
        folders: name → where its figures lie; those that are not there are left out.
    """
    from jinja2 import Environment, PackageLoader

    environment = Environment(loader=PackageLoader("gns_pl.evaluation", "."), autoescape=True, trim_blocks=True)
    environment.filters |= {"number": number, "percent": percent}
    models = [_model(name, document, folders[name]) for name, document in documents.items()]
    scenes = list(dict.fromkeys(scene for document in documents.values() for scene in document["scenes"]))
    text = environment.get_template(TEMPLATE).render(
        models=models, scenes=scenes, note=NOTE, compared=COMPARED, documents=documents
    )
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def _model(name: str, document: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return what the page says of one checkpoint."""
    scenes = {
        key: {
            "text": describe(scene).replace("**", ""),
            "header": header(scene),
            "rows": scene_rows(scene),
            "figures": [_figure(folder / pattern.format(key), caption) for pattern, caption in OF_SCENE],
            "verdict": verdict(scene),
            "trust": trust(scene),
        }
        for key, scene in document["scenes"].items()
    }
    return {
        "name": name,
        "scenes": scenes,
        "figures": [_figure(folder / f"{file}.png", caption) for file, caption in SHARED],
        "provenance": provenance(document),
    }


def _figure(path: Path, caption: str) -> dict[str, str] | None:
    if not path.is_file():
        return None
    kind = "gif" if path.suffix == ".gif" else "png"
    return {"source": f"data:image/{kind};base64,{base64.b64encode(path.read_bytes()).decode()}", "caption": caption}


def verdict(scene: Mapping[str, Any]) -> str:
    """Return what matters of a scene: how far the runout is off, beside what the reference leaves open, and times."""
    placed = scene["placements"]
    if scene["failed_at"] is not None:
        return f"The rollout failed after {scene['failed_at']:.3g} s: there is nothing to judge."
    if scene.get("failure"):
        return f"The rollout reached an unphysical state: {scene['failure']} (docs/stability.md)."
    if placed["number"] and placed["failed"] == placed["number"]:
        return f"The rollouts of all {placed['number']} placements failed: there is nothing to judge."
    spread = scene["reference_spread"]
    error = scene["errors"]["learned"]["runout_99_error"]
    if error is None:
        return "The reference does not advance, so there is no relative error of the runout."
    text = f"The final runout of 99 % of the mass is {abs(100 * error):.1f} % {'longer' if error > 0 else 'shorter'}"
    text += " than by MPM" if scene["reference_points"]["all"] else " than by the stored points of MPM"
    known = [value for value in placed["runout_99_error"] if value is not None]
    if known:
        std, largest = placed["std"]["runout_99_error"], max(known, key=abs)
        text += f" in the mean of {len(known)} placements (± {100 * std:.1f} %, at most {100 * largest:+.1f} %)"
    own, truth = spread.get("runout_99"), scene["reference"]["runout_99"]
    if own is not None and truth:
        text += f"; MPM itself changes by {100 * own / abs(truth):.0f} % on other cells"
    if placed["failed"]:
        text += f"; {placed['failed']} of {placed['number']} placements failed"
    return f"{text}. {speed_sentence(scene)}".rstrip()


def trust(scene: Mapping[str, Any]) -> str:
    """Return in words whether the run stayed where the network was trained."""
    ood = scene["ood"]
    if ood is None:
        text = "The checkpoint holds no training distribution."
    elif ood["message"] is None:
        text = f"Within the training distribution (distance {ood['early_score']:.2g} until τc)."
    else:
        text = f"Outside the training distribution: {ood['message']}."
    return text


def provenance(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return where the numbers come from: label, text."""
    checkpoint, run = document["checkpoint"], document["run"]
    origin, model, data = checkpoint["provenance"], checkpoint["model"], checkpoint["data"]
    shape = f"{model['num_message_passing_steps']} message-passing steps, {model['latent_size']} wide"
    shape += (
        f", radius {model['connectivity_radius']:g} m, steps of {model['dt']:.3g} s, spacing {model['spacing']:.3g} m"
    )
    rows = [
        ("description", str(origin.get("description", ""))),
        ("network", shape),
        ("trained for", f"{origin['steps']:,} steps" if "steps" in origin else ""),
        ("data set", str(data.get("name", ""))),
        ("hash of the data", str(origin.get("manifest_sha256", ""))),
        ("commit of the training", str(origin.get("commit", ""))),
        ("start", describe_start(model, next(iter(document["scenes"].values()))["given_frames"])),
        ("this evaluation", f"{run['command']}, {run['date']}"),
        ("machine", str(run["machine"])),
        (
            "versions",
            f"Python {run['python']}, " + ", ".join(f"{key} {value}" for key, value in run["versions"].items()),
        ),
    ]
    return [row for row in rows if row[1]]
