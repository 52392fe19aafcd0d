"""Encoders on the links, which no fit reads, say of a model what is true of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosed import JOINT, REPORT, diagnosis

from ident.loop.diagnose import Diagnosis
from ident.loop.diagnosis_json import verdict_document
from ident.loop.diagnosis_report import html, text
from ident.loop.link_encoders import link_reads, remarks_on_links, told_by_links, witnesses
from ident.records.campaign import Array


def reading(q_link: Array | None) -> Diagnosis:
    """The diagnosis, had the reporting record these angles of the links."""
    d, (report,) = diagnosis(), REPORT
    records = list(d.campaign.records)
    records[report] = replace(records[report], q_link=q_link)
    return replace(d, campaign=replace(d.campaign, records=tuple(records)))


def angles() -> Array:
    q = diagnosis().campaign.records[REPORT[0]].q_link
    assert q is not None
    return np.array(q)


def test_the_link_moves_as_the_model_of_the_motors_says() -> None:
    """MuJoCo's link, the linear arm's: 50 lines that differ by noise; a tenth of what the model without friction leaves."""
    d = diagnosis()
    (read,) = link_reads(d)
    (witness,) = witnesses(d)
    assert read.joint == witness.joint == JOINT
    assert 0.6 < witness.misfit < 1.5
    assert witness.after < 2.0 * witness.noise and witness.after < 0.3 * witness.before
    assert 10.0 < witness.highest < 100.0, "above its mode the link hardly moves"
    assert remarks_on_links(told_by_links(d)) == []


def test_an_encoder_that_reads_too_much_and_late_is_told_as_that() -> None:
    q = angles()
    d = reading(
        q[0] + 1.02 * (np.roll(q, 1, axis=0) - q[0])
    )  # the last sample comes before the first: the record repeats
    (witness,) = witnesses(d)
    assert witness.gain == pytest.approx(1.02, abs=2e-3) and witness.delay == pytest.approx(2e-3, rel=0.02)
    (line,) = remarks_on_links(told_by_links(d))
    assert "joint2" in line and " times that, 2 ms late, but for" in line


def test_a_link_that_moves_otherwise_is_no_scale_and_no_delay() -> None:
    """It has a third of the spring's swing more, as behind another spring."""
    q, record = angles(), diagnosis().campaign.records[REPORT[0]]
    wound = record.theta / diagnosis().campaign.N - q
    (line,) = remarks_on_links(told_by_links(reading(q - 0.3 * (wound - wound.mean(axis=0)))))
    assert "between motor and link" in line


def test_a_campaign_without_them_says_nothing_of_them() -> None:
    told, without = (verdict_document(d, [__file__]) for d in (diagnosis(), reading(None)))
    assert told["link_encoders"]["joint2"]["after"] < told["link_encoders"]["joint2"]["before"]
    assert "Encoders on the links" in html(diagnosis(), told) and "joint2, link encoder" in text(told)
    assert without["link_encoders"] == {}
    assert "Encoders on the links" not in html(diagnosis(), without) and "link encoder" not in text(without)


def test_an_encoder_too_coarse_to_read_any_line_says_nothing() -> None:
    q = angles()
    assert witnesses(reading(np.round(q / 0.05) * 0.05)) == ()
