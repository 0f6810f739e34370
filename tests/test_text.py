"""Commands that are printed can be typed."""

import math
import shlex

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from gns_pl.text import command, did_you_mean, file_label, number, override, percent, seconds, use_program, without_nan
from gns_pl.training.resume import go_on
from gns_pl.training.summary import summary_lines

NAMES = [
    *("runs/a/last.ckpt", "a=b", "a b", "ä/é", "x[1]", "a,b", "{x}", "a\\b", "a\\", "a\\\\", 'a"b', 'a\\"b', "a'b"),
    *("${x}", "a\\${x}", "$x", "a${b", "~/x", "a:b", "a#b", "(a)", "\t", "*", " a ", "a;b", "日本", "a!b", "a&b|c"),
    *("", "null", "true", "1", "1e-3", "1_000", "nan", "interval(1,2)", "{a:1}", "[a,b]"),
]


@pytest.mark.parametrize("name", NAMES)
def test_a_printed_override_is_read_back_by_shell_and_hydra(name):
    (word,) = shlex.split(override("key", name))
    config = OmegaConf.create({"x": "interpolated", "key": None})
    OmegaConf.update(config, "key", OverridesParser.create().parse_override(word).value())
    assert config.key == name


def test_a_plain_name_is_printed_as_it_stands():
    assert override("ckpt", "runs/quickstart/last.ckpt") == "ckpt=runs/quickstart/last.ckpt"


@pytest.mark.parametrize("name", ["a b=c", "é[1],{x}", 'it\'s "so"', "${x}"])
def test_every_command_that_is_printed_can_be_typed(name, tmp_path):
    """Resume, judge: for every folder, the shell and Hydra read the folder back."""
    folder = tmp_path / name
    summary = {"name": "n", "status": "s", "wall_seconds": None, "num_starts": 1, "steps": 1, "num_steps": 1}
    summary |= {"data": {"name": "d", "num_windows": 1, "num_train": 1, "num_valid": 1}, "num_parameters": 1}
    summary |= {"num_threads": 1, "device": "cpu", "best": None, "final": None, "checkpoint": str(folder / "last.ckpt")}
    summary |= dict.fromkeys(("step_seconds", "windows_per_s", "rollout_step_seconds"))
    printed = [*go_on_words(folder), *shlex.split(summary_lines(summary)[-1].split("evaluate.py ")[1])]
    values = [OverridesParser.create().parse_override(word).value() for word in printed]
    read = OmegaConf.to_container(OmegaConf.create(values), resolve=True)
    assert read == [str(folder / "last.ckpt"), str(folder), str(folder / "last.ckpt")]


def go_on_words(folder):
    return shlex.split(go_on(folder))


def test_labels_of_files():
    assert file_label("a_[1, 2]", "b_x/y") == "a_1_2_b_x_y" and file_label() == ""
    long = [file_label(f"a_{'x' * 300}{last}") for last in "yz"]
    assert len(set(long)) == 2 and max(map(len, long)) < 120


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (0, "0"), (1.23456, "1.23"), (-0.012345, "-0.0123"), (1.2e-7, "1.20e-07"), (5678.9, "5679")],
)
def test_numbers_have_three_digits(value, text) -> None:
    assert number(value) == text


def test_relative_errors_have_a_sign() -> None:
    assert percent(0.1234) == "+12.3 %"
    assert percent(-0.5) == "-50.0 %"
    assert percent(None) == ""


def test_what_is_not_finite_becomes_null() -> None:
    assert without_nan({"a": [1.0, math.nan], "b": {"c": math.inf, "d": "NaN"}, "e": 3}) == {
        "a": [1.0, None],
        "b": {"c": None, "d": "NaN"},
        "e": 3,
    }


@pytest.mark.parametrize(
    ("value", "text"),
    [
        *((math.nan, "unknown"), (math.inf, "never"), (3.21e-6, "3.2 µs"), (0.00456, "4.6 ms"), (0.0123, "0.0123 s")),
        *((59.94, "59.9 s"), (599, "599 s"), (600, "10 min"), (7384, "123 min")),
    ],
)
def test_times_have_a_unit(value: float, text: str) -> None:
    assert seconds(value) == text


def test_a_percentage_has_its_scatter() -> None:
    assert percent(-0.087, 0.029) == "-8.7 ± 2.9 %"
    assert percent(0.0) == "+0.0 %"


def test_commands_are_typed_as_this_program_was_started() -> None:
    assert command("train") == "python train.py"
    use_program("gns-pl {}")
    try:
        assert command("train") == "gns-pl train"
    finally:
        use_program("python {}.py")


@pytest.mark.parametrize(
    ("typed", "meant"), [("sed", "seed"), ("ckp", "ckpt"), ("noise_sd", "noise_std"), ("zzz", None), ("", None)]
)
def test_a_name_that_may_have_been_meant(typed: str, meant: str | None) -> None:
    suggestion = did_you_mean(typed, ["seed", "ckpt", "noise_std", "out"])
    assert (meant in suggestion) if meant else (suggestion == "")
