"""What gives and carries links that are not the declared ones: they are found with it, as far as it shows them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnosed import ROOT

from ident.effects.base import Effect, Known
from ident.effects.carried import Carrying, carrying, of_declared_links, shown
from ident.effects.friction import LinkViscous
from ident.effects.structure import BaseCompliance, LinkFlexibility, all_that_gives
from ident.loop.diagnose import Begun, begin
from ident.records.frf import estimate
from ident.search.links_off import carrying_others
from ident.search.minima import links_anew
from ident.search.refits import Refit, fitted, on_declared_links, reduced_chi2
from ident.simulator.bench import simulate
from symgen.chain import Chain, Inertia
from symgen.plan import chain_of_robot, make_model
from symgen.robot import load_robot

ROBOT = load_robot(ROOT / "robots/ypp3")
S = 2j * np.pi * np.array([2.0, 12.0, 40.0])
BASE = BaseCompliance(None, (1.5e5, 2.5e5, 60.0, 2e-4))
BENT = LinkFlexibility(1, (2e4, 0.6, 2e-4, 1.0))
CELLS = [("joint1", [0, 0.7, 0.5]), ("joint2", [0, 0.6, 0.9]), ("joint2", [0, -0.4, 1.8]), ("joint3", [0, 0.5, 0.3]),
         ("joint1", [0, 1.4, -1.0]), ("joint2", [0, 0.3, -1.2]), ("joint3", [0, -0.8, 0.7]), ("joint1", [0, -0.3, 2.0]),
         ("joint2", [0, -0.8, 0.7])]  # fmt: skip


def arm(chain: Chain, q: tuple[float, ...]) -> Known:
    drives = [ROBOT.drive(name) for name in chain.names]
    N, K = (np.array([getattr(d, f) for d in drives]) for f in ("N", "K"))
    J = make_model(chain, believe_zeros=True).J_cad(np.array([q]))[0]
    return Known(N, K, J, np.array(q), chain, np.asarray(ROBOT.gravity))


def heavier(chain: Chain, shares: tuple[float, ...], longer: tuple[float, ...]) -> Chain:
    """The arm with links heavier by shares, and their centres of mass farther out."""
    bodies = [j.inertia for j in chain.joints]
    off = [
        Inertia((1 + m) * b.mass, (1 + x) * b.com, (1 + m) * b.I)
        for b, m, x in zip(bodies, shares, longer, strict=True)
    ]
    return replace(chain, joints=tuple(replace(j, inertia=b) for j, b in zip(chain.joints, off, strict=True)))


@pytest.mark.parametrize("effect", [BASE, BENT])
def test_it_carries_the_links_that_it_says(effect: Effect) -> None:
    chain = chain_of_robot(ROBOT)
    here = arm(chain, (0.0, 0.4, 0.9))
    directions = 0.1 * np.random.default_rng(2).normal(size=(30, 2)) * chain.parameters[:, None]
    found = carrying(effect, directions)
    np.testing.assert_array_equal(found.impedance(S, here), effect.impedance(S, here))
    off = found.with_values((*effect.values, 1.0, -2.0))
    other = replace(here, chain=chain.with_parameters(chain.parameters + directions @ [1.0, -2.0]))
    np.testing.assert_array_equal(off.impedance(S, here), effect.impedance(S, other))
    assert (off.name, off.joint, off.port, off["damping"]) == (effect.name, effect.joint, effect.port, 2e-4)


@pytest.mark.parametrize(("off", "plain"), [(BASE, BENT), (BENT, BASE)])
def test_beside_another_it_carries_the_links_that_it_says(off: Effect, plain: Effect) -> None:
    """What both carry, too; the other one by itself carries those that were declared."""
    chain = chain_of_robot(ROBOT)
    here = arm(chain, (0.0, 0.4, 0.9))
    directions = 0.1 * np.random.default_rng(2).normal(size=(30, 2)) * chain.parameters[:, None]
    off, also = (carrying(e, directions).with_values((*e.values, 1.0, -2.0)) for e in (off, plain))
    other = replace(here, chain=chain.with_parameters(chain.parameters + directions @ [1.0, -2.0]))
    both, of_other = all_that_gives(S, here, (off, also)), all_that_gives(S, other, (BASE, BENT))
    np.testing.assert_allclose(both, of_other, rtol=0.0, atol=1e-12 * np.abs(of_other).max())
    added = off.impedance(S, replace(here, beside=(plain,)))
    total = all_that_gives(S, here, (plain, off))
    np.testing.assert_allclose(added, total - plain.impedance(S, here), rtol=0.0, atol=1e-12 * np.abs(total).max())
    assert np.abs(total - of_other).max() > 1e-3 * np.abs(total).max()


@pytest.mark.parametrize("effect", [BASE, BENT])
def test_of_declared_links_it_is_itself_again(effect: Effect) -> None:
    there = carrying(effect, np.ones((30, 3)))
    back = of_declared_links(there.with_values((*effect.values, 1.0, 2.0, 3.0)))
    assert type(back) is type(effect) and back.values == effect.values and of_declared_links(back) is back


@pytest.mark.parametrize("effect", [BASE, BENT])
def test_links_may_be_off_in_all_ways_that_it_shows_and_in_no_other(effect: Effect) -> None:
    chain = chain_of_robot(ROBOT)
    arms = [arm(chain, q) for q in ((0.0, 0.4, 0.9), (0.0, -1.1, 2.0), (0.0, 1.5, -0.4))]
    directions = shown(effect, S, arms, True)
    assert 2 <= directions.shape[1] <= 12

    def change(to: Chain) -> np.ndarray:
        Z = [effect.impedance(S, replace(a, chain=c)) for a in arms for c in (chain, to)]
        return np.concatenate([(b - a).ravel() for a, b in zip(Z[::2], Z[1::2], strict=True)])

    off = heavier(chain, (1e-3, -2e-3, 1.5e-3), (1e-3, 1e-3, -1e-3))
    best = np.linalg.lstsq(directions, off.parameters - chain.parameters, rcond=None)[0]
    columns = np.array([change(chain.with_parameters(chain.parameters + 1e-3 * d)) for d in directions.T]).T / 1e-3
    columns, wanted = (np.concatenate([x.real, x.imag]) for x in (columns, change(off)))
    best = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    assert np.linalg.norm(columns @ best - wanted) < 0.02 * np.linalg.norm(wanted)


def test_a_model_is_fitted_again_on_declared_links_by_the_same_numbers() -> None:
    chain = chain_of_robot(ROBOT)
    effects = (
        LinkViscous(0, (1.5,)),
        carrying(BENT, np.zeros((10 * chain.n, 2))).with_values((*BENT.values, 0.1, 0.2)),
        BASE,
    )
    values = np.concatenate([e.values for e in effects])
    limits = tuple((value, value + 1.0) for value in values)
    state: Any = SimpleNamespace(effects=effects, problem=SimpleNamespace(base=2), minimum=SimpleNamespace(vector=np.append([7.0, 8.0], values)),
                                 scales=tuple(values), limits=limits)  # fmt: skip
    refit = on_declared_links(state)
    assert refit is not None and refit.effects == (effects[0], BENT, BASE)
    plain = [1.5, *BENT.values, *BASE.values]
    assert refit.vector.tolist() == [7.0, 8.0, *plain] and list(refit.scales) == plain
    assert [low for low, _ in refit.limits] == plain
    state.effects = effects[:1]
    assert on_declared_links(state) is None


@cache
def begun() -> Begun:
    """By records of an arm on a soft base, of links that are not the declared ones."""
    chain = chain_of_robot(ROBOT)
    short = replace(ROBOT, experiment=replace(ROBOT.experiment, f0=2.0, band=(2.0, 120.0), fs=500.0))
    true = heavier(chain, (0.05, -0.06, 0.04), (-0.02, 0.03, 0.02))
    campaign = simulate(chain, short, CELLS, truth=true, effects=[BASE], workers=1)
    responses = tuple(estimate(record, campaign) for record in campaign.records)
    return begin(campaign, make_model(chain, believe_zeros=True), responses)


#: From its own shapes, and from such as no record shows: a base that hardly weighs, and turns hardly.
@pytest.mark.bench
@pytest.mark.parametrize("shapes", [BASE.values, (1.5e5, 4e7, 6e3, 2e-4)])
def test_a_soft_base_under_links_that_are_not_the_declared_ones_leaves_nothing(shapes: tuple[float, ...]) -> None:
    bench = begun().bench
    limits = tuple((0.2 * min(b, v), 5.0 * max(b, v)) for b, v in zip(BASE.values, shapes, strict=True))
    vector = np.concatenate([bench.guess.vector(), shapes])
    declared = fitted(bench, Refit(vector, (BASE,), BASE.values, limits))
    assert reduced_chi2(bench, declared) > 3.0
    found = carrying_others(bench, declared)
    (effect,) = found.effects
    assert isinstance(effect, Carrying) and effect.name == "base-compliance"
    assert reduced_chi2(bench, found) < 1.2
    np.testing.assert_allclose(effect.values[:3], BASE.values[:3], rtol=0.02)


@pytest.mark.bench
def test_what_it_carries_is_told_anew_once_another_effect_is_known_too() -> None:
    bench = begun().bench
    effects, values = (BASE, LinkViscous(0, (0.1,))), (*BASE.values, 0.1)
    limits = (*((0.2 * b, 5.0 * b) for b in BASE.values), (-10.0, 10.0))
    state = fitted(bench, Refit(np.concatenate([bench.guess.vector(), values]), effects, values, limits))
    said: list[str] = []
    found = links_anew(replace(bench, say=said.append), state)
    assert reduced_chi2(bench, state) > 3.0
    assert reduced_chi2(bench, found) < 1.2
    assert [effect.name for effect in found.effects] == ["base-compliance", "link-viscous"]
    assert isinstance(found.effects[0], Carrying) and len(said) == 1
