"""Torques that were read and did not act are told from those that did."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from diagnosed import JOINT, diagnosis, unexplained

from ident.arm.evidence import Evidence
from ident.loop.artefacts import artefacts
from ident.loop.diagnosis_json import verdict_document
from ident.loop.diagnosis_report import sensor_artefacts
from ident.search.departures import Band

BANDS = [Band(1.0, 10.0), Band(10.0, 100.0)]
#: The torque that the sensor makes up at even lines, in shares of that at the excited ones.
SHARE = 0.05


def misread(one: Evidence) -> Evidence:
    """The same record, its excited motor's torque read with something at the even lines that is not there."""
    k, tau = one.place, one.scene.tau.copy()
    even = ~one.is_excited & (one.scene.lines % 2 == 0)
    assert even.any()
    rms = np.sqrt(np.mean(np.abs(tau[one.is_excited, k]) ** 2))
    phase = np.random.default_rng(one.index).uniform(0.0, 2.0 * np.pi, even.sum())
    tau[even, k] += SHARE * rms * np.exp(1j * phase)
    return replace(one, scene=replace(one.scene, tau=tau))


def test_a_torque_that_is_made_up_is_found_with_its_size() -> None:
    d = diagnosis()
    split = replace(
        d.split, **{kind: tuple(map(misread, getattr(d.split, kind))) for kind in ("fit", "select", "report")}
    )
    found = artefacts(replace(d, split=split), BANDS)
    assert {(one.joint, one.even) for one in found} >= {(JOINT, True)} and all(one.even for one in found)
    for one in found:
        assert one.left < 0.1 and abs(one.share / SHARE - 1.0) < 0.2  # what friction itself leaves there is beside it


def test_none_is_found_where_the_arm_answers_each_torque() -> None:
    assert artefacts(diagnosis(), BANDS) == ()


def test_it_is_said_beside_what_stays_unexplained(tmp_path) -> None:
    file = tmp_path / "campaign.h5"
    file.write_bytes(b"records")
    d = unexplained()
    split = replace(
        d.split, **{kind: tuple(map(misread, getattr(d.split, kind))) for kind in ("fit", "select", "report")}
    )
    verdict = verdict_document(replace(d, split=split), [file])
    lines = sensor_artefacts(verdict)
    assert lines and all("even lines" in line and "no motion follows it" in line for line in lines)
