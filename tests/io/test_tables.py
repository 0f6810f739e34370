"""A table comes back as it was written, typed."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from gns_pl.errors import InputError
from gns_pl.io.tables import read_table, render_table, write_table


@dataclass(frozen=True)
class Row:
    name: str
    count: int
    share: float
    inside: bool


HEAD = "name,count,share,inside"
ROWS = [Row("a, b", 3, 0.1 + 0.2, True), Row('"quoted" ü', -1, float("inf"), False)]


def test_round_trip(tmp_path: Path) -> None:
    write_table(tmp_path / "t.csv", Row, ROWS)
    assert read_table(tmp_path / "t.csv", Row, "is no table of rows") == ROWS


def test_a_column_with_a_default_may_be_missing_in_older_tables(tmp_path: Path) -> None:
    @dataclass(frozen=True)
    class Newer(Row):
        note: str = "none"

    write_table(tmp_path / "old.csv", Row, ROWS)
    assert [each.note for each in read_table(tmp_path / "old.csv", Newer, "is no table")] == ["none", "none"]
    write_table(tmp_path / "new.csv", Newer, [Newer("a", 1, 0.5, True, "b")])
    assert read_table(tmp_path / "new.csv", Newer, "is no table")[0].note == "b"


def test_columns_beyond_the_fields_are_left_out_and_digits_are_cut(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("more,name,count,share,inside\nx,a,1,0.5,True\n")
    assert read_table(tmp_path / "t.csv", Row, "is no table") == [Row("a", 1, 0.5, True)]
    assert render_table(Row, ROWS[:1], digits=3).splitlines()[1] == '"a, b",3,0.3,True'


@pytest.mark.parametrize("lines", [["name,count", "a,1"], [HEAD, "a,one,0.5,True"], [HEAD, "a"]])
def test_another_table_is_refused(lines: list[str], tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"t\.csv: is no table of rows; move it away"):
        read_table(tmp_path / "t.csv", Row, "is no table of rows; move it away")
    with pytest.raises(InputError, match=r"none\.csv: is no table"):
        read_table(tmp_path / "none.csv", Row, "is no table")
