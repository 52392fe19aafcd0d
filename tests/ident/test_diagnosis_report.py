"""The report says what the verdict says, shows it, and needs nothing but itself."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from diagnosed import diagnosis, unexplained

from ident.contradicted import Off
from ident.deviations import Deviation
from ident.diagnosis_json import verdict_document
from ident.diagnosis_report import html, sentence, text, todo

HOSTILE = "<script>alert(1)</script> {{ 7 }} & co"


def test_the_page_opens_with_what_was_found_and_holds_before_and_after(file):
    d = diagnosis()
    v = verdict_document(d, [file])
    page = html(d, v)
    assert page.index("lacks motor-coulomb at joint2") < page.index("<svg") < page.index("Error on records")
    figures = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    assert len(figures) == 2  # before and after; the law
    for figure in figures:
        ET.fromstring(figure)
    assert not re.search(r"https?://(?!www\.w3\.org)|<script|<link|@import", page)
    assert f"{100 * d.after.all:.3g}"[:4] in page
    assert "These records do not tell it from motor-stribeck" in page
    assert "nan" not in re.sub(r"<[^>]*>", " ", page).lower().split()


def test_what_stands_in_the_file_cannot_break_the_page(file):
    d = diagnosis()
    d = replace(d, campaign=replace(d.campaign, source=HOSTILE))
    page = html(d, verdict_document(d, [file], [HOSTILE]))
    assert HOSTILE not in page and page.count("&lt;script&gt;alert(1)") == 2


def test_what_is_unexplained_is_said_with_joint_port_band_and_parity(file):
    d = unexplained()
    v = verdict_document(d, [file])
    assert sentence(v).endswith("motor of joint2, 3-10 Hz, odd lines.")
    page = html(d, v)
    assert "What stays unexplained" in page and page.count("<svg") == 1
    assert "ident next" in " ".join(todo(v))


def test_nothing_found_is_said_plainly(file):
    d = replace(unexplained(), departures=(), status="explained")
    v = verdict_document(d, [file])
    assert sentence(v) == "Nothing is missing: the declared model explains every record within its noise."
    assert "What stays unexplained" not in html(d, v)


def test_an_effect_that_leaves_more_than_noise_is_not_said_to_explain_the_records(file):
    v = verdict_document(diagnosis(), [file])
    v["error"] |= {"before": {"all": 0.3}, "after": {"all": 0.1}, "noise_floor": 0.01}
    assert sentence(v).endswith("with it its error falls from 30 to 10 times the noise.")
    v["error"]["noise_floor"] = 0.09
    assert sentence(v).endswith("with it it explains the records.")


def test_the_text_is_one_table_and_one_line_an_effect(file):
    d = diagnosis()
    lines = text(verdict_document(d, [file])).splitlines()
    row = next(line for line in lines if line.startswith("all "))
    assert [float(x) for x in row.split()[1:]] == pytest.approx(
        [100 * d.before.all, 100 * d.after.all, 100 * d.after.noise], rel=5e-3
    )
    (found,) = [line for line in lines if line.startswith("1. motor-coulomb at joint2: level ")]
    assert float(found.split("level ")[1].split()[0]) == pytest.approx(4e-3, rel=0.05)
    brief = text(verdict_document(d, [file]), brief=True)
    assert "next best" in "\n".join(lines) and "next best" not in brief


def numbers(d, *values):
    """Declared numbers off by these: motor inertias of the first joints, the links."""
    none = np.zeros(0)
    drives = [
        Deviation("motor-inertia", j, (("inertia", v, 1e-9, "kgm2"),), 80.0, none, none) for j, v in enumerate(values)
    ]
    links = Deviation(
        "inertial-parameters", None, (("change", 0.12, 1e-3, ""),), 120.0, none, none, (("payload", None),)
    )
    return replace(d, off=tuple(Off(one, 0.05, d.after.all, d.start) for one in (*drives, links)))


def test_many_declared_numbers_that_are_off_are_counted_in_the_sentence_and_told_in_one_table(file):
    d = numbers(diagnosis(), -4e-6, 1e-6)
    v = verdict_document(d, [file])
    assert [effect["declared"] for effect in v["effects"]] == [False, True, True, True]
    assert sentence(v) == (
        "The declared model lacks motor-coulomb at joint2, and 3 declared numbers are off; with all corrected it explains the records."
    )
    page = html(d, v)
    assert page.count("<h2>1. motor-coulomb") == 1 and "<h2>2." not in page
    assert page.count("Declared numbers that are off") == 1
    assert "Several links are not as in the URDF" in page and "do not tell inertial-parameters from payload" in page
    share = -4e-6 / d.campaign.J_m[0]
    assert f"2. motor-inertia at joint1: inertia -4e-06 +- 1e-09 kgm2 ({100 * share:+.3g} %)" in text(v)
    only = sentence(verdict_document(replace(d, added=()), [file]))
    assert only == "3 declared numbers are off; with all corrected it explains the records."


def test_what_no_record_shows_is_null_and_told_without_an_error(file):
    d = diagnosis()
    v = verdict_document(replace(d, added=(replace(d.added[0], std=(float("nan"),)),)), [file])
    assert v["effects"][0]["parameters"]["level"]["std"] is None
    assert "+-" not in text(v).split("level ")[1].splitlines()[0] and "nan" not in html(d, v).lower()


def test_a_damping_where_none_is_declared_has_no_share(file):
    d, none = diagnosis(), np.zeros(0)
    campaign = replace(d.campaign, D=np.zeros(d.campaign.n))
    found = Deviation("motor-viscous", 0, (("damping", 3e-5, 1e-7, "Nms/rad"),), 300.0, none, none)
    d = replace(d, campaign=campaign, added=(), off=(Off(found, 0.05, d.after.all, d.start),))
    v = verdict_document(d, [file])
    assert "motor-viscous at joint1: damping 3e-05 +- 1e-07 Nms/rad\n" in text(v) + "\n"
    assert "Declared numbers that are off" in html(d, v)


def test_few_declared_numbers_are_named(file):
    v = verdict_document(numbers(replace(diagnosis(), added=())), [file])
    assert sentence(v) == "The declared model lacks inertial-parameters; with it it explains the records."


def test_drives_stand_as_found_beside_what_was_declared(file):
    d = diagnosis()
    v = verdict_document(d, [file])
    K = v["drives"]["K"]
    assert K["value"] == pytest.approx(d.campaign.K, rel=2e-3) and 0.0 < max(K["std"]) < 2e-3 * max(K["value"])
    assert "<h2>Drives</h2>" in html(d, v)
