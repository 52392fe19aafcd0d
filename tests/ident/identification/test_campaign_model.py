"""What is said of zeros that are believed."""

from __future__ import annotations

from ident.identification.campaign_model import zeros_believed


def test_one_zero_is_one() -> None:
    assert zeros_believed(1) == "The one inertial parameter that is exactly zero in the URDF is believed to be zero"
    assert zeros_believed(15) == "The 15 inertial parameters that are exactly zero in the URDF are believed to be zero"
