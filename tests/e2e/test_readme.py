"""What README shows is what the commands print."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import ident.cli
from ident.machines.mapping import load_map
from symgen import cli

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(tag: str) -> list[str]:
    return README.split(f"<!-- {tag} -->")[1].split("```")[1].strip("\n").splitlines()


def test_the_symgen_example_is_what_symgen_prints(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([str(ROOT / "robots/ypp3/ypp3.urdf")]) == 0
    printed = capsys.readouterr().out.splitlines()
    shown = block("symgen")
    assert len(printed) == len(shown)
    for ours, theirs in zip(shown, printed, strict=True):
        if ours.startswith("J(q) equals Pinocchio"):  # rounding noise differs between processors
            ours, theirs = (re.sub("[0-9.]+e-1[0-9]", "..", line) for line in (ours, theirs))
        assert ours == theirs


def test_every_file_that_readme_points_to_exists() -> None:
    targets = [part.split(")")[0] for part in README.split("](")[1:]]
    assert targets and all((ROOT / target).exists() for target in targets if "://" not in target)


def test_the_equations_are_the_generated_ones() -> None:
    generated = (ROOT / "generated/ypp3/equations.md").read_text(encoding="utf-8")
    for line in (
        r"2 \alpha_{21} c_3 + \alpha_{22}",
        r"\alpha_{11} c_{23}^2 + \alpha_{12} c_2^2 + 2 \alpha_{21} c_2 c_{23} + \alpha_{13}",
        r"\alpha_{21} c_3 + \alpha_{31}",
    ):
        assert line in README and line in generated


def test_the_ident_example_has_the_shape_of_what_ident_prints() -> None:
    """The numbers are a simulation's; that they are right is test_ident's to say."""
    shown = block("ident")
    assert shown[0].split() == [
        "record",
        "entry",
        "posture",
        "[rad,",
        "m]",
        "measured",
        "sigma",
        "CAD",
        "error",
        "%",
        "chi2/dof",
    ]
    assert [line.split()[0] for line in shown if line.startswith("alpha_")] == [
        "alpha_31", "alpha_21", "alpha_22", "alpha_11", "alpha_12", "alpha_13",
    ]  # fmt: skip
    assert [line.split(":")[0] for line in shown[-3:]] == ["Report", "Plot", "Robot"]


def test_the_methods_side_by_side_are_all_there() -> None:
    shown = block("methods")
    assert shown[0].split() == [
        "record",
        "entry",
        "coupled",
        "sigma",
        "modal",
        "%",
        "two-mass",
        "%",
        "three-point",
        "%",
    ]
    assert [line.split()[0] for line in shown[-4:]] == ["chi2/dof", "explained", "J(q)", "seconds"]


def test_the_doctor_finds_what_readme_says(capsys: pytest.CaptureFixture[str]) -> None:
    """The highest line is a random odd one: 119.9 Hz or one below."""
    assert ident.cli.main(["doctor", str(ROOT / "robots/scara4")]) == 0
    shown = [re.sub("line at [0-9.]+", "line", line) for line in block("doctor")]
    printed = [re.sub("line at [0-9.]+", "line", line) for line in capsys.readouterr().out.splitlines()]
    assert shown and set(shown) <= set(printed)


def test_the_map_is_one(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text("\n".join(block("map")))
    found = load_map(tmp_path / "map.toml")
    assert found.hold == "band-limited" and [joint.name for joint in found.joints] == ["motor"]
    assert found.joints[0].signals["torque"].current and found.record.reference is not None
