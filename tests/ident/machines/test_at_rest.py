"""Signs and gears are told of soft springs, too, though their lowest lines lie near or above the first mode; else nothing is said."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from ident.machines.at_rest import opposed, ratio_at_rest
from ident.machines.guess import guess
from ident.machines.importing import import_files
from ident.machines.mapping import load_map

FS, S, PERIODS = 500.0, 2500, 3
LINES = np.delete(np.arange(3, 200, 2), slice(3, None, 5))
#: Inertia of rotor and link [kg m2], damping of both [N m s/rad]: what a series elastic arm without a gear may have.
J_M, J_L, D, D_SPRING = 0.02, 0.15, 0.02, 0.03
STEP = 2 * np.pi / 65536


def moved(K: float, f: np.ndarray) -> np.ndarray:
    """theta/tau and q/tau [2, L] of the joint with such a spring [N m/rad] at f [Hz]; N = 1."""
    s = 2j * np.pi * f
    spring = K + D_SPRING * s
    rotor, link = J_M * s**2 + D * s + spring, J_L * s**2 + spring
    return np.stack([link, spring]) / (rotor * link - spring**2)


def recorded(K: float) -> dict[str, np.ndarray]:
    """t, tau, theta, link over the periods: a multisine with 0.5 % of noise, angles read in whole steps."""
    rng = np.random.default_rng(1)
    spectra = np.zeros((3, S // 2 + 1), complex)
    spectra[0, LINES] = S / 2 * np.exp(2j * np.pi * rng.random(len(LINES))) / len(LINES)
    spectra[1:, LINES] = spectra[0, LINES] * moved(K, LINES * FS / S)
    tau, theta, link = np.tile(np.fft.irfft(spectra, S), PERIODS)
    tau += 0.005 * tau.std() * rng.standard_normal(len(tau))
    t = np.arange(len(tau)) / FS
    return {"t": t, "tau": tau, "theta": STEP * np.round(theta / STEP), "link": STEP * np.round(link / STEP)}


def notes(tmp_path: Path, K: float, **how: str) -> list[str]:
    """What is noted of the record where the map says so of a signal, or `N`."""
    np.savez(tmp_path / "r.npz", **recorded(K))
    rest = {"torque": 'unit = "Nm"', "motor_angle": 'unit = "rad"', "link_angle": 'unit = "rad"'} | how
    columns = zip(("torque", "motor_angle", "link_angle"), ("tau", "theta", "link"), strict=True)
    rows = [f'{key} = {{name = "{name}", {rest[key]}}}' for key, name in columns]
    (tmp_path / "map.toml").write_text(
        '[campaign]\nhold = "zoh"\n[robot]\njoints = ["j"]\n[joint.j]\nJ_l_kgm2 = 0.1\n'
        + f"N = {how.get('N', '1')}\n"
        + "\n".join(rows)
        + '\n[record]\nposture_rad = [0.3]\ntime = {name = "t", unit = "s"}\n'
    )
    return list(import_files(load_map(tmp_path / "map.toml"), [tmp_path / "r.npz"]).notes)


@pytest.mark.parametrize("K", [5.0, 10.0, 30.0, 3000.0], ids=["f_AR 0.92", "f_AR 1.3", "f_AR 2.25", "f_AR 22.5"])
def test_what_is_right_is_not_doubted_and_what_is_wrong_is_noted(K: float, tmp_path: Path) -> None:
    """Lines begin at 0.6 Hz; those of the first spring at two thirds of its mode, and link and motor are in antiphase above."""
    assert notes(tmp_path, K) == []
    for how, says in (
        ({"torque": 'unit = "Nm", sign = -1'}, "torque and motor angle of j seem of opposite sign"),
        ({"link_angle": 'unit = "rad", sign = -1'}, "motor and link angle of j are of opposite sign"),
        ({"link_angle": 'unit = "deg"'}, "moves 0.01"),
        ({"N": "3"}, "moves 3"),
        ({"link_angle": 'unit = "counts", counts_per_rev = 2'}, "moves 3."),
    ):
        found = notes(tmp_path, K, **how)
        assert len(found) == 1 and says in found[0]


def test_a_gear_is_guessed_by_how_the_joint_would_move_far_below_its_mode(tmp_path: Path) -> None:
    found = recorded(10.0)
    for gear, turned in ((1.0, 1), (1.0, -1), (6.0, 1), (6.0, -1)):
        np.savez(
            tmp_path / "r.npz", **(found | {"theta": gear * turned * found["theta"], "tau": found["tau"] * turned})
        )
        joint = tomllib.loads(guess([tmp_path / "r.npz"]))["joint"]["joint1"]
        assert joint["N"] == pytest.approx(gear, rel=0.01) and "sign" not in joint["motor_angle"]
        assert joint["link_angle"].get("sign", 1) == turned


@pytest.mark.parametrize(("low", "high"), [(0.1, 120), (2.6, 6.2), (2.6, 120), (0.1, 6.2), (0.1, 1.5), (10, 60)])
def test_a_torque_is_of_its_sign_wherever_the_lines_lie(low: float, high: float) -> None:
    """Between anti-resonance and resonance, here 2.25 and 6.6 Hz, a motor moves in phase with its torque."""
    f = np.arange(low, high, 0.1)
    theta, _ = moved(30.0, f)
    late = np.exp(-2j * np.pi * f * 1.5e-3)
    for change in (np.ones(len(f)), late):
        assert not opposed(f, np.ones(len(f), complex), theta * change)
        assert opposed(f, np.ones(len(f), complex), -theta * change)


def test_lines_that_do_not_tell_say_nothing() -> None:
    """Far above the mode: what the link would do at rest is in the noise; and few lines, or a link that is not read."""
    rng, f = np.random.default_rng(0), np.arange(20, 60, 0.5)
    theta, link = moved(5.0, f)
    noise = np.abs(link).max() * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))
    assert ratio_at_rest(f, theta, link + 0.1 * noise) is None
    assert ratio_at_rest(f, theta, 0 * link) is None
    near = np.array([0.5, 0.7, 0.9])
    assert ratio_at_rest(near, *moved(30.0, near)) is None
    assert ratio_at_rest(f[:0], theta[:0], link[:0]) is None


def test_a_coupled_joint_is_told_below_the_modes_of_the_others() -> None:
    """Two links on two springs, the second's motor held: theta/q has a pole where the second one moves with the first one's link held."""
    J, K, f = np.array([[0.5, 0.1], [0.1, 0.06]]), np.diag([40.0, 30.0]), np.arange(0.3, 40, 0.2)
    s = 2j * np.pi * f
    q = np.linalg.solve(s[:, None, None] ** 2 * J + K * (1 + 0.002 * s[:, None, None]), np.array([40.0, 0.0])[:, None])
    ratio = ratio_at_rest(f, 1 + 0.002 * s, q[:, 0, 0])
    assert ratio == pytest.approx(1, abs=0.1)
