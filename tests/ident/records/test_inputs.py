"""Campaigns of one robot become one, whatever their order, and of two robots none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_store import a_campaign

from ident.errors import IdentError
from ident.records.campaign import Campaign
from ident.records.inputs import joined
from ident.records.store import write_campaign


def written(path: Path, **declared: object) -> tuple[Path, Campaign]:
    """The file at `path` with a record of its own of a robot of which this much is `declared`, and what is in it."""
    sound = a_campaign()
    record = replace(sound.records[0], tau=sound.records[0].tau + len(path.name))
    campaign = replace(sound, records=(record,), **declared)  # type: ignore[arg-type]
    write_campaign(campaign, path)
    return path, campaign


def test_what_one_file_does_not_know_of_a_drive_another_tells(tmp_path: Path) -> None:
    nothing = {name: np.full(3, np.nan) for name in ("K", "J_m", "D")}
    some, told = written(tmp_path / "some.h5")
    none, _ = written(tmp_path / "untold.h5", **nothing)
    more, _ = written(tmp_path / "more of it.h5", K=told.K * (1 + 1e-12), D_spring=[1.0, np.nan, 2.0])
    for order in ([some, none, more], [none, some, more], [more, none, some]):
        c = joined(order)
        assert len(c.records) == 3
        for name, values in {"K": told.K, "J_m": told.J_m, "D": told.D, "D_spring": [1.0, np.nan, 2.0]}.items():
            np.testing.assert_allclose(getattr(c, name), values, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "ours", "theirs"), [("K", 4500, 4600), ("J_m", 4e-5, 4.001e-5), ("D", 0.0, 1e-6), ("D_spring", 1.0, 0.0)]
)
def test_drives_that_differ_are_refused_by_joint_and_number(
    tmp_path: Path, name: str, ours: float, theirs: float
) -> None:
    untold = np.full(3, np.nan)
    files = [
        written(tmp_path / f"{'a' * (k + 1)}.h5", **{name: values})[0]
        for k, values in enumerate((untold, [np.nan, ours, np.nan], [np.nan, theirs, np.nan]))
    ]
    with pytest.raises(
        IdentError, match=rf"aaa.h5: joint2: {name} = {theirs:g}, in the files before {ours:g}; expected"
    ) as error:
        joined(files)
    assert "\n" not in str(error.value)
