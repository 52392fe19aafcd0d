"""--check tells files that are what symgen writes from files that are not; the options are remembered, paths are not."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from chains import REPOSITORY

from symgen.cli import main
from symgen.request import Request

URDF = REPOSITORY / "robots/ypp3/ypp3.urdf"


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tree as this repository's: robots/ypp3 and generated/ypp3."""
    root = tmp_path_factory.mktemp("tree")
    shutil.copytree(URDF.parent, root / "robots/ypp3")
    assert main([str(root / "robots/ypp3/ypp3.urdf"), "-o", str(root / "generated/ypp3"), "--no-verify"]) == 0
    return root


@pytest.fixture
def tree(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "tree"))


def checked(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    capsys.readouterr()
    status = main([str(word) for word in words])
    out, err = capsys.readouterr()
    return status, out + err


def test_what_symgen_wrote_is_found_the_same_and_left_alone(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tree / "generated/ypp3/plan.svg").write_text('<svg role="img" aria-label="Plan of ypp3"/>')  # as `draw` begins
    before = {path: path.read_bytes() for path in tree.rglob("*") if path.is_file()}
    status, said = checked(capsys, "--check", tree / "generated/ypp3")
    assert status == 0 and "11 files, all as symgen writes them" in said
    assert {path: path.read_bytes() for path in tree.rglob("*") if path.is_file()} == before


def edit(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(bytes(data))


def append(path: Path) -> None:
    path.write_bytes(path.read_bytes() + b"\n")


def crlf(path: Path) -> None:
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))


def crop(path: Path) -> None:
    document = json.loads(path.read_text())
    del document["plan"]["cells"][-1]
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")


def test_every_difference_is_one_line(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tree / "generated/ypp3"
    edit(folder / "J.casadi", 700)
    append(folder / "equations.md")
    crlf(folder / "equations.tex")
    crop(folder / "plan.json")
    (folder / "symgen_ypp3.h").unlink()
    (folder / "notes.txt").touch()
    (folder / "other.svg").write_text("<svg/>")
    (folder / "old").mkdir()
    status, said = checked(capsys, "--check", folder)
    assert status == 1
    expected = [
        "J.casadi: differs from line 1 on, byte 701 (of ",
        "equations.md: differs from line ",
        "equations.tex: differs in its line ends only",
        "notes.txt: not written by symgen",
        "old: not written by symgen",
        "other.svg: not written by symgen",
        "plan.json: differs from line ",
        "symgen_ypp3.h: missing",
    ]
    for line, start in zip(said.splitlines(), expected, strict=True):
        assert line.startswith(f"{folder}/{start}")
    status, said = checked(capsys, "--check", folder, "--json")
    document = json.loads(said)
    assert (status, document["same"], document["files"]) == (1, False, 11)
    assert [row["file"] for row in document["differences"]] == [start.partition(":")[0] for start in expected]


def test_files_of_a_urdf_that_has_changed_since_are_stale(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    urdf = tree / "robots/ypp3/ypp3.urdf"
    urdf.write_text(urdf.read_text().replace('mass value="7.4"', 'mass value="7.5"'))
    status, said = checked(capsys, "--check", tree / "generated/ypp3")
    assert status == 1 and "plan.json: stale: made for another URDF" in said and "alpha_cad.json: differs" in said


OPTIONS = [
    ["--grid", "15deg", "--spare", "1", "--no-feasible"],
    ["--triangular"],
    ["--no-believe-zeros", "--at", "joint1=0.5"],
    ["--postures"],
]


@pytest.mark.parametrize("options", OPTIONS, ids=lambda options: options[0])
def test_the_options_are_remembered_without_a_path(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = tmp_path / "mine.csv"
    cells.write_text("joint3,0,0,0\njoint2,0,0,0\n")
    short = options == ["--postures"]
    words = [URDF, "-o", tmp_path / "out", "--no-verify", *options, *([cells] if short else [])]
    assert checked(capsys, *words)[0] == (1 if short else 0)
    cells.unlink()
    assert checked(capsys, URDF, "--check", tmp_path / "out") == (
        0,
        f"{tmp_path / 'out'}: 11 files, all as symgen writes them for {URDF}\n",
    )
    assert not [
        p.name for p in (tmp_path / "out").iterdir() if str(tmp_path) in p.read_text() or str(URDF) in p.read_text()
    ]
    if options == ["--triangular"]:  # other options on the command line are what is compared with
        assert checked(capsys, URDF, "--check", tmp_path / "out", "--spare", "2", "--no-feasible")[0] == 1


def test_a_request_without_options_leaves_nothing_to_remember() -> None:
    assert Request().document() == {}
    assert Request(postures="elsewhere/mine.csv", spare=3).document() == {"postures": "plan.json", "spare": 3}


MISUSE = {
    "no such directory": (lambda d: shutil.rmtree(d), "no such directory; expected one that symgen -o wrote"),
    "no plan": (lambda d: (d / "plan.json").unlink(), "plan.json: no such file; expected a directory that symgen -o"),
    "no JSON": (lambda d: (d / "plan.json").write_text("{"), "plan.json: not a plan file: JSONDecodeError"),
    "a list": (lambda d: (d / "plan.json").write_text("[]"), "plan.json: not a plan file"),
    "odd options": (lambda d: (d / "plan.json").write_text('{"options": {"spare": "x"}}'), "options: 'spare' = 'x'"),
    "strange options": (lambda d: (d / "plan.json").write_text('{"options": {"rm": 1}}'), "options: 'rm' = 1"),
    "no URDF": (lambda d: shutil.rmtree(d.parents[1] / "robots"), "expected the URDF as an argument too"),
}


@pytest.mark.parametrize(("damage", "expected"), MISUSE.values(), ids=MISUSE)
def test_what_can_not_be_checked_is_refused_in_one_line(
    damage: Callable[[Path], object], expected: str, tree: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tree / "generated/ypp3"
    damage(folder)
    status, said = checked(capsys, "--check", folder)
    assert status == 2 and expected in said and said.count("\n") == 1


def test_check_writes_nothing_and_so_takes_no_output(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, said = checked(capsys, "--check", tree / "generated/ypp3", "-o", tree / "other")
    assert status == 2 and "-o" in said and not (tree / "other").exists()
