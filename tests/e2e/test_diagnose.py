"""ident diagnose and ident next by the user's own commands, on a robot that is as declared."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ident.cli import main
from ident.loop.diagnosis_report import text
from ident.loop.either_model import diagnose_either
from ident.records.campaign import Campaign
from ident.records.store import read_campaign, write_campaign
from symgen.robot import load_robot

ROOT = Path(__file__).parents[2]
WRITTEN = {"verdict.json", "report.html", "result.json", "robot.toml", "identified.urdf", "identified.xml", "J.casadi"}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("diagnose") / "campaign.h5"
    assert main(["simulate", str(ROOT / "robots/ypp3"), "--spacing", "1", "--periods", "3", "-o", str(file)]) == 0
    return file


@pytest.fixture(scope="module")
def found() -> list[Any]:
    """What the diagnosis of `out` came to."""
    return []


@pytest.fixture(scope="module")
def out(campaign: Path, found: list[Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Diagnosed, with nothing to be found."""
    directory = tmp_path_factory.mktemp("out")

    def kept(*arguments: Any, **options: Any) -> Any:
        found.append(diagnose_either(*arguments, **options))
        return found[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ident.loop.either_model.diagnose_either", kept)
        assert main(["diagnose", str(campaign), "-o", str(directory)]) == 0
    return directory


def test_a_robot_as_declared_is_explained(out: Path, campaign: Path, found: list[Any]) -> None:
    """With general links: where nothing is missing no zeros need be believed."""
    ((diagnosis, notes),) = found
    assert diagnosis.status == "explained" and not diagnosis.model.factoring.believed and not notes
    verdict = json.loads((out / "verdict.json").read_text())
    assert (verdict["status"], verdict["effects"], verdict["unexplained"]) == ("explained", [], [])
    assert (verdict["input"]["file"], verdict["input"]["records"]) == (str(campaign), 8)
    assert {path.name for path in out.iterdir()} >= WRITTEN
    assert load_robot(out).drive("joint1").K == pytest.approx(5500.0, rel=1e-3)


@pytest.mark.usefixtures("out")
def test_json_is_one_document_and_nothing_else(
    campaign: Path,
    found: list[Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    capsys.readouterr()
    monkeypatch.setattr("ident.loop.either_model.diagnose_either", lambda *_, **__: found[0])
    assert main(["diagnose", str(campaign), "-o", str(tmp_path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "verdict.json").read_text())


def test_a_report_is_made_again_of_what_the_verdict_says(
    out: Path, campaign: Path, found: list[Any], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def kept(read: Campaign, believe_zeros: bool | None, **options: Any) -> Any:
        asked.append((len(read.records), believe_zeros, options["seconds"]))
        return found[0]

    monkeypatch.setattr("ident.loop.either_model.diagnose_either", kept)
    page = out / "report.html"
    first = page.read_text()
    page.unlink()
    assert main(["report", str(out)]) == 0
    assert page.read_text() == first and asked == [(8, None, 240.0)]
    sound = (out / "verdict.json").read_text()
    (out / "verdict.json").write_text(sound.replace(json.loads(sound)["input"]["sha256"], "0" * 64))
    assert main(["report", str(out)]) == 2
    assert "has changed since" in capsys.readouterr().err
    (out / "verdict.json").write_text(sound)


def test_nothing_found_leaves_nothing_to_do_next(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["next", str(out)]) == 0
    assert capsys.readouterr().out.startswith("Nothing is left to tell apart")
    assert not (out / "next").exists()


def test_misuse_is_one_line_and_writes_nothing(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign = tmp_path / "robot"
    foreign.mkdir()
    (foreign / "robot.toml").write_text("[robot]\n")
    other, mine = tmp_path / "other.h5", read_campaign(campaign)
    write_campaign(replace(mine, urdf=mine.urdf.replace("<robot", "<!-- another --><robot")), other)
    capsys.readouterr()
    for arguments, said in (
        (["diagnose", "none.h5", "-o", str(tmp_path / "a")], "none.h5: no such file"),
        (["diagnose", str(campaign), "-o", str(foreign)], "a robot's own file"),
        (["diagnose", str(campaign), str(other), "-o", str(tmp_path / "a")], "expected campaigns of one robot"),
        (["next", str(tmp_path)], "expected what ident diagnose wrote"),
        (
            ["simulate", str(ROOT / "robots/ypp3"), "--spacing", "0.3", "-o", str(tmp_path / "x.h5")],
            "divide the sampling",
        ),
        (["simulate", str(ROOT / "robots/ypp3"), "--periods", "1", "-o", str(tmp_path / "x.h5")], "2 or more"),
    ):
        assert main(arguments) == 2, arguments
        error = capsys.readouterr().err
        assert said in error and error.startswith("ident: ") and error.count("\n") == 1
    assert not (tmp_path / "a").exists() and not (tmp_path / "x.h5").exists()


def test_readme_shows_the_commands_and_the_table_that_there_are() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = readme.split("<!-- diagnose -->")[1].split("```")[1].strip().splitlines()
    errors = {"all": 0.33, "per_joint": {"joint1": 0.417}, "per_band": {}}
    verdict = {
        "status": "effect-found",
        "effects": [
            {
                "name": "input-delay",
                "joint": "joint1",
                "declared": False,
                "parameters": {},
                "rivals": [],
                "confounded_with": [
                    {"name": "time-offset", "joint": "joint1", "separate_by": "", "recipe": "link-sensor"}
                ],
            }
        ],
        "declared": {"joints": [], "drives": {"K": []}},
        "drives": {"K": {"value": [], "std": []}},
        "unexplained": [],
        "link_encoders": {},
        "notes": [],
        "inertia": {"J": {"change_rms": [[None]], "std_after": [[None]]}},
        "error": {
            "before": errors,
            "after": errors | {"all": 0.00112, "per_joint": {"joint1": 0.0012}},
            "noise_floor": 0.00134,
        }
        | {"noise_per_joint": {"joint1": 0.00143}, "noise_per_band": {}},
    }
    assert text(verdict).splitlines()[: len(shown)] == shown
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    effect = "--spacing 0.5 --periods 3 --effect input-delay:time=0.001@joint1"
    assert effect in readme and effect in makefile  # the numbers shown are those of make demo
