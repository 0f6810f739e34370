"""Learning curves and figures of sweeps: they can be drawn of whatever there is, and show it."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gns_pl.viz import SweepPoint, plot_learning_curve, plot_sweep


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def has(image: np.ndarray, colour: str) -> bool:
    return bool((image == [int(colour[i : i + 2], 16) for i in (1, 3, 5)]).all(axis=2).any())


def curve(number: int, hours: bool = True) -> dict[str, np.ndarray]:
    step = np.arange(1, number + 1) * 50.0
    return {
        "step": step,
        "hours": step / 500 if hours else np.full(number, np.nan),
        "loss": 1 / step,
        "position_error": 5 / step,
        "runout_99_error": -20 / step,
        "mean_height_error": 10 / step,
    }


def test_a_learning_curve_shows_errors_over_steps_and_hours(tmp_path: Path) -> None:
    plot_learning_curve(curve(300), curve(6), tmp_path / "a.png", title="sand")
    image = pixels(tmp_path / "a.png")
    half = image.shape[1] // 2
    for colour in ("#D55E00", "#0072B2", "#009E73"):
        assert has(image[:, :half], colour) and has(image[:, half:], colour)


def test_a_learning_curve_without_times_has_one_column(tmp_path: Path) -> None:
    plot_learning_curve(curve(5, hours=False), curve(2, hours=False), tmp_path / "a.png", title="sand")
    plot_learning_curve(curve(5), curve(2), tmp_path / "b.png", title="sand")
    assert pixels(tmp_path / "b.png").shape[1] == 2 * pixels(tmp_path / "a.png").shape[1]


@pytest.mark.parametrize("errors", [[], [np.nan, np.nan], [np.nan, 2.0]])
def test_a_learning_curve_of_little_or_nothing(tmp_path: Path, errors: list[float]) -> None:
    validation = {
        "step": np.arange(len(errors)) + 1.0,
        "hours": np.full(len(errors), 0.1),
        "position_error": np.array(errors),
    }
    plot_learning_curve(curve(1), validation, tmp_path / "a.png", title="sand")
    assert has(pixels(tmp_path / "a.png"), "#D55E00") == bool(np.isfinite(errors).any())


PANELS = {"error": "error", "time": "time [ms]", "other": "never measured"}


def test_a_sweep_has_a_line_per_value_of_the_second_parameter(tmp_path: Path) -> None:
    points = [SweepPoint(x, f"size = {size}", {"error": size / x, "time": x}) for x in (1e-4, 1e-2) for size in (8, 16)]
    points += [SweepPoint(1e-2, "size = 16", {"error": 900.0})]  # another seed
    paths = [tmp_path / "a.png", tmp_path / "a.pdf"]
    plot_sweep(points, PANELS, "noise", paths)
    image = pixels(paths[0])
    assert has(image, "#0072B2") and has(image, "#D55E00") and not has(image, "#009E73")
    assert paths[1].read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("x", [3.0, "small", "all seeds"])
def test_a_sweep_of_one_value(tmp_path: Path, x: float | str) -> None:
    points = [SweepPoint(x, "", {"error": value, "time": np.nan}) for value in (1.0, -2.0, 4.0)]
    plot_sweep(points, PANELS, "", [tmp_path / "a.png"])
    assert has(pixels(tmp_path / "a.png"), "#0072B2")
