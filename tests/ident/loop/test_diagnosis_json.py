"""verdict.json is what the format promises: every key, no NaN, and the numbers of the diagnosis."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from diagnosed import JOINT, LEVEL, REPORT, ROOT, SELECT, diagnosis, unexplained

from ident.arm.coupled import uncertainty
from ident.arm.parts import degrees, lines_of
from ident.effects.learned import learned
from ident.effects.motor import TorqueRipple
from ident.effects.response import response
from ident.errors import IdentError
from ident.loop.diagnosis_json import (
    _confounded,
    _moves_no_other,
    _of_response,
    result_document,
    verdict_document,
    write,
)
from ident.loop.effect_words import extent, named
from ident.search.contradicted import Off
from ident.search.deviations import Deviation
from symgen.plan import chain_of_robot, make_model
from symgen.robot import load_robot

KEYS = {"format", "version", "input", "status", "declared", "effects", "error", "inertia", "drives", "unexplained"}
EFFECT = {"name", "joint", "port", "parameters", "before", "after", "evidence", "rivals", "confounded_with"}
RESULT = {
    "joints", "alpha", "K", "J_m", "D", "chi2_per_dof", "explained", "not_identifiable", "physically_consistent", "method",
    "records", "seconds",
}  # fmt: skip


def strict(document):
    """The document as another program reads it; ValueError for NaN."""
    return json.loads(json.dumps(document, allow_nan=False))


def blind(d, name):
    """The same diagnosis, had no record shown this constant."""
    k = 4 * d.campaign.n + d.model.names.index(name)
    information = np.array(d.end.minimum.information)
    information[k], information[:, k] = 0.0, 0.0
    return replace(d, end=replace(d.end, minimum=replace(d.end.minimum, information=information)))


def test_records_that_an_error_leaves_out_are_named(file, monkeypatch):
    d = diagnosis()
    monkeypatch.setattr("ident.loop.diagnosis_json.told_of", lambda split, state, data: data[1:])
    out, *kept = [d.campaign.records[one.index].id for one in d.split.report]
    split = verdict_document(d, [file])["error"]["split"]
    assert split["report"] == kept and f"{out} left out" in split["note"]


def test_the_verdict_has_every_key_of_the_format(file):
    d = diagnosis()
    v = strict(verdict_document(d, [file]))
    assert set(v) >= KEYS and (v["format"], v["version"]) == ("frf-verdict", 1)
    assert v["input"]["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert (v["input"]["file"], v["input"]["records"], v["input"]["kind"]) == (str(file), 6, "campaign")
    assert v["error"]["split"]["select"] == [d.campaign.records[k].id for k in SELECT]
    assert v["error"]["split"]["report"] == [d.campaign.records[k].id for k in REPORT]
    assert set(v["error"]["split"]["fit"]).isdisjoint(v["error"]["split"]["select"] + v["error"]["split"]["report"])
    assert v["error"]["before"]["all"] == d.before.all and v["error"]["after"]["per_band"] == d.after.per_band
    assert v["error"]["noise_floor"] == d.after.noise
    assert v["error"]["noise_per_joint"] == d.after.noise_per_joint
    assert v["error"]["noise_per_band"] == d.after.noise_per_band


def test_a_result_beyond_its_limit_is_not_explained():
    """Also where an effect was found that explains nearly all."""
    d = diagnosis()
    half = replace(d, end=replace(d.end, minimum=replace(d.end.minimum, chi2=0.5 * d.end.minimum.chi2)))
    for one in (d, half):
        found = result_document(one, {})
        assert found["explained"] == (found["chi2_per_dof"] <= found["chi2_limit"]) == (one is half)


def test_the_effect_is_the_one_that_was_put_in(file):
    (effect,) = verdict_document(diagnosis(), [file])["effects"]
    assert set(effect) >= EFFECT
    assert (effect["name"], effect["joint"], effect["port"]) == ("motor-coulomb", "joint2", "motor")
    level = effect["parameters"]["level"]
    assert level["unit"] == "Nm" and abs(level["value"] / LEVEL - 1.0) < 0.01  # what the band's end costs
    assert 0.0 < level["std"] < 0.01 * LEVEL
    assert effect["evidence"]["statistic"] > effect["evidence"]["threshold"] > 0.0
    first = effect["evidence"]["port_shares"][0]
    assert (first["port"], first["joint"]) == ("motor", "joint2")
    assert effect["before"] > effect["after"] > 0.0


def test_each_rival_stands_once_and_one_as_good_is_confounded(file):
    (effect,) = verdict_document(diagnosis(), [file])["effects"]
    assert [(r["name"], round(r["after"] / effect["after"], 3)) for r in effect["rivals"]] == [
        ("motor-stribeck", 1.001), ("link-coulomb", 2.0)]  # fmt: skip
    (other,) = effect["confounded_with"]
    assert (other["name"], other["joint"], other["recipe"]) == ("motor-stribeck", "joint2", "amplitude")
    assert "amplitude" in other["separate_by"]


def test_no_effect_is_confounded_by_what_a_rival_left_while_another_was_missing(file):
    d = diagnosis()
    (only,) = d.added
    first, last = verdict_document(replace(d, added=(replace(only, tied=(only.effect,)), only)), [file])["effects"]
    assert first["rivals"] == last["rivals"] and not first["confounded_with"]
    assert [other["name"] for other in last["confounded_with"]] == ["motor-stribeck"]


def test_constants_that_no_record_shows_have_no_deviation(file):
    d = blind(diagnosis(), "alpha_13")
    inertia = verdict_document(d, [file])["inertia"]
    assert set(inertia["alpha_before"]) == set(inertia["alpha_after"]) == set(d.model.names)
    std = {name: row["std"] for name, row in inertia["alpha_after"].items()}
    assert std["alpha_31"] is not None and std["alpha_13"] is None
    value = inertia["alpha_after"]["alpha_31"]["value"]
    assert abs(value / 0.0466 - 1.0) < 0.005
    off = abs(inertia["alpha_before"]["alpha_31"]["value"] - value) / 0.0466
    assert inertia["J"]["change_rms"][2][2] == pytest.approx(off, rel=1e-9)
    assert (
        inertia["J"]["std_after"][0][0] is inertia["J"]["change_rms"][0][0] is None
        and inertia["J"]["std_after"][2][2] < 0.01
    )


def test_whole_numbers_have_no_deviation_and_curves_tell_themselves(file):
    d = diagnosis()
    ripple = TorqueRipple(JOINT, (0.0, 4.0, 0.1))
    curve = learned("motor", "position", [-1.0, 0.0, 1.0])(JOINT, (0.0, 0.0, 0.0))
    for effect, std in ((ripple, (0.1, 0.0, 0.2)), (curve, (0.1,) * 3)):
        problem = replace(
            d.end.problem, effects=(effect,), scale=np.append(d.end.problem.scale[:-1], [1.0] * 3),
            low=np.append(d.end.problem.low[:-1], [-9.0] * 3), high=np.append(d.end.problem.high[:-1], [9.0] * 3),
            free=np.append(d.end.problem.free[:-1], [True] * 3),
        )  # fmt: skip
        P = problem.base + 3
        vector = np.append(d.end.minimum.vector[:-1], effect.values)
        information = np.zeros((P, P))
        information[:-2, :-2] = d.end.minimum.information
        minimum = replace(d.end.minimum, vector=vector, information=information)
        end = replace(d.end, effects=(effect,), problem=problem, minimum=minimum)
        one = replace(d, end=end, added=(replace(d.added[0], effect=effect, std=std),))
        (told,) = strict(verdict_document(one, [file]))["effects"]
        if effect is ripple:
            assert [p["std"] for p in told["parameters"].values()] == [0.1, None, 0.2]
        else:
            assert told["name"] == "unknown" and told["curve"]["variable"] == "position"
            assert told["curve"]["knots"] == [-1.0, 0.0, 1.0] and told["curve"]["period"] is None


def test_what_is_left_is_told_where_it_acts(file):
    v = strict(verdict_document(unexplained(), [file]))
    assert v["status"] == "unexplained" and v["effects"] == []
    first, second = v["unexplained"]
    assert (first["joint"], first["port"], first["band_hz"]) == ("joint2", "motor", [3.0, 10.0])
    assert (first["odd"], first["even"], first["share"]) == (True, False, pytest.approx(0.7))
    assert first["measured_at"] == ["joint1", "joint2"]
    assert (second["odd"], second["even"]) == (False, True)


def test_the_result_has_the_keys_that_fit_promises():
    r = strict(result_document(blind(diagnosis(), "alpha_13"), {"diagnose": 1.5}))
    assert set(r) >= RESULT and r["seconds"] == {"diagnose": 1.5}
    assert [name for name, std in zip(r["alpha"]["names"], r["alpha"]["std"], strict=True) if std is None] == [
        "alpha_13"
    ]
    assert r["K"]["value"] == pytest.approx([5500.0, 4500.0, 4500.0], rel=2e-3)
    assert all(std > 0.0 for std in r["K"]["std"])
    assert r["effects"][0]["name"] == "motor-coulomb"
    (missing,) = r["not_identifiable"]
    assert "alpha_13" in missing["what"]


def test_a_lines_part_of_the_records_has_the_misfit_of_its_own_lines():
    """chi^2 per degree of freedom where every other line was judged: about one, as of all lines."""
    d = diagnosis()
    half = tuple(lines_of(one, np.arange(len(one.use)) % 2 == 0) for one in d.end.problem.data)
    problem, split = replace(d.end.problem, data=half), replace(d.split, fit=half)
    chi2 = d.end.minimum.chi2 * degrees(half) / degrees(d.end.problem.data)
    end = replace(d.end, problem=problem, minimum=replace(d.end.minimum, chi2=chi2))
    by_all, by_half = (result_document(one, {})["chi2_per_dof"] for one in (d, replace(d, end=end, split=split)))
    assert by_half == pytest.approx(by_all, rel=0.05)


def test_what_a_model_is_known_to_is_asked_once(file, monkeypatch):
    """Of the model before and of the one after, whichever documents are made of them."""
    d, asked = blind(diagnosis(), "alpha_13"), []
    monkeypatch.setattr(
        "ident.search.spread.uncertainty",
        lambda problem, found: (asked.append(found), uncertainty(problem, found))[1],
    )
    verdict_document(d, [file])
    result_document(d, {})
    assert sorted(map(id, asked)) == sorted([id(d.start.minimum), id(d.end.minimum)])


def test_numbers_of_a_model_that_leaves_more_than_noise_are_less_sure_by_the_root_of_it(file):
    d = diagnosis()
    own, dof = d.end.minimum, degrees(max(d.end.problem.data, d.split.fit, key=degrees))
    sure, unsure = (
        verdict_document(replace(d, end=replace(d.end, minimum=replace(own, chi2=level * dof))), [file])
        for level in (1.0, 9.0)
    )
    for tell in (
        lambda v: v["drives"]["K"]["std"],
        lambda v: [one["std"] for one in v["inertia"]["alpha_after"].values() if one["std"] is not None],
    ):
        assert tell(unsure) == pytest.approx(3.0 * np.array(tell(sure)))


def test_the_first_model_has_declared_numbers_as_declared_where_these_alone_are_off():
    d = diagnosis()
    off = Off(Deviation("motor-inertia", 0, (), 9.0, np.zeros(1, dtype=int), np.zeros(1)), 0.2, 0.1, d.end)
    assert d.first is replace(d, off=(off,)).first is d.start  # beside an effect they are as found in both
    alone = replace(d, added=(), off=(off,), start=d.end, end=d.start)
    assert alone.first is d.end


def test_a_document_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "deep" / "verdict.json"
    write({"a": None}, path)
    assert json.loads(path.read_text()) == {"a": None}
    with pytest.raises(ValueError, match="JSON"):
        write({"a": float("nan")}, path)
    assert json.loads(path.read_text()) == {"a": None}
    with pytest.raises(IdentError, match="verdict.json"):
        write({}, tmp_path / "deep" / "verdict.json" / "verdict.json")


def test_what_is_of_the_whole_arm_is_at_every_joint():
    (other,) = _confounded(diagnosis(), "payload", None, [("inertial-parameters", 2)])
    assert (other["joint"], other["recipe"]) == ("joint3", "mass") and "payload" in other["separate_by"]


@pytest.mark.parametrize(("joint", "told"), [(0, True), (1, False)])
def test_a_response_of_a_joint_that_moves_no_other_one_may_be_of_its_torque_or_of_its_angle(joint, told):
    effect = response("motor", [1.0, 3.0, 10.0])(joint, (0.0, 0.0, 1e-3, 1e-3, 1e-3))
    found = _of_response(diagnosis(), effect)
    assert [(one["name"], one["joint"], one["recipe"]) for one in found] == [
        ("unknown", "joint1", "link-sensor")
    ] * told
    assert not told or named(found[0]) == "an unknown law of the measured angle at joint1"


@pytest.mark.parametrize(("aside", "alone"), [(0.0, True), (1e-5, True), (0.02, False)])
def test_zeros_that_were_measured_are_not_quite_none(aside, alone):
    """Centres of mass that are so far [m] aside couple the yaw with the others; with a baseline, advice was the contrary."""
    chain = chain_of_robot(load_robot(ROOT / "robots/ypp3"))
    bodies = [replace(j.inertia, com=j.inertia.com + [aside, 0.0, 0.0]) for j in chain.joints]
    off = replace(chain, joints=tuple(replace(j, inertia=b) for j, b in zip(chain.joints, bodies, strict=True)))
    assert [_moves_no_other(make_model(off), joint) for joint in range(3)] == [alone, False, False]


def test_a_delay_that_no_record_tells_says_nothing_of_how_long_it_is():
    curve = response("motor", [1.0, 3.0])(0, (-0.1, 0.02, 1e-3)).curve()
    told = {name: {"std": std} for name, std in [("log_gain_2", 0.1), ("delay_1", None), ("delay_2", 1e-6)]}
    assert "delay 1 to 1 ms over 1 to 3 Hz" in extent({"curve": curve, "port": "motor", "parameters": told})
