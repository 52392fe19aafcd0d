"""Links with identified constants: judged by pinocchio's pseudo-inertia, by moving them, and by closed forms."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.linalg import null_space

from ident.errors import IdentError
from ident.identification.links import Links, nearest_links
from ident.identification.physical import consistency
from symgen.chain import Inertia
from symgen.plan import Model, make_model
from symgen.urdf import load_chain

sys.path.append(str(Path(__file__).parents[2] / "symgen"))

from arms import arm

ROBOTS = Path(__file__).parents[3] / "robots"
#: Rounding of sums of a few hundred numbers, relative to the largest.
ROUNDING = 1e-12


@cache
def model_of(name: str, believe_zeros: bool = False) -> Model:
    own = ROBOTS / name / f"{name}.urdf"
    return make_model(load_chain(own) if own.exists() else arm(name), believe_zeros=believe_zeros)


ARMS = [("ypp3", True), ("ypp3_general", False), ("arm6", False), ("arm6", True), ("scara4", True), ("ur5", False),
        ("ur5", True), ("panda", False), ("xarm7", False)]  # fmt: skip


def pseudo(parameters: np.ndarray) -> np.ndarray:
    return np.array([pin.PseudoInertia.FromDynamicParameters(row).toMatrix() for row in parameters.reshape(-1, 10)])


def possible_alpha(model: Model, rng: np.random.Generator) -> np.ndarray:
    """Constants of other possible links: every link's mass off by 25 %, its pseudo-inertia stretched by 10 %."""
    n = model.chain.n
    bodies = []
    for P in pseudo(model.chain.parameters):
        stretch = np.diag([*np.exp(0.1 * rng.normal(size=3)), np.exp(0.12 * rng.normal())])
        bodies.append(pin.PseudoInertia.FromMatrix(stretch @ P @ stretch).toDynamicParameters())
    return model.factoring.W @ (np.concatenate(bodies) * model.factoring.free).reshape(10 * n)


def relative(model: Model, share: float) -> np.ndarray:
    """The covariance of constants known to that share of themselves."""
    cad = model.alpha_cad
    return np.diag((share * np.abs(cad) + 1e-6 * np.abs(cad).max()) ** 2)


def error(model: Model, found: Links, alpha: np.ndarray) -> float:
    """Largest error of J(q) of the links against J(q; alpha) at random postures, relative to the largest entry."""
    joints = tuple(
        replace(joint, inertia=Inertia(body.mass, body.lever, body.inertia))
        for joint, body in zip(
            model.chain.joints, map(pin.Inertia.FromDynamicParameters, found.parameters), strict=True
        )
    )
    q = model.random_postures(50, np.random.default_rng(1))
    J = model.J(q, alpha)
    return float(np.abs(replace(model, chain=replace(model.chain, joints=joints)).J_cad(q) - J).max() / np.abs(J).max())


@pytest.mark.parametrize(("name", "believe"), ARMS)
def test_cads_own_constants_give_cads_links(name: str, believe: bool) -> None:
    model = model_of(name, believe)
    found = nearest_links(model, model.alpha_cad, relative(model, 0.01))
    assert found.exact and found.ok and found.distance == 0.0 and found.status == ()
    cad = model.chain.parameters
    # Panda's file has links thinner than bodies are taken to be: those are filled up, and nothing else moves
    assert np.abs(found.parameters.ravel() - cad).max() < (1e-4 if name == "panda" else ROUNDING) * np.abs(cad).max()
    assert np.all(found.parameters.ravel()[cad == 0.0] == 0.0) or name == "panda"
    assert found.divergence.max() < 1e-6


@pytest.mark.parametrize(("name", "believe"), ARMS)
def test_constants_of_possible_links_are_reproduced_and_the_links_are_possible(name: str, believe: bool) -> None:
    model = model_of(name, believe)
    rng = np.random.default_rng(3)
    for _ in range(4):
        alpha = possible_alpha(model, rng)
        found = nearest_links(model, alpha, relative(model, 0.01))
        assert found.exact and found.ok and found.status == ()
        assert np.array_equal(found.alpha, alpha)
        assert np.linalg.eigvalsh(pseudo(found.parameters)).min() > 0.0
        assert error(model, found, alpha) < ROUNDING


@pytest.mark.parametrize("name", ["ypp3_general", "arm6", "ur5"])
def test_no_links_with_these_constants_are_nearer_to_cad(name: str) -> None:
    """The divergence, written out anew, rises along every direction that the constants leave open."""
    model = model_of(name)
    cad = pseudo(model.chain.parameters)

    def divergence(parameters: np.ndarray) -> float:
        X = np.linalg.solve(cad, pseudo(parameters))
        return float(sum(np.trace(one) - np.linalg.slogdet(one)[1] - 4.0 for one in X))

    rng = np.random.default_rng(5)
    found = nearest_links(model, possible_alpha(model, rng))
    phi = found.parameters.ravel()
    least = divergence(phi)
    assert least == pytest.approx(found.divergence.sum(), rel=1e-6)
    scale = np.abs(phi) + 1e-3 * np.abs(phi).max()
    for direction in (null_space(model.factoring.W * scale) @ rng.normal(size=(phi.size - len(model.names), 20))).T:
        step = 1e-3 * scale * direction / np.linalg.norm(direction)
        there, back = divergence(phi + step), divergence(phi - step)
        assert there > least and back > least
        # at the minimum the two rises differ by the third order of the step only
        assert abs(there - back) < 0.1 * (there + back - 2 * least) + 1e-12


def test_the_nearest_possible_constants_of_the_papers_arm() -> None:
    """One violated condition g alpha <= 0, alpha_11 <= alpha_31: the distance to it is g alpha / sqrt(g V g)."""
    model = model_of("ypp3", True)
    at = {name: k for k, name in enumerate(model.names)}
    value = {
        "alpha_11": 0.0723,
        "alpha_12": 0.5477,
        "alpha_13": 0.0223,
        "alpha_21": 0.1479,
        "alpha_22": 0.6242,
        "alpha_31": 0.07,
    }
    alpha, g = np.zeros(6), np.zeros(6)
    for name, number in value.items():
        alpha[at[name]] = number
    g[at["alpha_11"]], g[at["alpha_31"]] = 1.0, -1.0
    root = np.random.default_rng(2).normal(size=(6, 6)) * 0.003
    V = root @ root.T + np.diag(np.full(6, 1e-5))
    found = nearest_links(model, alpha, V)
    assert not found.exact and not found.ok and found.status == ()
    assert found.distance == pytest.approx(0.0023 / np.sqrt(g @ V @ g), rel=1e-3)
    assert found.alpha == pytest.approx(alpha - V @ g * 0.0023 / (g @ V @ g), abs=1e-5)
    assert np.linalg.eigvalsh(pseudo(found.parameters)).min() > 0.0
    assert error(model, found, found.alpha) < ROUNDING


@pytest.mark.parametrize(("name", "believe"), [("arm6", False), ("ur5", True), ("panda", False)])
def test_the_distance_is_that_of_the_closed_cone(name: str, believe: bool) -> None:
    """`consistency` allows bodies as thin as a disc and does not know CAD; it must not be nearer by more than rounding."""
    model, rng, seen = model_of(name, believe), np.random.default_rng(7), 0
    V = relative(model, 0.05)
    for _ in range(4):
        alpha = model.alpha_cad + np.sqrt(np.diag(V)) * rng.normal(size=len(V))
        found = nearest_links(model, alpha, V)
        closed = consistency(alpha, V, model.wider.W if not believe else model.factoring.W,
                             np.ones(10 * model.chain.n, bool) if not believe else model.factoring.free)  # fmt: skip
        if not found.exact:
            seen += 1
            # links need not have the zeros that were believed: more are possible, none further away
            assert found.distance <= closed.distance * (1 + 1e-3) + 1e-3
            if not believe:
                assert found.distance == pytest.approx(closed.distance, rel=1e-3, abs=1e-3)
        assert error(model, found, found.alpha) < ROUNDING
    assert seen


def test_what_was_not_measured_gives_way_first() -> None:
    model = model_of("arm6")
    rng, d, D = np.random.default_rng(1), model.d, len(model.names)
    assert d < D
    unseen = np.eye(D)[:, d:]
    alpha = possible_alpha(model, rng)
    alpha[d:] = 50.0 * np.abs(alpha).max()
    V = relative(model, 0.01)
    V[d:, d:] = 0.0
    found = nearest_links(model, alpha, V, unseen)
    assert found.ok and not found.exact and found.distance < 1e-3
    assert found.alpha[:d] == pytest.approx(alpha[:d], rel=1e-6)
    assert error(model, found, found.alpha) < ROUNDING
    assert not nearest_links(model, alpha, relative(model, 0.01)).ok
    nothing = nearest_links(model, alpha, np.zeros((D, D)), np.eye(D))
    assert nothing.ok and nothing.alpha == pytest.approx(model.alpha_cad, rel=1e-6)


def test_constants_in_other_units_scale_cad() -> None:
    """A motor current in place of its torque: all constants, and all links, are the torque constant's times CAD's."""
    model = model_of("ypp3_general")
    for unit in (1e-4, 30.0):
        found = nearest_links(model, unit * model.alpha_cad)
        assert found.exact
        assert found.parameters.ravel() == pytest.approx(unit * model.chain.parameters, rel=1e-9, abs=unit * 1e-12)


@pytest.mark.parametrize("kind", ["negative", "random", "tiny", "singular covariance", "wide covariance"])
@pytest.mark.parametrize("name", ["arm6", "panda"])
def test_nonsense_still_ends_with_possible_links(name: str, kind: str) -> None:
    model, rng = model_of(name), np.random.default_rng(11)
    cad, V = model.alpha_cad, relative(model, 0.01)
    D = len(cad)
    alpha = {
        "negative": -cad, "random": rng.normal(size=D) * np.abs(cad).max(), "tiny": 1e-9 * cad[::-1],
    }.get(kind, cad * (1 + 0.3 * rng.normal(size=D)))  # fmt: skip
    if kind == "singular covariance":
        V = np.outer(cad, cad) * 1e-4
    if kind == "wide covariance":
        V = V * 10.0 ** rng.uniform(-10, 2, D)
        V = np.diag(np.diag(V))
    found = nearest_links(model, alpha, V)
    assert not found.exact and found.distance > 0.0
    assert np.isfinite(found.parameters).all() and np.linalg.eigvalsh(pseudo(found.parameters)).min() > 0.0
    assert error(model, found, found.alpha) < 1e-9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.ones(5),), "shapes"),
        ((np.ones(13), np.eye(12)), "shapes"),
        ((np.ones(13), np.eye(13), np.ones((2, 13))), "shapes"),
        ((np.full(13, np.nan),), "finite"),
        ((np.zeros(13),), "not all zero"),
        ((np.ones(13), np.full((13, 13), np.inf)), "finite"),
    ],
)
def test_misuse_is_refused_in_one_line(arguments: tuple[np.ndarray, ...], message: str) -> None:
    with pytest.raises(IdentError, match=message) as refused:
        nearest_links(model_of("ypp3_general"), *arguments)
    assert "\n" not in str(refused.value)
