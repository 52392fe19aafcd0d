"""The next experiment is one that the robot can play and that changes what has to change."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
from diagnosed import ROOT, campaign, diagnosis

import ident.loop.next_experiment
from ident.arm.coupled import uncertainty
from ident.errors import IdentError
from ident.identification.export import write_files
from ident.identification.identified import of_parts
from ident.loop.diagnosis_json import FILE, verdict_document, write
from ident.loop.next_experiment import LARGER, SMALLER, SWING, Wish, _another, _cells, _paragraph, plan_next, wanted
from ident.records.inputs import again, joined, told
from ident.records.store import write_campaign
from ident.simulator.bench import design
from symgen.plan import Cell, chain_of_robot, load_plan_cells, make_model
from symgen.robot import load_robot


@pytest.fixture(scope="module")
def verdict(tmp_path_factory):
    """A directory as ident diagnose leaves it, and its verdict."""
    out, d = tmp_path_factory.mktemp("out"), diagnosis()
    file = out / "campaign.h5"
    write_campaign(d.campaign, file)
    problem, found = d.end.problem, d.end.minimum
    p = problem.parameters(found.vector)
    covariance, unseen, _ = uncertainty(problem, found)
    numbers = (p.alpha, covariance, unseen, p.K, p.J_m, p.D, p.D_spring)
    write_files(of_parts(d.campaign, d.model, *numbers), out)
    return out, verdict_document(d, [file])


def planned(verdict, recipe, seed=1, made_with=None, **change):
    """The next experiment, had the first confounded pair needed this recipe."""
    out, document = verdict
    document = json.loads(json.dumps(document))
    effect = document["effects"][0]
    effect["confounded_with"][0]["recipe"] = recipe
    effect |= change
    document["made_with"] = made_with or {}
    write(document, out / FILE)
    return plan_next(out, seed)


def test_another_amplitude_is_another_one():
    assert _another(0.005, slow=False) == LARGER * 0.005 and _another(0.005, slow=True) == SMALLER * 0.005
    assert _another(0.015, slow=False) == SWING
    assert _another(0.03, slow=False) == SMALLER * 0.03  # no larger one is to be had


def test_friction_that_falls_with_speed_is_looked_for_at_small_motions(verdict):
    found = planned(verdict, "amplitude")
    robot = load_robot(found.files[0])
    model = make_model(chain_of_robot(robot), believe_zeros=robot.believe_zeros)
    cells = load_plan_cells(found.files[1], model)
    assert {cell.joint for cell in cells} == {"joint2"} and len(cells) == len(found.cells) == 2
    record = campaign().records[1]
    S = record.samples_per_period
    swing = np.abs(record.theta[-S:, 1] - record.theta[-S:, 1].mean()).max() / 100
    assert 0.5 * SMALLER * swing < robot.experiment.swing < 2.0 * SMALLER * swing
    assert all(file.is_file() for file in found.files)
    assert (robot.drive("joint2").K, robot.drive("joint2").D) == (4500.0, 3e-5)  # as declared
    assert robot.urdf.read_text() == campaign().urdf  # so that both campaigns are of one robot
    played = np.loadtxt(next(f for f in found.files if f.name == "0001.csv"), delimiter=",", skiprows=1)
    assert len(played) == S and np.abs(played[:, 1]).max() > 0.0


def test_new_postures_are_far_from_those_measured(verdict):
    found = planned(verdict, "postures")
    measured = np.array([record.posture for record in campaign().records])
    assert len(found.cells) >= 3
    for cell in found.cells:
        assert np.abs(measured - cell.q).max(axis=1).min() > 0.3


def test_a_shift_is_a_quarter_of_the_ripple(verdict):
    order = {"parameters": {"order": {"value": 4.0, "std": None, "unit": "1/rev"}}}
    found = planned(verdict, "shift", **order)
    measured = np.array([r.posture for r in campaign().records if r.excited == "joint2"])
    steps = sorted(
        {round(float(np.abs(measured - cell.q)[:, 1].min()) / (2 * np.pi / (100 * 4 * 4)), 6) for cell in found.cells}
    )
    assert steps == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(("recipe", "joints"), [("others", 3), ("lines", 1), ("repeat", 3)])
def test_every_recipe_is_ready_to_run(verdict, recipe, joints):
    found = planned(verdict, recipe)
    assert len({cell.joint for cell in found.cells}) == joints
    e = load_robot(found.files[0]).experiment
    assert (e.f0, e.band[1]) == (
        (0.5, 0.4 * campaign().fs) if recipe == "lines" else (1.0, pytest.approx(99.0, abs=1.1))
    )
    assert len(found.text.splitlines()) == 2 and str(found.files[1]) in found.text
    assert json.loads(json.dumps(found.document()))["recipe"] == recipe
    file, out = verdict[1]["input"]["file"], verdict[0]
    assert f"ident diagnose {file} next.h5 -o {out}." in found.text


@pytest.mark.parametrize(("recipe", "own"), [("mass", True), ("link-sensor", False)])
def test_what_more_records_of_the_robot_do_not_tell_is_no_plan(verdict, recipe, own):
    found = planned(verdict, recipe)
    assert found.wish is None and not found.files and not found.cells
    first, pair, *more = found.text.splitlines()
    assert first.startswith("There is nothing to be played") and pair.startswith(
        "motor-coulomb at joint2 or motor-stribeck"
    )
    assert bool(more) == own and ("a URDF of its own and a diagnosis of its own" in found.text) == own


def test_what_can_be_played_comes_before_what_can_not(verdict):
    other = verdict[1]["effects"][0]["confounded_with"][0]
    pairs = [other | {"recipe": "mass", "separate_by": "a known mass"}, other | {"recipe": "amplitude"}]
    found = planned(verdict, "mass", confounded_with=pairs)
    assert found.wish is not None and found.wish.recipe == "amplitude" and found.files
    assert "motor-coulomb at joint2 or motor-stribeck at joint2: a known mass." in found.text.splitlines()


def test_what_is_simulated_as_advised_is_what_was_exported(verdict):
    found = planned(verdict, "amplitude", seed=7)
    words = found.text.split("ident simulate ")[1].split()
    robot = load_robot(words[0])
    model = make_model(chain_of_robot(robot), believe_zeros=robot.believe_zeros)
    cells = load_plan_cells(words[words.index("--plan") + 1], model)
    seed = int(words[words.index("--seed") + 1])
    (job, *_) = design(model.chain, robot, [(cell.joint, cell.q) for cell in cells], seed=seed)
    played = np.loadtxt(next(f for f in found.files if f.name == "0001.csv"), delimiter=",", skiprows=1)
    np.testing.assert_allclose(job.setup.excitation.samples(robot.experiment.fs), played[:, 1], rtol=1e-9)


def test_a_file_of_the_same_name_does_not_hide_the_right_one(tmp_path, monkeypatch):
    there, here = tmp_path / "there", tmp_path / "here"
    for place, amount in ((there, 1), (here, 2)):
        place.mkdir()
        write_campaign(replace(campaign(), records=campaign().records[:amount]), place / "c.h5")
    monkeypatch.chdir(there)
    given = told(["c.h5"])
    monkeypatch.chdir(here)
    assert len(again(given).records) == 1
    (there / "c.h5").write_bytes(b"")
    with pytest.raises(IdentError, match=r"there/c\.h5: has changed since the result was made of it"):
        again(given)
    for place in (there, here):
        (place / "c.h5").unlink()
    with pytest.raises(IdentError, match="c.h5: no such file"):
        again(given)


def test_what_was_measured_next_counts_as_measured(verdict, tmp_path):
    """The postures of a second file that was diagnosed with the first are not asked for again."""
    out, document = verdict
    first = planned(verdict, "postures")
    second = tmp_path / "next.h5"
    one = campaign().records[1]
    records = [
        replace(one, id=f"{k:04d}", posture=cell.q, theta=one.theta + 1e-9 * k) for k, cell in enumerate(first.cells, 1)
    ]
    write_campaign(replace(campaign(), records=tuple(records)), second)
    both = [out / "campaign.h5", second]
    later = planned((out, document | {"input": document["input"] | told(both)}), "postures")
    new, old = (np.array([cell.q for cell in one.cells]) for one in (later, first))
    assert np.abs(new[:, None] - old).max(axis=2).min() > 0.3
    assert f"ident diagnose {both[0]} {second} next-2.h5 -o {out}." in later.text
    third = tmp_path / "again" / "next.h5"
    third.parent.mkdir()
    others = [replace(record, theta=record.theta + 1e-6) for record in records]
    write_campaign(replace(campaign(), records=tuple(others)), third)
    assert [r.id for r in joined([*both, third]).records[-2:]] == [f"next-3/{r.id}" for r in others[-2:]]
    with pytest.raises(IdentError, match="record 0001 has the samples of record 0001 of the files before"):
        joined([both[0], both[0]])


def test_each_posture_is_seen_from_every_joint_once():
    q = [np.array([0.1, 0.2, 0.3]), np.array([0.3, 0.2, 0.1])]
    records = [replace(campaign().records[0], excited=name, posture=one) for one in q for name in campaign().joints]
    wish = Wish("others", None, "")
    cells = _cells(wish, replace(campaign(), records=tuple(records)), None, None)
    assert len(cells) == len({(name, *one) for name, one in cells}) == 6


def test_what_is_unexplained_asks_by_its_parity():
    row = {"joint": "joint2", "port": "motor", "band_hz": [3.0, 10.0], "share": 1.0}
    for odd, even, recipe in ((True, False, "amplitude"), (True, True, "shift"), (False, False, "others")):
        wish = wanted({"effects": [], "unexplained": [row | {"odd": odd, "even": even}]})
        assert wish is not None and (wish.recipe, wish.joint) == (recipe, "joint2")
        assert wish.because.startswith("because something at joint2 stays unexplained (3-10 Hz, ")
    assert wanted({"effects": [], "unexplained": []}) is None


@pytest.mark.parametrize(
    ("joints", "unit"), [(("joint3",), "m"), (("joint1",), "rad"), (("joint1", "joint3"), "rad or m")]
)
def test_how_far_a_slide_swings_is_told_in_metres(joints, unit):
    cells = [Cell(joint, np.zeros(4)) for joint in joints]
    said = _paragraph(Wish("shift", joints[0], "because"), cells, load_robot(ROOT / "robots" / "scara4"), campaign())
    assert re.search(rf"up to [0-9.]+ {unit} \(before", said) and "These are the same postures" in said


def test_what_is_missing_is_said_in_one_line(verdict, tmp_path):
    with pytest.raises(IdentError, match="verdict.json: no such file; expected what ident diagnose wrote"):
        plan_next(tmp_path)
    (tmp_path / FILE).write_text("[]")
    with pytest.raises(IdentError, match="not a result"):
        plan_next(tmp_path)
    document = dict(verdict[1], input={"file": str(tmp_path / "gone.h5")})
    write(document, tmp_path / FILE)
    with pytest.raises(IdentError, match="gone.h5: no such file"):
        plan_next(tmp_path)
    document = dict(verdict[1], input=verdict[1]["input"] | {"sha256": "0" * 64})
    write(document, tmp_path / FILE)
    with pytest.raises(IdentError, match="has changed since the result was made of it"):
        plan_next(tmp_path)


def test_the_first_records_are_repeated_and_not_the_last(verdict, monkeypatch):
    monkeypatch.setattr(ident.loop.next_experiment, "MOST", 2)
    found = planned(verdict, "repeat")
    first = campaign().records[:2]
    assert [cell.joint for cell in found.cells] == [record.excited for record in first[::-1]]
    assert all(np.allclose(cell.q, record.posture) for cell, record in zip(found.cells, first[::-1], strict=True))


def test_the_advised_command_is_the_same_diagnosis_and_can_be_pasted(verdict):
    made = {"believe_zeros": False, "minutes": 2.0, "baseline": {"file": "be fore.h5"}}
    text = planned(verdict, "amplitude", made_with=made).text
    words = shlex.split(text.split("Then: ")[1].rstrip("."))
    file, out = verdict[1]["input"]["file"], verdict[0]
    assert words == [
        "ident", "diagnose", file, "next.h5", "-o", str(out), "--baseline", "be fore.h5", "--no-believe-zeros", "--minutes", "2",
    ]  # fmt: skip


def test_a_joint_that_no_record_excites_is_excited_where_others_were():
    own = tuple(r for r in campaign().records if r.excited == "joint2")
    cells = _cells(Wish("amplitude", "joint3", ""), replace(campaign(), records=own), None, None)
    assert [joint for joint, _ in cells] == ["joint3", "joint3"]
    assert all(np.array_equal(q, record.posture) for (_, q), record in zip(cells, own, strict=False))
