"""Tables as spreadsheets, scopes and controllers write them: read where nothing is guessed, else one line says which cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ident.errors import ImportingError
from ident.machines.importing import import_files
from ident.machines.mapping import load_map
from ident.machines.readers import read_variables

T = np.arange(40) / 2500
TAU = np.round(np.sin(np.arange(40.0)), 5)


def table(head: str, row: str, tail: str = "") -> str:
    """Rows of t and tau, as numbers of all countries."""
    rows = [head]
    for t, tau in zip(T.astype(str), TAU.astype(str), strict=True):
        rows.append(row.format(t=t, tau=tau, T=t.replace(".", ","), TAU=tau.replace(".", ",")))
    return "\n".join(rows) + "\n" + tail


READ = {
    "quoted": table('"t","tau"', '"{t}","{tau}"'),
    "quoted decimal commas": table("t,tau", '"{T}","{TAU}"'),
    "a comma at the end": table("t,tau,", "{t},{tau},"),
    "a comma at the end of numbers only": table("t,tau", "{t},{tau},"),
    "words": table("t,mode,tau", "{t},RUN,{tau}"),
    "booleans": table("on;t;tau", "true;{T};{TAU}"),
    "blanks and decimal commas": table("t tau", "{T} {TAU}"),
    "a long head": table("# a line\n" * 300 + "t,tau", "{t},{tau}"),
    "a title, as spreadsheets pad it": table("Axis 1;;\nDate;2024-05-01;\nt;tau;mode", "{T};{TAU};RUN"),
    "a row of numbers above the names": table("1,2\nt,tau", "{t},{tau}"),
    "units beneath the names": table("t,tau\ns,Nm", "{t},{tau}"),
    "a comment in front of the names": table("% t,tau", "{t},{tau}"),
    "a quoted separator": table("t,text,tau", '{t},"a, b",{tau}'),
}


@pytest.mark.parametrize("text", READ.values(), ids=READ.keys())
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_columns_of_numbers_are_read_beside_others(text: str, encoding: str, tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text(text, encoding=encoding)
    found = read_variables(tmp_path / "r.csv")
    assert set(found) == {"t", "tau"}
    np.testing.assert_array_equal(found["t"], T)
    np.testing.assert_array_equal(found["tau"], TAU)


def test_dates_are_seconds_since_the_first(tmp_path: Path) -> None:
    dates = [f"2024-05-01 23:59:{59 + t:09.6f}" for t in T]
    text = "\n".join(["t,tau", *(f"{date},{tau}" for date, tau in zip(dates, TAU, strict=True))])
    (tmp_path / "r.csv").write_text(text)
    np.testing.assert_allclose(read_variables(tmp_path / "r.csv")["t"], T, atol=1e-9)
    (tmp_path / "r.csv").write_text(text.replace("59.000400", "later", 1))
    with pytest.raises(
        ImportingError, match=r"r.csv: line 3: column 't' has '2024-05-01 23:59:later', expected a date"
    ):
        read_variables(tmp_path / "r.csv")


def test_an_older_windows_writes_degrees(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_bytes(table("t,phi [°]", "{t},{tau}").encode("cp1252"))
    assert "phi [°]" in read_variables(tmp_path / "r.csv")


def test_an_empty_cell_is_no_number(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text(table("t,tau", "{t},{tau}").replace(f",{TAU[7]}", ","))
    found = read_variables(tmp_path / "r.csv")["tau"]
    assert np.isnan(found[7]) and np.isfinite(np.delete(found, 7)).all()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (table("t;counts;tau", "{T};-118.670;{TAU}"), "line 2: column 'counts' has '-118.670', line 2 '0,0' under 't': decimal commas and points"),
        (table("t\ttau", "1.200,000\t{TAU}"), "column 't' has '1.200,000'"),
        (table("t,tau", "{t},{tau}", "0.1"), "line 42 has 1 cell, expected 2 as in other rows"),
        (table("t,tau", "{t},{tau}", "0.1,overflow"), "line 42: column 'tau' has 'overflow', expected a number"),
        (table("t,tau", "{t},{tau}", "t,tau\n1,2"), "line 42: column 't' has 't', expected a number"),
    ],
)  # fmt: skip
def test_a_cell_that_is_no_number_is_named(text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(ImportingError) as caught:
        read_variables(tmp_path / "r.csv")
    assert says in str(caught.value) and "\n" not in str(caught.value)


def test_a_column_that_is_left_out_is_named_where_it_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(
        '[campaign]\nhold = "zoh"\n[robot]\njoints = ["a"]\n[joint.a]\nJ_l_kgm2 = 1\ntorque = {name = "tau", unit = "Nm"}\n'
        'motor_angle = {name = "tau", unit = "rad"}\n[record]\nperiod_samples = 20\nposture_rad = [0]\ntime = {name = "t", unit = "s"}\n'
    )
    (tmp_path / "r.csv").write_text(table("t,tau", "01.05.2024 {t},{tau}"))
    with pytest.raises(
        ImportingError, match="time: 't' is text, as '01.05.2024 0.0'; expected seconds, or dates as 2024"
    ):
        import_files(load_map(tmp_path / "map.toml"), [tmp_path / "r.csv"])
