"""The report says what was found, nothing else, and needs nothing but itself."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree as ET

import matplotlib
import numpy as np
import pytest
from synthetic import FS, Arm, record
from undrawn import undrawn

from ident.errors import IdentError
from ident.identification import verdict
from ident.identification.identify import identify
from ident.records.campaign import Campaign
from ident.reports import figures, report, result_page, side_by_side
from symgen.plan import model_of_urdf

URDF = (Path(__file__).parents[3] / "robots/ypp3/ypp3.urdf").read_text()
JOINTS = ("joint1", "joint2", "joint3")
K, J_M = np.array([5500.0, 4500.0, 4500.0]), np.array([4e-5, 4e-5, 1e-5])
# joint from 0 and posture: the paper's six cells and one to spare
CELLS = [
    (2, [0, 0, 0]), (1, [0, 0, 0]), (1, [0, 0, -1.5708]),
    (0, [0, 0, 0]), (0, [0, 0, -1.5708]), (0, [0, 1.5708, 0]), (0, [0, 0.7, 0.5]),
]  # fmt: skip
SOFT, LOCK = [0.002, 0.001], [0.02, 0.004]
PROMISED = {
    "joints", "alpha", "K", "J_m", "D", "chi2_per_dof", "explained", "not_identifiable", "physically_consistent",
    "method", "records", "seconds", "notes", "inertia_vs_cad", "validation", "D_spring",
}  # fmt: skip
RECORD = {
    "excited", "posture", "J_l", "std", "J_cad", "two_mass", "three_point", "chi2_per_dof", "explained", "f_AR", "f_R",
    "inertia_ratio", "band_ratio", "periods_used", "status",
}  # fmt: skip
HOSTILE = r"""<script>alert("1")</script>'&$x_2$ \1 {{ 7 }} é中"""


def measure(cells, *, rigid=True, seed=0, extra=None, lines=None, D_spring=None):
    """A campaign of the paper's arm without gravity. `rigid` locks the other links; else only their motors are held. Springs are damped
    by 1 % of critical, posture by posture, or by `D_spring`."""
    model, rng = model_of_urdf(URDF, JOINTS, believe_zeros=True), np.random.default_rng(seed)
    records = []
    for k, (i, q) in enumerate(cells):
        J = model.J_cad(np.array(q, float))
        links = np.diag(np.diag(J)) if rigid else J
        damping = 0.02 * np.sqrt(K * np.diag(J)) if D_spring is None else D_spring
        arm = Arm(links, K, J_M, 0.75 * J_M, damping, np.zeros((3, 3)), np.full(3, 100.0))
        gains = [SOFT if j == i else LOCK for j in range(3)]
        records.append(
            record(
                arm, i, lines=lines, f0=0.5, rms=0.02, gains=gains, rng=rng, id=f"{k + 1:04d}", posture=q, extra=extra
            )
        )
    return Campaign(URDF, JOINTS, FS, "zoh", np.full(3, 100.0), J_M, K, np.zeros(3), "made for a test", tuple(records))


@pytest.fixture(scope="module")
def good():
    return identify(measure(CELLS), method="two-mass")


@pytest.fixture(scope="module")
def bad():
    return identify(measure(CELLS, rigid=False), method="two-mass")


@pytest.fixture(scope="module")
def whole():
    """Records that two masses do not explain, all motors in one fit."""
    return identify(measure(CELLS, rigid=False, D_spring=np.array([1.2, 1.1, 0.3])))


def unexplained(result):
    """The same, were its fit far off."""
    coupled = replace(result.coupled, explained=False, converged=False, chi2_per_dof=8240.0, chi2_limit=1.28, status=(
        "the coupled fit did not converge", "the elastic arm does not explain its records: chi2/dof 8.24e+03, limit 1.28",
        "motor: D hardly known",
    ))  # fmt: skip
    poor = tuple(replace(m, explained=False) for m in result.measurements)
    return replace(result, coupled=coupled, measurements=poor, explained=False, chi2_per_dof=8240.0)


@pytest.fixture(scope="module")
def pages(good, bad):
    """One with its figures, one without."""
    with undrawn():
        words = report.html(bad)
    return {"good": report.html(good), "bad": words}


class Page(HTMLParser):
    """Tags and attributes of a page, and its visible text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text, self.quiet = [], "", False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.quiet = tag == "style"

    def handle_endtag(self, tag):
        self.quiet = False

    def handle_data(self, data):
        self.text += "" if self.quiet else data

    def warnings(self):
        return [a["class"] for _, a in self.tags if (a.get("class") or "").startswith("warning")]


def svgs(page):
    return re.findall(r"<svg .*?</svg>", page, flags=re.DOTALL)


def test_the_document_keeps_every_promise_in_plain_json(good, bad):
    for result in (good, bad):
        document = report.result_document(result)
        assert json.loads(json.dumps(document, allow_nan=False)) == document
        assert PROMISED <= document.keys()
        assert list(document["records"]) == [m.record.id for m in result.measurements]
        assert all(RECORD <= entry.keys() for entry in document["records"].values())
        assert {len(document["alpha"][key]) for key in ("names", "value", "std", "unit", "cad")} == {6}
        assert document["explained"] is result.explained
    assert not report.result_document(bad)["explained"]


def test_the_precision_asked_for_stands_beside_the_one_achieved(good):
    asked = {"target": 0.01, "predicted": 0.008, "robot_time_s": 60.0}
    document = report.result_document(good, asked)
    entries = np.array(document["certainty"]["per_entry"])
    assert document["precision"] == {**asked, "achieved": entries.max()}
    assert "precision" not in report.result_document(good)
    blind = replace(good, unseen=np.eye(len(good.alpha_all)))
    assert report.result_document(blind, asked)["precision"]["achieved"] is None


def test_identified_numbers_are_the_truth_within_their_errors(good):
    document = report.result_document(good)
    truth = {"K": K, "J_m": J_M, "D": 0.75 * J_M}
    for name, values in truth.items():
        found = document[name]
        # 5 sigma; nine numbers: chance exceeds it once in 200 000 tests
        assert np.all(np.abs(np.array(found["value"]) - values) < 5 * np.array(found["std"]))
    alpha = document["alpha"]
    assert np.all(np.abs(np.subtract(alpha["value"], alpha["cad"])) < 5 * np.array(alpha["std"]))
    assert document["physically_consistent"]["ok"] and document["not_identifiable"] == []


@pytest.mark.bench
def test_what_was_not_measured_is_null_and_named(good):
    known = np.array([True] * 5 + [False])
    unseen = np.eye(6)[:, 5:]
    partial = replace(
        good,
        alpha=replace(good.alpha, determined=known, unseen=unseen),
        alpha_all=np.where(known, good.alpha_all, good.model.alpha_cad),
        unseen=unseen,
        drives=good.drives[1:],
        explained=True,
    )
    document = report.result_document(partial)
    assert document["alpha"]["std"][5] is None and None not in document["alpha"]["std"][:5]
    assert document["K"]["value"][0] is None and document["K"]["std"][0] is None and document["K"]["value"][1] > 0
    assert good.model.names[5] in [entry["what"] for entry in document["not_identifiable"]]
    assert document["inertia_vs_cad"]["sigma_per_entry"][0][0] is None  # J_11 needs that constant
    assert "held at CAD" in result_page.page(partial, document)
    elsewhere = replace(partial, alpha_all=good.alpha_all)  # along another direction that was seen: no CAD value
    with undrawn():
        page, other = report.html(partial), report.html(elsewhere)
    assert "held at CAD" not in other and "not determined alone" in other
    assert "held at CAD" not in result_page.page(elsewhere, report.result_document(elsewhere))
    assert (
        "held at CAD: not measured" in page
        and "never excited" in page
        and "a constant it needs was not measured" in page
    )


def test_a_pair_above_the_band_is_reported_with_a_remedy(good):
    m = good.measurements[0]
    above = replace(m, two_mass=replace(m.two_mass, f_AR=150.0, f_R=160.0), std=0.6 * m.J)
    (entry,) = verdict.not_identifiable(replace(good, measurements=(above, *good.measurements[1:])))
    assert "joint3" in entry["what"] and "150 Hz is above the band, 119.5 Hz" in entry["why"]
    assert "widen the band" in entry["remedy"]


def test_entries_of_kg_and_kg_m2_are_no_shares_of_each_other(good, monkeypatch):
    """Of a heavy slide's mass, a distal inertia that is a fifth off was next to nothing."""
    monkeypatch.setattr(type(good.model.chain), "slides", lambda chain, joint: joint == 0)
    alpha = good.model.alpha_cad.copy()
    alpha[0] *= 1.2  # J_33, the smallest
    against = report.result_document(replace(good, alpha_all=alpha))["inertia_vs_cad"]
    assert against["largest_per_entry"][2][2] == pytest.approx(0.2, rel=1e-9)
    assert against["relative_to"] == "sqrt(J_ii J_jj) at its largest"


def test_differences_from_cad_are_relative_to_the_largest_entry_and_to_the_own_one(good):
    scaled = replace(good, alpha_all=1.01 * good.model.alpha_cad)
    against = report.result_document(scaled)["inertia_vs_cad"]
    assert against["postures"] == 1000
    # J is linear in alpha: every entry is off by 1 % of itself, J_12 and J_13 of this arm are zero
    assert against["largest"] == pytest.approx(0.01, rel=1e-9)
    own = against["own_per_entry"]
    assert own[0][1] is None and own[0][2] is None
    assert [own[i][j] for i, j in ((0, 0), (1, 1), (1, 2), (2, 2))] == pytest.approx([0.01] * 4, rel=1e-9)
    assert np.max(against["largest_per_entry"]) == pytest.approx(against["largest"])
    assert against["rms_per_entry"][2][2] == pytest.approx(against["largest_per_entry"][2][2])  # J_33 is constant


def test_validation_predicts_a_record_from_the_others_only(good):
    checks = report.result_document(good)["validation"]
    assert set(checks) == {m.record.id for k, m in enumerate(good.measurements) if good.alpha.redundancy[k] > 0}
    assert 0 < len(checks) < len(CELLS)  # J_33 is measured once: nothing checks it
    for m in good.measurements:
        if m.record.id in checks:
            check = checks[m.record.id]
            assert check["absolute"] == pytest.approx(check["relative"] * m.J)
            assert abs(check["sigmas"]) < 5
            # what the others predict is the truth up to the error of the difference
            assert abs(m.J - check["absolute"] - m.J_cad) < 5 * abs(check["absolute"] / check["sigmas"])


def test_all_well_is_said_without_a_warning(good, pages):
    page = Page(pages["good"])
    assert good.explained and verdict.problems(good) == ()
    assert "The model explains the data." in page.text and page.warnings() == []
    assert "✗" not in page.text.replace("✗: two masses", "")


def test_a_fit_that_does_not_explain_its_data_heads_the_report(bad, pages):
    page = Page(pages["bad"])
    assert not bad.measurements[0].two_mass.explained
    assert page.warnings() and all("serious" in name for name in page.warnings()[:2])
    text = " ".join(page.text.split())
    assert text.index("The model does not explain the data.") < text.index("Measured inertias")
    assert "Two masses do not explain joint3 in 1 of 1 records: J_33 is not to be trusted" in text
    assert text.index("joint3 in 1 of 1") < text.index("Measured inertias")
    assert "J_11" not in " ".join(problem.what for problem in verdict.problems(bad))  # yaw is not coupled to pitch


def test_held_modes_are_where_the_response_of_the_held_arm_vanishes(bad):
    m = bad.measurements[0]
    modes = verdict.held_modes(bad, m)
    assert len(modes) == 2  # joints 2 and 3 share them; joint 1 is not seen
    heavy = np.where(np.arange(3) == 2, J_M, 1e6)  # motors that do not move
    zero = np.zeros(3)
    arm = Arm(bad.model.J_cad(m.record.posture), K, heavy, zero, zero, np.zeros((3, 3)), np.full(3, 100.0))
    at, aside = (np.abs(arm.response(modes * factor, "continuous")[:, 2, 2]) for factor in (1.0, 1.001))
    # undamped: an exact zero but for the rounding of frequencies and the motors' 1e-10 motion
    assert np.all(at < 1e-4 * aside)
    assert verdict.held_modes(bad, bad.measurements[-1]).size == 1


def test_a_record_too_short_for_two_masses_does_without_them():
    """Five lines a record are plenty for all motors at once: a fit that is there to compare must not refuse them."""
    few = measure([*CELLS[:3], *CELLS[4:]], rigid=False, lines=np.array([9, 25, 61, 105, 165]))
    result = identify(few)
    assert all(m.two_mass is None and m.J == pytest.approx(m.J_cad, rel=0.02) for m in result.measurements)
    document = report.result_document(result)
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    one = document["records"]["0001"]
    assert RECORD <= one.keys() and one["two_mass"] is None and one["J_l"] > 0
    unsure = replace(result.measurements[0], std=0.6 * result.measurements[0].J)
    told = replace(result, measurements=(unsure, *result.measurements[1:]))
    assert "J_l of joint3, record 0001" in [entry["what"] for entry in verdict.not_identifiable(told)]
    with undrawn():
        assert "Record 0001" in Page(report.html(told)).text
    with pytest.raises(IdentError, match="5 of 5 excited lines are usable"):
        identify(few, method="two-mass")


def test_distortion_is_found_where_it_acts_and_not_elsewhere(good):
    assert all(verdict.distorted(m) == [] for m in good.measurements)
    time = np.arange(6 * 2000) / FS
    # 4 % of the 2.6 mN m of an excited line at every even one from 15 to 100 Hz
    extra = 1e-4 * np.sum([np.sin(2 * np.pi * 0.5 * line * time + line) for line in range(30, 200, 2)], axis=0)
    result = identify(measure(CELLS[:1] * 2 + CELLS[1:], extra=extra), method="two-mass")
    assert all(verdict.distorted(m) == ["even lines above 5 Hz"] for m in result.measurements)
    levels = report.result_document(result)["records"]["0001"]["distortion"]
    assert levels["above 5 Hz"]["even"] > 10 * levels["above 5 Hz"]["noise"] and levels["above 5 Hz"]["odd"] is None
    assert levels["below 5 Hz"]["even"] == 0.0


def test_other_findings_become_problems(good):
    drive = replace(good.drives[0], agrees=False, chi2=1e3)
    alpha = replace(good.alpha, agrees=False, chi2=1e3)
    m = good.measurements[0]
    doubtful = replace(m, frf=replace(m.frf, status=tuple(f"record 0001: doubt {k}" for k in range(9))))
    result = replace(
        good, drives=(drive, *good.drives[1:]), alpha=alpha, measurements=(doubtful, *good.measurements[1:]),
        consistency=replace(good.consistency, ok=False, distance=7.0),
    )  # fmt: skip
    found = verdict.problems(result)
    assert [problem.serious for problem in found] == [True, True, True, False]
    assert "joint1" in found[0].what and "contradict" in found[1].what and "7 standard deviations" in found[2].why
    assert "doubt 5" in found[3].why and "doubt 6" not in found[3].why and "3 more" in found[3].why
    near = verdict.problems(replace(good, consistency=replace(good.consistency, ok=False, distance=0.5)))
    assert [problem.serious for problem in near] == [False]


def test_a_joint_that_is_as_good_as_rigid_is_told_once_and_why(good):
    joint = good.measurements[0].record.excited
    untold = [replace(m, std=np.inf) if m.record.excited == joint else m for m in good.measurements]
    drives = [
        replace(d, K=replace(d.K, std=10 * d.K.value), J_m=replace(d.J_m, std=10 * d.J_m.value))
        if d.joint == joint
        else d
        for d in good.drives
    ]
    (plain,) = verdict.problems(replace(good, measurements=tuple(untold)))
    assert "next to nothing is there to contradict it" in plain.why and "no bound" in plain.why
    (rigid,) = verdict.problems(replace(good, measurements=tuple(untold), drives=tuple(drives)))
    ids = [m.record.id for m in good.measurements if m.record.excited == joint]
    assert ", ".join(ids) in rigid.what and "as good as rigid" in rigid.why and "datasheet" in rigid.remedy


def test_the_page_holds_every_record_and_constant(good, bad, pages):
    for name, result in (("good", good), ("bad", bad)):
        page = Page(pages[name])
        ids = [a["id"] for _, a in page.tags if "id" in a]
        assert len(ids) == len(set(ids)), "an id twice"
        assert {f"record-{k + 1}" for k in range(len(CELLS))} <= set(ids)
        assert all(f"Record {m.record.id}" in page.text for m in result.measurements)
        assert all(f"<sub>{alpha.removeprefix('alpha_')}</sub>" in pages[name] for alpha in result.model.names)
        assert all(" ".join(note.split()) in page.text for note in result.notes)
        assert result.model.chain.sha256 in page.text and "made for a test" in page.text


def test_the_page_needs_nothing_but_itself(pages):
    for text in pages.values():
        assert re.findall(r"https?://[^\"' )]+", text.replace('xmlns="http://www.w3.org/2000/svg"', "")) == []
        page = Page(text)
        assert not [tag for tag, _ in page.tags if tag in ("script", "link", "img", "iframe", "object", "base")]
        ids = {a["id"] for _, a in page.tags if "id" in a}
        links = [a[key] for _, a in page.tags for key in ("href", "src", "data", "action") if a.get(key)]
        links += re.findall(r"url\(([^)]*)\)", text)
        assert links and all(link.startswith("#") and link[1:] in ids for link in links)
        assert "@import" not in text
        assert len(text.encode()) < 2_000_000


def test_figures_are_well_formed_and_follow_the_style_sheet(good, pages):
    drawn = svgs(pages["good"])
    n_sweeps = len(figures.sweep_figures(good))
    assert n_sweeps == 3  # J_11 along joints 2 and 3, J_22 along joint 3
    assert len(drawn) == 2 * len(CELLS) + n_sweeps
    for text in drawn:
        root = ET.fromstring(text)
        assert root.get("role") == "img" and root.get("aria-label")
        labels = [node.text for node in root.iter("{http://www.w3.org/2000/svg}text")]
        assert any("[" in label for label in labels), "axes without unit"
    used = set(re.findall(r"var\(--([a-z-]+)\)", pages["good"]))
    defined = set(re.findall(r"--([a-z-]+):", pages["good"]))
    assert used <= defined
    colours = re.findall(r"#[0-9a-f]{6}", "".join(drawn))
    assert colours == []  # a fixed colour would vanish on a dark screen


def test_the_drawn_dots_are_the_measured_response(good):
    m = good.measurements[0]
    r = figures.response(m, good.campaign)
    assert r.measured == pytest.approx((2j * np.pi * m.frf.frequencies * m.frf.G)[m.frf.usable])
    # whitened residuals of a fit that explains its data have mean square chi2/dof (6 parameters of 2 L numbers)
    L = len(r.f)
    assert np.array_equal(r.misfit.f, r.f) and r.misfit.limit == pytest.approx(np.sqrt(np.log(1000.0)))
    assert np.mean(r.misfit.size**2) == pytest.approx(m.two_mass.chi2_per_dof * m.two_mass.dof / (2 * L), rel=1e-9)
    dots = re.compile(r'd="((?:M[\d.]+ [\d.]+h0)+)"[^>]*stroke: var\(--data\)')
    curve = dots.search(figures.frf_figure(m, good.campaign))[1]
    x, y = np.array([pair.split() for pair in re.findall(r"M([\d. ]+)h0", curve)], float).T
    assert len(x) == L
    # both axes are logarithmic: positions are straight in log f and log |velocity|, to the 0.01 they are rounded to
    for position, value in ((x, np.log(r.f)), (y, np.log(np.abs(r.measured)))):
        fit = np.polyval(np.polyfit(value, position, 1), value)
        assert np.abs(fit - position).max() < 0.011


def test_numbers_of_small_arms_do_not_touch(whole):
    """Columns are as wide as what stands in them; those of J from the gram's to the ton's."""
    for scale in (1e-7, 1e-4, 1.0, 1e4):
        small = [replace(m, std=1.3e-4 * scale, J_cad=0.4649371 * scale) for m in whole.measurements]
        text = result_page.page(replace(whole, measurements=tuple(small)), report.result_document(whole)).splitlines()
        start = next(k for k, line in enumerate(text) if line.startswith("record"))
        assert [len(line.split()) for line in text[start + 1 : start + 1 + len(small)]] == [10] * len(small)
        assert len({len(line.removesuffix("  does not fit")) for line in text[start : start + 1 + len(small)]}) == 1


def test_what_a_fit_of_all_motors_leaves_is_in_units_of_the_noise_that_it_weighs_by(whole):
    """The held motors' torques are measured, and their noise is in what the model says of the excited one, too."""
    assert whole.explained
    size = np.concatenate([m.misfit.size / m.misfit.limit for m in whole.measurements])
    assert np.mean(size > 1.0) < 0.01  # 0.001 of noise alone
    numbers = np.array([m.misfit.size.size * m.misfit.motors for m in whole.measurements])
    chi2 = np.array([m.chi2_per_dof for m in whole.measurements])
    # the noise powers are made anew at the end of the fit, which was there to a tenth of a standard deviation
    assert numbers @ chi2 / numbers.sum() == pytest.approx(whole.chi2_per_dof, rel=1e-4)
    m = whole.measurements[0]
    assert m.misfit.motors == 3 and chi2[0] == pytest.approx(np.mean(m.misfit.size**2), rel=0.02)
    assert "chi2/dof: of all motors that move in a record; of all records" in result_page.page(
        whole, report.result_document(whole)
    )


def test_the_curve_of_a_right_cad_is_that_of_the_arm_where_all_motors_are_fitted(whole, bad):
    for m in whole.measurements:
        r = figures.response(m, whole.campaign)
        clear = np.abs(r.measured) > 100 * r.noise
        assert r.means == "datasheet and CAD"
        assert np.median(np.abs(r.declared / r.measured - 1)[clear]) < 0.01
    apart = figures.response(bad.measurements[0], bad.campaign)
    assert apart.means == "datasheet and CAD, other joints rigid"
    assert "datasheet and CAD, other joints rigid" in figures.frf_figure(bad.measurements[0], bad.campaign)


def test_a_record_s_pair_is_that_of_the_method_reported(whole, good):
    for result in (whole, good):
        document = report.result_document(result)
        for m in result.measurements:
            told, i = document["records"][m.record.id], m.index
            own_K, own_J_m = document["K"]["value"][i], document["J_m"]["value"][i]
            assert told["f_AR"] == pytest.approx(np.sqrt(own_K / m.J) / (2 * np.pi))
            assert told["inertia_ratio"] == pytest.approx(m.J / (100.0**2 * own_J_m))
            assert told["f_R"] == pytest.approx(told["f_AR"] * np.sqrt(1 + told["inertia_ratio"]))
            assert told["band_ratio"] == pytest.approx(told["f_AR"] / m.frf.frequencies[-1])
    no_mass = replace(whole.measurements[0], J=-1e-3)
    entry = report.result_document(replace(whole, measurements=(no_mass,)))["records"]["0001"]
    assert entry["f_AR"] is None and entry["f_R"] is None and entry["band_ratio"] is None


def test_a_fit_of_all_motors_that_fails_says_so_and_what_comes_next(whole):
    result = unexplained(whole)
    document = report.result_document(result)
    (problem,) = verdict.problems(result)
    assert problem.why == (
        "χ²/dof over all records and motors is 8240, noise allows 1.28; the coupled fit did not converge; motor: D hardly known."
    )
    assert "ident diagnose CAMPAIGN.h5 -o DIR" in problem.remedy
    assert "ident diagnose CAMPAIGN.h5 -o DIR" in result_page.page(result, document)
    with undrawn():
        text = Page(report.html(result)).text
    assert "widened by the misfit" not in text and "noise alone: where the model is wrong it is too small" in text
    cards = {fact["label"]: fact for fact in report._facts(result, document)}
    assert cards["records explained"]["ok"] is False
    assert (
        cards["constants determined"]["ok"] is None and "were the model right" in cards["constants determined"]["note"]
    )
    assert "are checked by no other" not in text


def test_a_result_that_can_not_be_right_is_not_said_to_explain_nothing(good):
    impossible = replace(good, consistency=replace(good.consistency, ok=False, distance=7.0))
    text = result_page.page(impossible, report.result_document(impossible))
    assert "NOT EXPLAIN" not in text and "BUT THE RESULT CAN NOT BE RIGHT" in text


@pytest.mark.bench
def test_constants_are_counted_as_the_table_has_them(whole):
    """Of general links 13, of which J_ii shows 9; all of them count where all motors are fitted."""
    general = identify(whole.campaign, believe_zeros=False)
    page = report.html(general)
    text = " ".join(Page(page).text.split())
    assert f"{len(general.model.names)} constants, {general.model.d} of which show in some Jii" in text
    assert f"{np.isfinite(general.alpha_std).sum()} of {len(general.model.names)}" in text
    assert "symgen --no-believe-zeros" in text and "symgen --believe-zeros" in Page(report.html(whole)).text
    apart = identify(whole.campaign, method="modal", believe_zeros=False)
    (card,) = (f for f in report._facts(apart, report.result_document(apart)) if f["label"] == "constants determined")
    more = len(apart.model.names) - apart.model.d
    assert (
        card["value"].endswith(f" of {apart.model.d}") and f"{more} more, which no Jᵢᵢ shows, are CAD’s" in card["note"]
    )


def test_methods_side_by_side_stand_in_report_and_result(whole, bad, tmp_path):
    document = report.result_document(whole) | {"methods": side_by_side.comparison([whole, bad])}
    with undrawn():
        result, page = report.write(whole, tmp_path, document)
        alone = Page(report.html(whole)).text
    assert [row["method"] for row in json.loads(result.read_text())["methods"]] == ["coupled", "two-mass"]
    text = " ".join(Page(page.read_text()).text.split())
    assert "Methods side by side" in text and "the rest of this page is of coupled" in text
    assert "Methods side by side" not in alone
    off = 100 * (bad.measurements[0].J / whole.measurements[0].J - 1)
    assert f"{off:.1f}".replace("-", "−") in text


def test_every_number_of_a_drive_stands_beside_its_datasheet(whole):
    known = replace(whole, campaign=replace(whole.campaign, D=0.75 * J_M, D_spring=np.full(3, 0.1234)))
    with undrawn():
        text = Page(report.html(known)).text
    assert "Dspring" in text and text.count("0.1234") == 3
    value, std = whole.drives[0].D_spring.value, whole.drives[0].D_spring.std
    assert verdict.within(value, std) in text
    assert report.result_document(whole)["D_spring"]["value"][0] == value


def test_hostile_names_stay_text(good):
    chain = replace(good.model.chain, name=HOSTILE)
    names = (HOSTILE, *JOINTS[1:])
    first = good.measurements[3]
    odd = replace(first.record, id=HOSTILE, excited=HOSTILE)
    m = replace(first, record=odd, frf=replace(first.frf, record=HOSTILE, joint=HOSTILE))
    result = replace(
        good, model=replace(good.model, chain=chain), notes=(HOSTILE,), measurements=(m,),
        campaign=replace(good.campaign, joints=names, source=HOSTILE, records=(odd,)),
        drives=(replace(good.drives[0], joint=HOSTILE),),
    )  # fmt: skip
    text = report.html(result)
    page = Page(text)
    assert not [tag for tag, _ in page.tags if tag == "script"] and "<script" not in text
    assert page.text.count(HOSTILE) > 5
    for drawn in svgs(text):
        ET.fromstring(drawn)
    assert json.loads(json.dumps(report.result_document(result)))["robot"] == HOSTILE


def test_same_result_same_bytes_whatever_style_the_user_has(good):
    inconsistent = replace(good.consistency, ok=False, distance=7.0)
    small = replace(good, measurements=good.measurements[:1], consistency=inconsistent)
    first = report.html(small)
    assert "The model explains the data, but the result cannot be right." in first
    with matplotlib.rc_context({"lines.linewidth": 9.0, "font.size": 30, "axes.facecolor": "red"}):
        assert report.html(small) == first
        assert matplotlib.rcParams["font.size"] == 30


def test_files_are_replaced_whole_or_not_at_all(good, tmp_path):
    small = replace(good, measurements=good.measurements[:1])
    out = tmp_path / "new" / "dir"
    with undrawn():
        result, page = report.write(small, out)
    assert sorted(path.name for path in out.iterdir()) == ["report.html", "result.json"]
    assert json.loads(result.read_text()) == report.result_document(small)
    assert page.read_text().endswith("</html>\n") or page.read_text().endswith("</html>")
    with undrawn(), pytest.raises(IdentError, match="result.json: cannot be written: ") as caught:
        report.write(small, result)
    assert "\n" not in str(caught.value)
    page.unlink()
    page.mkdir()
    with undrawn(), pytest.raises(IdentError, match="report.html: cannot be written: "):
        report.write(small, out)
    assert sorted(path.name for path in out.iterdir()) == ["report.html", "result.json"]


def test_the_summary_is_one_svg_with_every_record(good, tmp_path):
    path = tmp_path / "summary.svg"
    report.summary_plot(good, path)
    text = path.read_text()
    labels = [node.text for node in ET.fromstring(text).iter("{http://www.w3.org/2000/svg}text")]
    for k, m in enumerate(good.measurements):
        assert any(label.startswith(f"{k + 1}: J_{m.index + 1}{m.index + 1},") for label in labels)
    assert "var(--" not in text  # stands alone
    report.summary_plot(good, path)
    assert path.read_text() == text
    with pytest.raises(IdentError, match="cannot be written"):
        report.summary_plot(good, path / "inside.svg")


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [(1.74338e-6, 4.7e-7, "1.74e−6"), (-3.65725e-7, 1e-6, "−0.4e−6"), (-4.21097e-6, 8.3e-6, "−4.2e−6"), (1e-9, 1e-6, "0"),
     (4.00004e-5, 6e-10, "4.000040e−5"), (0.0465972, 2.2e-6, "0.0465972"), (5500.013, 0.13, "5500.01"), (5512.0, 230.0, "5510"),
     (1234567.0, 2300.0, "1.2346e6"), (2.0, 1e-15, "2.00000000"), (0.1234567, None, "0.123457"), (0.1234567, 0.0, "0.123457"),
     (None, 1.0, "–"), (-1e-9, 0.1, "0"), (0.3, np.inf, "0.3")],
)  # fmt: skip
def test_a_standard_deviation_sets_the_digits(value, std, text):
    assert verdict.within(value, std) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (float("nan"), "–"), (float("inf"), "–"), (0.0, "0"), (1.0, "1"), (100.0, "100"), (23496.7, "23500"),
     (115.5, "116"), (-0.0466, "−0.0466"), (4.0001e-5, "4e−5"), (1.5e9, "1.5e9"), (0.00012345, "0.000123")],
)  # fmt: skip
def test_numbers_are_short_and_exact(value, text):
    assert verdict.number(value, 3) == text


def test_a_constant_that_an_entry_off_the_diagonal_shows_is_written_with_its_joints():
    names = {"alpha_21": "21", "alpha_1x2_1": "1×2,1", "alpha_10_3": "10,3"}
    assert {name: str(report._constant(name)) for name in names} == {
        name: f"<i>α</i><sub>{index}</sub>" for name, index in names.items()
    }
