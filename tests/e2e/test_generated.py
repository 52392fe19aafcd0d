"""generated/ is what symgen writes today, byte for byte; `pytest --update` rewrites it."""

from __future__ import annotations

import json
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from symgen.cli import main

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("robot", ["ypp3"])
def test_regenerates_byte_for_byte(robot: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    committed = ROOT / "generated" / robot
    target = committed if request.config.getoption("--update") else tmp_path / robot
    assert main([str(ROOT / "robots" / robot / f"{robot}.urdf"), "-o", str(target)]) == 0
    written = {path.name: path.read_bytes() for path in target.iterdir()}
    assert written.keys() == {path.name for path in committed.iterdir()}
    different = [name for name, content in written.items() if content != (committed / name).read_bytes()]
    assert not different, "run pytest --update and look at the diff"


def test_the_committed_functions_are_the_papers_equations() -> None:
    """(12)-(20) with the factor 2 of alpha_21 in (17) and c_3 in place of c_3^2 in (18), (20)."""
    folder = ROOT / "generated" / "ypp3"
    constants = json.loads((folder / "alpha_cad.json").read_text())
    alpha = dict(zip(constants["names"], constants["value"], strict=True))
    table_one = {"alpha_11": 0.0434, "alpha_12": 0.4544, "alpha_13": 0.0152, "alpha_21": 0.09285, "alpha_22": 0.5072}
    for name, value in {**table_one, "alpha_31": 0.0466}.items():
        assert alpha[name] == pytest.approx(value, abs=1e-9), name
    J, J_diag = (ca.Function.load(str(folder / f"{name}.casadi")) for name in ("J", "J_diag"))
    C_rows = ca.Function.load(str(folder / "C_rows.casadi"))
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (50, 3)):
        c2, c23, c3 = np.cos(q[1]), np.cos(q[1] + q[2]), np.cos(q[2])
        expected = np.zeros((3, 3))
        expected[0, 0] = alpha["alpha_11"] * c23**2 + alpha["alpha_12"] * c2**2 + alpha["alpha_13"]
        expected[0, 0] += 2 * alpha["alpha_21"] * c2 * c23
        expected[1, 1] = 2 * alpha["alpha_21"] * c3 + alpha["alpha_22"]
        expected[2, 2] = alpha["alpha_31"]
        expected[1, 2] = expected[2, 1] = alpha["alpha_21"] * c3 + alpha["alpha_31"]
        value = np.array(constants["value"])
        np.testing.assert_allclose(np.array(J(q, value)), expected, rtol=0, atol=1e-14)
        np.testing.assert_allclose(np.array(J_diag(q, value)).ravel(), np.diag(expected), rtol=0, atol=1e-14)
        np.testing.assert_allclose(np.array(C_rows(q)) @ value, np.diag(expected), rtol=0, atol=1e-14)
