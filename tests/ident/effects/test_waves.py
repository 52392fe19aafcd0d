"""A wave of another order is another effect; all else has none."""

from __future__ import annotations

from ident.effects.catalogue import CATALOGUE
from ident.effects.learned import learned
from ident.effects.motor import InputDelay
from ident.effects.sensor import EncoderEccentricity
from ident.effects.waves import is_harmonic, is_wave, order_of, orders_at


def test_waves_are_what_has_a_whole_order() -> None:
    names = {kind.name for kind in CATALOGUE.values() if is_wave(kind)}
    assert names == {"torque-ripple", "transmission-error", "encoder-eccentricity"}
    assert order_of(InputDelay(1, (1e-3,))) is None and order_of(learned("motor", "friction", [0.0])(1, (0.1,))) is None


def test_orders_are_those_of_one_kind_at_one_joint() -> None:
    two, twelve, elsewhere = (
        EncoderEccentricity(joint, (1e-3, order, 0.0)) for joint, order in ((1, 2.0), (1, 12.0), (0, 5.0))
    )
    ripple = CATALOGUE["torque-ripple"](1, (0.1, 6.0, 0.0))
    assert orders_at((two, twelve, elsewhere, ripple), EncoderEccentricity, 1) == {2.0, 12.0}
    assert order_of(twelve) == 12.0 and orders_at((), EncoderEccentricity, 1) == set()


def test_a_harmonic_of_a_wave_is_no_other_wave() -> None:
    """Orders 5 and 10 of one joint are one error that is no sine: it has no name."""
    assert is_harmonic(10.0, {5.0}) and is_harmonic(5.0, {10.0, 7.0}) and is_harmonic(15.0, {5.0})
    assert not is_harmonic(12.0, {2.0, 5.0}) and not is_harmonic(5.0, set())
