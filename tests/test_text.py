"""Commands that are printed can be typed."""

import shlex

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from gns_pl.text import override

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
