"""The report says what the verdict says, shows it, and needs nothing but itself."""

from __future__ import annotations

import re
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from diagnosed import JOINT, diagnosis, unexplained
from undrawn import undrawn

from ident.effects.crosstalk import crosstalk
from ident.effects.learned import learned
from ident.effects.lubricated import LubricatedLink, LubricatedMotor
from ident.effects.memory import HYSTERESIS, PRESLIDING, remembering
from ident.effects.motor import InputDelay
from ident.effects.response import response
from ident.effects.ringing import Ringing
from ident.loop.diagnose import status_of
from ident.loop.diagnosis_json import verdict_document
from ident.loop.diagnosis_report import html, not_held_out, sentence, text, todo
from ident.loop.effect_words import meaning, ordinate
from ident.loop.either_model import ENDED
from ident.loop.growth import nearest
from ident.loop.held_out import felt
from ident.search.contradicted import Off
from ident.search.deviations import Deviation

HOSTILE = "<script>alert(1)</script> {{ 7 }} & co"


def words(d, verdict):
    """The page without what is drawn."""
    with undrawn():
        return html(d, verdict)


def law_drawn(d, verdict):
    """The page, and the law in it: of the records nothing is drawn."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ident.loop.diagnosis_figures.before_after_figure", lambda *_: "")
        page = html(d, verdict)
    (figure,) = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    return page, figure


def test_the_page_opens_with_what_was_found_and_holds_before_and_after(file):
    d = diagnosis()
    v = verdict_document(d, [file])
    page = html(d, v)
    assert (
        page.index("lacks motor-coulomb (or motor-stribeck) at joint2")
        < page.index("<svg")
        < page.index("Error on records")
    )
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
    page = words(d, verdict_document(d, [file], [HOSTILE]))
    assert HOSTILE not in page and page.count("&lt;script&gt;alert(1)") == 2


def test_what_is_unexplained_is_said_with_joint_port_band_and_parity(file):
    d = unexplained()
    v = verdict_document(d, [file])
    assert sentence(v).endswith("motor of joint2, 3-10 Hz, odd lines.")
    late = verdict_document(d, [file], [f"{ENDED} after 240 s: a longer one may find more (--minutes)."])
    assert sentence(late).endswith("motor of joint2, 3-10 Hz, odd lines, when the search was ended for time.")
    page = html(d, v)
    assert "What stays unexplained" in page and page.count("<svg") == 1
    assert "σ is of noise alone" in page
    assert "ident next" in " ".join(todo(v))


def test_effects_with_which_the_held_out_error_grows_are_not_said_to_be_missing(file):
    d = diagnosis()
    assert status_of(False, True, False, False) == "effect-found"
    assert status_of(False, True, True, True) == "unexplained"
    assert (
        status_of(False, False, True, False) == "effect-found" and status_of(False, False, False, True) == "explained"
    )
    v = verdict_document(replace(d, before=d.after, after=d.before, status="unexplained"), [file])
    assert "lacks" not in sentence(v) and "with motor-coulomb at joint2 the held-out error grows from" in sentence(v)


def test_effects_with_which_it_grows_and_something_stays_are_what_comes_nearest_in_all_words(file):
    d = replace(diagnosis(), departures=unexplained().departures, status="unexplained")
    v = verdict_document(d, [file])
    assert "lacks" in sentence(v) and not nearest(v)
    e = v["error"]
    e["before"] = {"all": 0.00324, "per_joint": {"joint2": 0.00752}, "per_band": e["before"]["per_band"]}
    e["after"] |= {"all": 0.00327, "per_joint": {"joint2": 0.0108}}
    told = "with motor-coulomb at joint2 the held-out error grows from 0.324 % to 0.327 % and that of joint2 grows from"
    assert re.search(rf"explains: motor of joint2, .*; {told} 0.752 % to 1.08 %\.$", sentence(v))
    for page in (text(v), words(d, v)):
        assert "lacks motor" not in page and "J(q) without the effects" not in page and "wrong by" not in page
        assert "What follows comes nearest to what acts, and is not it" in page
    assert any("Keep the declared arm" in line for line in todo(v)) and not any("Use the" in line for line in todo(v))


def test_two_waves_of_one_kind_at_a_joint_are_told_by_their_orders(file):
    v = verdict_document(diagnosis(), [file])
    wave = v["effects"][0] | {"name": "torque-ripple", "confounded_with": []}
    orders = [{"order": {"value": order, "std": None, "unit": "1/rev"}} for order in (2.0, 12.0)]
    v["effects"] = [wave | {"parameters": one} for one in orders]
    assert "lacks torque-ripple of order 2 at joint2 and torque-ripple of order 12 at joint2; with them" in sentence(v)
    v["effects"] = v["effects"][:1]
    assert "lacks torque-ripple at joint2; with it" in sentence(v)


def test_what_is_to_be_said_of_a_record_is_told_in_the_verdict_and_in_words(file):
    d = diagnosis()
    first, *others = d.responses
    d = replace(d, responses=(replace(first, status=("record 1: it drifts",)), *others))
    v = verdict_document(d, [file], ["a note"])
    assert v["notes"] == ["a note", "record 1: it drifts"]
    assert "! record 1: it drifts" in text(v) and "it drifts" not in text(v, brief=True)
    assert "<li>record 1: it drifts</li>" in words(d, v)


def test_nothing_found_is_said_plainly(file):
    d = replace(unexplained(), departures=(), status="explained")
    v = verdict_document(d, [file])
    assert sentence(v) == "Nothing is missing: the declared model explains every record within its noise."
    v["notes"] = ["Left out, in all records and all errors: 49.5, 150 Hz. What was read there stands far above ..."]
    assert sentence(v).endswith("within its noise. What stands alone at 49.5, 150 Hz is left out.")
    page = words(d, v)
    assert "What stays unexplained" not in page and "σ is of noise alone" not in page
    heading, first, *_ = text(v).splitlines()[2:]
    assert (heading.split()[-3:], len(first.split())) == (["[%]", "error", "noise"], 3), "before and after are the same"
    assert "<th>error<br>%</th>" in page and "before" not in page.split("Error on")[1].split("</table>")[0]
    drawn = html(d, v).split("<svg")[1].split("</svg>")[0]
    assert ">left<" in drawn and "left before" not in drawn


def test_an_effect_that_leaves_more_than_noise_is_not_said_to_explain_the_records(file):
    v = verdict_document(diagnosis(), [file])
    v["error"] |= {"before": {"all": 0.3}, "after": {"all": 0.1, "per_joint": {}, "per_band": {}}, "noise_floor": 0.01}
    assert sentence(v).endswith("with it its error falls from 30 to 10 times the noise.")
    v["error"]["noise_floor"] = 0.09
    assert sentence(v).endswith("with it it explains the records.")


def test_what_hardly_helps_is_told_as_what_comes_nearest(file):
    v = verdict_document(diagnosis(), [file])
    assert not any("with care" in line for line in todo(v))
    d = diagnosis()
    v = verdict_document(replace(unexplained(), added=d.added, before=d.before, after=d.after), [file])
    assert "lacks" in sentence(v) and any("with care" in line for line in todo(v))
    v["error"] |= {
        "before": {"all": 0.11},
        "after": {"all": 0.1, "per_joint": {}, "per_band": {}},
        "noise_floor": 0.001,
    }
    assert sentence(v).endswith("comes nearest, far from it.") and "lacks" not in sentence(v)


def test_what_does_not_repeat_is_not_said_to_be_explained(file):
    """It counts as noise: of one joint there is ten times as much of it as of the others."""
    d = diagnosis()
    noise = {"joint1": 0.001, "joint2": 0.02, "joint3": 0.002}
    v = verdict_document(replace(d, after=replace(d.after, noise_per_joint=noise)), [file])
    assert sentence(v).endswith("with it it explains what repeats in the records.")
    (said,) = [note for note in v["notes"] if "period" in note]
    assert said.startswith("joint2 does not repeat itself from period to period: 2 % of its motion differs, 13 times")
    noise["joint2"] = 0.01  # as light joints have it whose encoders are coarse
    v = verdict_document(replace(d, after=replace(d.after, noise_per_joint=noise)), [file])
    assert not v["notes"] and sentence(v).endswith("with it it explains the records.")


def test_joints_and_bands_with_more_than_noise_are_named_but_for_those_of_few_lines(file):
    v = verdict_document(diagnosis(), [file])
    noise = {"joint2": v["error"]["noise_per_joint"]["joint2"], **v["error"]["noise_per_band"]}
    v["error"]["after"]["per_joint"]["joint2"] = 2.2 * noise["joint2"]
    v["error"]["after"]["per_band"] |= {"10-30 Hz": 2.42 * noise["10-30 Hz"], "1-3 Hz": 9.0 * noise["1-3 Hz"]}
    but = "but for joint2 (2.2 times the noise) and 10-30 Hz (2.4 times the noise)."
    assert sentence(v, {"1-3 Hz"}).endswith(f"it explains the records, {but}")
    assert text(v, few={"1-3 Hz"}).splitlines()[0] == sentence(v, {"1-3 Hz"})
    assert "1-3 Hz (9 times" in sentence(v)


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
        "The declared model lacks motor-coulomb (or motor-stribeck) at joint2, and 3 declared numbers are off; with all corrected it "
        "explains the records."
    )
    page = words(d, v)
    assert page.count("<h2>1. motor-coulomb") == 1 and "<h2>2." not in page
    assert page.count("Declared numbers that are off") == 1
    assert "Several links are not as in the URDF" in page and "do not tell inertial-parameters from payload" in page
    share = -4e-6 / d.campaign.J_m[0]
    assert f"2. motor-inertia at joint1: inertia off by -4e-06 +- 1e-09 kgm2 ({100 * share:+.3g} %)" in text(v)
    only = sentence(verdict_document(replace(d, added=()), [file]))
    assert only == "3 declared numbers are off; with all corrected it explains the records."


@pytest.mark.parametrize(
    ("name", "told"), [("share", "all by this share"), ("change", "This link is not as in the URDF: J(q) changes by")]
)
def test_a_link_that_is_off_is_told_by_the_number_that_says_how(name, told):
    number = {"value": 0.12, "std": 1e-3, "unit": ""}
    effect = {"name": "inertial-parameters", "joint": "joint2", "parameters": {name: number}}
    assert told in meaning(effect)


def test_what_no_record_shows_is_null_and_told_without_an_error(file):
    d = diagnosis()
    v = verdict_document(replace(d, added=(replace(d.added[0], std=(float("nan"),)),)), [file])
    assert v["effects"][0]["parameters"]["level"]["std"] is None
    said = f"not told by these records (kept at {v['effects'][0]['parameters']['level']['value']:.3g} Nm)"
    page = html(d, v)
    assert f"level {said}\n" in text(v) and said in page and "nan" not in page.lower()


def test_a_damping_where_none_is_declared_has_no_share(file):
    d, none = diagnosis(), np.zeros(0)
    campaign = replace(d.campaign, D=np.zeros(d.campaign.n))
    found = Deviation("motor-viscous", 0, (("damping", 3e-5, 1e-7, "Nms/rad"),), 300.0, none, none)
    d = replace(d, campaign=campaign, added=(), off=(Off(found, 0.05, d.after.all, d.start),))
    v = verdict_document(d, [file])
    assert "motor-viscous at joint1: damping off by 3e-05 +- 1e-07 Nms/rad\n" in text(v) + "\n"
    assert "Declared numbers that are off" in words(d, v)


def test_few_declared_numbers_are_named(file):
    v = verdict_document(numbers(replace(diagnosis(), added=())), [file])
    assert sentence(v) == "The declared model lacks inertial-parameters (or payload); with it it explains the records."


def test_drives_stand_as_found_beside_what_was_declared(file):
    d = diagnosis()
    v = verdict_document(d, [file])
    K = v["drives"]["K"]
    assert K["value"] == pytest.approx(d.campaign.K, rel=2e-3) and 0.0 < max(K["std"]) < 2e-3 * max(K["value"])
    assert "<h2>Drives</h2>" in words(d, v)


def test_springs_that_are_off_are_told_and_stand_with_their_share(file):
    d = numbers(diagnosis(), -4e-6, 1e-6)
    assert "prings" not in text(verdict_document(d, [file]))
    d = replace(d, campaign=replace(d.campaign, K=d.campaign.K * [1.0, 1.25, 1.0]))
    v = verdict_document(d, [file])
    assert "3 declared numbers are off besides the springs;" in sentence(v)
    assert "Springs are not as declared: joint2 -20" in text(v) and "joint1" not in text(v).split("Springs are")[1]
    assert re.search(r"<b>−(20\.0|19\.9)\d*</b>", words(d, v).split("<h2>Drives</h2>")[1])


def with_effect(d, effect, std):
    """The same diagnosis, had it ended with this effect."""
    base, k = d.end.problem.base, len(effect.values)

    def grown(values, more):
        return np.append(values[:base], [more] * k)

    problem = replace(
        d.end.problem, effects=(effect,), scale=grown(d.end.problem.scale, 1.0), low=grown(d.end.problem.low, -9.0),
        high=grown(d.end.problem.high, 9.0), free=grown(d.end.problem.free, True),
    )  # fmt: skip
    information = np.zeros((base + k, base + k))
    information[:base, :base] = d.end.minimum.information[:base, :base]
    vector = np.append(d.end.minimum.vector[:base], effect.values)
    minimum = replace(d.end.minimum, vector=vector, information=information)
    end = replace(d.end, effects=(effect,), problem=problem, minimum=minimum)
    return replace(d, end=end, added=(replace(d.added[0], effect=effect, std=std),))


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        (learned("motor", "sliding", [-9.0, 0.0, 9.0])(JOINT, (0.004, 0.003, 0.004)),
         "0.003 to 0.004 Nm over −9 to 9 rad/s"),
        (learned("motor", "position", [0.0, 0.3, 0.6], 0.9)(JOINT, (0.001, 0.0, -0.001)),
         "−0.001 to 0.001 Nm over 0 to 0.9 rad"),
        (learned("sensor", "reading", [-9.0, 0.0, 9.0])(JOINT, (1e-4, 0.0, 1e-4)), "0 to 0.0001 rad over −9 to 9 rad"),
        (learned("spring", "stiffness", [-9.0, 0.0, 9.0])(JOINT, (10.0, 0.0, 10.0)), "0 to 10 Nm/rad over −9 to 9 rad"),
        (learned("spring", "mesh", [0.0, 2.0, 4.0], 6.0)(JOINT, (-1.0, 0.0, 1.0)), "−1 to 1 Nm over 0 to 6 rad"),
        (response("motor", [1.0, 5.0, 20.0, 90.0])(JOINT, (-0.01, -0.05, -0.1, 1e-3, 1e-3, 2e-3, 1e-3)),
         "gain 0.905 to 1, delay 1 to 2 ms over 1 to 90 Hz"),
    ],
)  # fmt: skip
def test_a_learned_curve_is_told_by_its_size_and_range_and_drawn_with_its_knots(file, effect, said):
    d = with_effect(diagnosis(), effect, (float("nan"), *[1e-4] * (len(effect.values) - 1)))
    v = verdict_document(d, [file])
    page, figure = law_drawn(d, v)
    assert said in page and said in text(v) and "height_" not in page and "1. an unknown law at joint2" in text(v)
    assert "its knots ± σ" in figure and "from the records" in figure and "nan" not in figure.lower()
    ET.fromstring(figure)


def test_a_mass_that_rings_is_told_by_its_numbers_and_drawn_as_the_inertia_that_its_motor_feels(file):
    effect = Ringing(JOINT, (4e-6, 20.0, 1e-4))
    d = with_effect(diagnosis(), effect, (1e-9, 1e-3, 1e-6))
    v = verdict_document(d, [file])
    (told,) = v["effects"]
    assert (told["name"], told["port"], told["parameters"]["frequency"]["value"]) == ("unknown", "motor", 20.0)
    assert max(told["curve"]["heights"]) > 50 * told["parameters"]["inertia"]["value"]
    page, figure = law_drawn(d, v)
    assert (
        "rings at 20 Hz" in text(v) and "1. an unknown resonance at joint2" in text(v) and "an unknown law" not in page
    )
    assert "hat inertia the motor feels" in page and "by 42 knots" not in page and "kgm2" in page
    assert "inertia felt [kg m²]" in figure and "nan" not in figure.lower()
    ET.fromstring(figure)
    found = felt(d, effect)
    assert len(found.records) > 1 and len(found.f) == len(found.measured) == len(found.law)


@pytest.mark.parametrize(
    ("kind", "lags", "said"),
    [
        ((HYSTERESIS, "motor"), 0.002, ("a loop over motor torque", "up to 0.002 Nm in a loop of +- 0.02 Nm")),
        ((HYSTERESIS, "sensor"), 0.002, ("a loop over motor angle", "up to 0.002 rad in a loop of +- 0.02 rad")),
        ((PRESLIDING, "motor"), 0.5, ("friction that gives before it slides, a loop over motor angle", "up to 0.5 Nm in a loop of +- 0.02 rad")),
        ((PRESLIDING, "link"), 0.5, ("a loop over link angle", "up to 0.5 Nm in a loop of +- 0.02 rad")),
    ],
)  # fmt: skip
def test_a_memory_is_told_and_drawn_as_a_loop(file, kind, lags, said):
    """Of a stop that has slipped: half of what it follows, or its torque."""
    d = with_effect(diagnosis(), remembering(*kind, [0.004, 0.02], 1)(JOINT, (0.5, 0.0)), (1e-4,) * 2)
    v = verdict_document(d, [file])
    loop = v["effects"][0]["curve"]["loop"]
    assert max(loop["over"]) == pytest.approx(0.02) and max(loop["output"]) == pytest.approx(lags)
    page, figure = law_drawn(d, v)
    assert said[0] in page and said[1] in page and said[1] in text(v) and "height_" not in page
    assert ("An error of the encoder" in page) == (kind[1] == "sensor") and "where loops, of what it was before" in page
    ET.fromstring(figure)


@pytest.mark.parametrize("kind", [LubricatedMotor, LubricatedLink])
def test_friction_of_bristles_is_told_by_its_numbers_and_drawn_over_velocity(file, kind):
    d = with_effect(diagnosis(), kind(JOINT, (0.004, 0.002, 0.02, 1.5, 1e-3)), (1e-5, 1e-5, 1e-4, 0.01, 1e-5))
    v = verdict_document(d, [file])
    (told,) = v["effects"]
    assert (told["name"], told["port"], told["curve"]["variable"]) == ("unknown", kind.port, "lubricated")
    assert told["curve"]["heights"][0] == pytest.approx(0.006) and told["curve"]["heights"][-1] < 0.0041
    page, figure = law_drawn(d, v)
    assert "1. an unknown friction (LuGre) at joint2" in text(v) and "unknown law" not in page
    assert (
        "friction that gives before it slides" in page
        and "peak 0.002" in text(v)
        and '<td class="left">peak</td>' in page
    )
    ET.fromstring(figure)


@pytest.mark.parametrize(("port", "what"), [("motor", "torque"), ("sensor", "angle")])
def test_crosstalk_is_told_by_its_share_and_the_joint_of_which_it_comes(file, port, what):
    d = with_effect(diagnosis(), crosstalk(port, 2)(JOINT, (0.02,)), (1e-4,))
    v = verdict_document(d, [file])
    page = words(d, v)
    assert v["effects"][0]["curve"]["from_joint"] == 3
    assert f"a share of the {what} of the motor of joint 3, 2 % of it" in text(v)
    assert f"a share of the {what} of the motor of joint 3" in page and "<b>2 % of it</b></td>" in page


def test_a_delay_is_drawn_by_its_phase(file):
    d = with_effect(diagnosis(), InputDelay(JOINT, (1e-3,)), (1e-6,))
    figure = law_drawn(d, verdict_document(d, [file]))[1]
    assert "phase [deg]" in figure and "motor velocity" not in figure


def test_a_joint_that_no_held_out_record_excites_is_said_to_be_one(file):
    d = with_effect(diagnosis(), InputDelay(2, (1e-3,)), (1e-6,))
    v = verdict_document(d, [file])
    assert not_held_out(v) == ["joint3"]
    assert "joint3                 no held-out record excites it" in text(v).splitlines()
    page = html(d, v)
    assert "No held-out record excites joint3." in page and "no held-out record excites it</td>" in page


def test_what_is_called_unknown_has_one_name(file):
    d = with_effect(
        diagnosis(), learned("motor", "sliding", [-9.0, 0.0, 9.0])(JOINT, (0.004, 0.003, 0.004)), (1e-4,) * 3
    )
    v = verdict_document(d, [file])
    v["effects"][0]["rivals"] = [{"name": "unknown", "joint": "joint1", "after": 0.1}]
    assert v["effects"][0]["name"] == "unknown"
    seen = re.sub(r"<[^>]*>", " ", words(d, v)) + text(v)
    assert set(re.findall(r"\w+ unknown \w+", seen)) == {"an unknown law"}


def test_the_page_says_what_the_parts_of_the_records_were(file):
    d = diagnosis()
    v = verdict_document(d, [file])
    page = words(d, v)
    assert "Error on records that the model was not fitted to" in page and "then fitted on these, too" not in page
    half = replace(d.split, note="two records: blocks of lines by turns")
    page = words(replace(d, split=half), verdict_document(replace(d, split=half), [file]))
    assert (
        "Error on lines that the model was not fitted to" in page and "errors from lines that no fit has taken" in page
    )
    end = replace(d.end, problem=replace(d.end.problem, data=(*d.split.fit, *d.split.select)))
    assert "0005, then fitted on these, too" in words(replace(d, end=end), v)


def test_a_clean_report_tells_how_far_the_urdf_is_off_and_has_nothing_before(file):
    d = replace(diagnosis(), added=(), departures=(), status="explained")
    d = replace(d, end=d.start)
    page = words(d, verdict_document(d, [file]))
    assert "before off by" not in page and "URDF off by" in page and "<i>J</i><sub>33</sub>" in page


def test_what_can_not_be_played_is_no_plan(file):
    v = verdict_document(diagnosis(), [file], (), {"out": "found/it"})
    assert todo(v)[-1] == "ident next found/it writes that experiment, ready to run."
    v["effects"][0]["confounded_with"][0] |= {
        "recipe": "link-sensor",
        "separate_by": "motor records never tell them apart",
    }
    assert todo(v)[0] == "motor-coulomb at joint2 or motor-stribeck at joint2: motor records never tell them apart."
    assert "ident next" not in " ".join(todo(v))
    assert "Not by more of them:" in words(diagnosis(), v)


def test_a_note_keeps_the_names_of_records(file):
    d = diagnosis()
    d = replace(d, split=replace(d.split, note="few records: Extra/0007 of J(q) fits"))
    assert "Few records: Extra/0007 of J(q) fits." in words(d, verdict_document(d, [file]))


def test_a_load_that_is_not_on_the_ray_is_not_said_to_be():
    load = {"name": "payload", "parameters": {key: {} for key in ("mass", "centre_x", "centre_y", "centre_z")}}
    assert "ray" not in meaning(load) and "mass at the last link" in meaning(load)
    assert "ray" in meaning(load | {"parameters": {"mass": {}, "along": {}}})


def test_what_is_a_share_of_the_load_is_labelled_so():
    assert ordinate({"variable": "passing", "unit": ""}, "motor") == "share of the load [1]"
