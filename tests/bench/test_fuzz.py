"""symgen on broken URDFs: each one ends in a result that Pinocchio confirms, or in one line and exit status 2, soon and small."""

from __future__ import annotations

import json
import random
import re
import resource
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import FrameType
from xml.etree import ElementTree as ET

import pinocchio as pin
import pytest

from symgen.cli import main

REPOSITORY = Path(__file__).parents[2]
VENDORS = Path(pin.__file__).parents[4] / "share/example-robot-data/robots"
SOURCES = {
    "ypp3": REPOSITORY / "robots/ypp3/ypp3.urdf",
    "scara4": REPOSITORY / "robots/scara4/scara4.urdf",
    "ur5": VENDORS / "ur_description/urdf/ur5_robot.urdf",
    "panda": VENDORS / "panda_description/urdf/panda.urdf",
}

#: 16 mutants of the two small arms by turns, each accident at least once; a Panda's plan alone takes seconds.
QUICK = [4 * accident + accident % 2 for accident in range(16)]

SECONDS = 5  # of processor time, for one run of the command
MEGABYTES = 400  # by which the peak of the process may rise over all runs
ROUNDING = 1e-12  # J(q) against Pinocchio's, relative to the largest entry, on the arm as read
DROPPED = 1e-8  # what constants that hardly matter may cost in all, if the output says so; ten times that elsewhere
UNSAID = 1e-8  # against Pinocchio's own reading of the file: angles are rounded by 1e-9 rad without a word

# Accidents: text -> text or bytes -----------------------------------------------------------------------------------

Accident = Callable[[str, random.Random], str | bytes]

NUMBERS = [
    *("nan", "NaN", "inf", "-inf", "1e999", "1e308", "-1e308", "1e-320", "1e6", "-1e6", "1e-9", "0", "-0", "-1", "3.2"),
    *(
        "",
        " ",
        "0x10",
        "1_000",
        "1,5",
        "1e",
        "--1",
        "1 2",
        "${x}",
        "$(arg x)",
        "one",
        "\u0661",
        "1" * 500,
        "0." + "0" * 400 + "1",
    ),
]
NAMES = ["", " ", "\u00e9\u4e16", "a b", "../../etc/passwd", "&lt;b&gt;", "&#10;", "joint1", "x" * 10_000, "%s{0}"]
BOMBS = [
    '<!DOCTYPE r [<!ENTITY a "' + "a" * 100 + '">' + "".join(f'<!ENTITY {b} "{f"&{a};" * 100}">' for a, b in zip("abcdef", "bcdefg", strict=True)) + "]>",
    '<!DOCTYPE r [<!ENTITY g SYSTEM "file:///etc/passwd">]>',
    '<!DOCTYPE r [<!ENTITY g SYSTEM "http://127.0.0.1:9/">]>',
    '<!DOCTYPE r SYSTEM "file:///dev/random">',
    '<!DOCTYPE r [<!ENTITY % g SYSTEM "file:///etc/passwd"> %g;]>',
]  # fmt: skip
ENCODINGS = ["utf-16", "utf-16-le", "utf-32", "utf-8-sig", "latin-1", "cp1252", "utf-7", "cp037", "shift_jis"]


def cut(text: str, rng: random.Random) -> str:
    return text[: rng.randrange(len(text))]


def swapped_tags(text: str, rng: random.Random) -> str:
    """Two kinds of element trade names, everywhere or in one place."""
    one, two = rng.sample(sorted(set(re.findall(r"<(\w+)", text))), 2)
    swap = {one: two, two: one}
    if rng.random() < 0.5:
        return re.sub(rf"(</?)({one}|{two})\b", lambda m: m[1] + swap[m[2]], text)
    return re.sub(rf"<{one}\b", f"<{two}", text, count=1)


def attribute(text: str, rng: random.Random, values: list[str], pattern: str = r'"([^"<>]*)"') -> str:
    found = list(re.finditer(pattern, text))
    if not found:
        return text
    where = rng.choice(found)
    return text[: where.start(1)] + rng.choice(values) + text[where.end(1) :]


def odd_number(text: str, rng: random.Random) -> str:
    """One number becomes another, or none."""
    if rng.random() < 0.5:
        return attribute(text, rng, NUMBERS, r'[" ](-?\d[\d.e+-]*)')
    return attribute(
        text, rng, [f"{rng.uniform(-4, 4):.6g}", f"{10 ** rng.uniform(-12, 8):.3g}"], r'[" ](-?\d[\d.e+-]*)'
    )


def odd_name(text: str, rng: random.Random) -> str:
    names = re.findall(r'(?:name|link|joint|type)="([^"]*)"', text)
    return attribute(text, rng, [*NAMES, *names], r'(?:name|link|joint|type)="([^"]*)"')


def impossible_body(text: str, rng: random.Random) -> str:
    """Masses and moments negative, gone, or far from those of a body."""
    kind = rng.choice([r'mass\s+value="([^"]*)"', r'i[xyz]{2}="([^"]*)"'])
    for _ in range(rng.randint(1, 6)):
        text = attribute(text, rng, ["0", "-1", "1e-30", "1e5", "1e-6", "-0.001", f"{rng.random():.3g}"], kind)
    return text


def cycle(text: str, rng: random.Random) -> str:
    """A joint's child or parent becomes another link of the arm: circles, two parents, loose ends."""
    links = re.findall(r'<link\s+name="([^"]*)"', text)
    return attribute(text, rng, links, r'<(?:child|parent)\s+link="([^"]*)"')


def entity_bomb(text: str, rng: random.Random) -> str:
    body = text.partition("?>")[2] if text.startswith("<?xml") else text
    at = rng.choice([">", '"'])
    return rng.choice(BOMBS) + (body.replace(at, at + "&g;", 1) if rng.random() < 0.5 else body)


def wrong_encoding(text: str, rng: random.Random) -> bytes:
    declared = rng.choice([*ENCODINGS, "utf-8", "unicode_escape", "zip", "rot13"])
    text = re.sub(r"<\?xml[^>]*\?>", "", text)
    text = f'<?xml version="1.0" encoding="{declared}"?>' + text.replace("joint", "j\u00f6int")
    return text.encode(rng.choice(ENCODINGS), "replace")


def elements(text: str, rng: random.Random) -> str:
    """Up to three elements at any depth are lost, doubled, or moved elsewhere, with all that is in them."""
    root = ET.fromstring(text)
    for _ in range(rng.randint(1, 3)):
        inside = [(parent, child) for parent in root.iter() for child in parent]
        if not inside:
            break
        (parent, child), kind = rng.choice(inside), rng.randrange(4)
        if kind != 1:
            parent.remove(child)
        if kind:
            home = parent if kind < 3 else rng.choice([root, *(e for e, _ in inside if e not in child.iter())])
            home.insert(rng.randint(0, len(home)), child)
    return ET.tostring(root, encoding="unicode")


def flipped_bytes(text: str, rng: random.Random) -> bytes:
    data = bytearray(text.encode())
    for _ in range(rng.choice([1, 1, 2, 5, 50])):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def other_arm(text: str, rng: random.Random) -> str:
    """Sound XML, another arm: joints of another type, bent axes and origins, narrow or absent limits."""
    for _ in range(rng.randint(1, 3)):
        kind = rng.randrange(4)
        if kind == 0:
            types = ["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "screw"]
            text = attribute(text, rng, types, r'<joint[^>]*type="([^"]*)"')
        elif kind == 1:
            triple = " ".join(f"{rng.uniform(-2, 2):.4g}" for _ in range(3))
            text = attribute(text, rng, [triple, "0 0 0", "1e-12 0 0", "1 1e-5 0"], r'(?:xyz|rpy)="([^"]*)"')
        elif kind == 2:
            text = attribute(text, rng, ["0", "-1e-9", "1e-9", "1e5", "-1e5", "6.3"], r'(?:lower|upper)="([^"]*)"')
        else:
            text = re.sub(r"<(limit|axis|inertial|origin)\b[^>]*/>", "", text, count=rng.randint(1, 20))
    return text


def misaligned(text: str, rng: random.Random) -> str:
    """A calibrated arm: every joint's axis is off by some 0.1 to 10 mrad, as measured ones are."""
    size = 10 ** rng.uniform(-4, -2)

    def tilted(joint: re.Match[str]) -> str:
        angles = (float(word) + rng.gauss(0, size) for word in joint[2].split())
        return joint[1] + " ".join(f"{angle:.9f}" for angle in angles)

    return re.sub(r'(<joint\b(?:(?!</joint>).)*?<origin[^>]*?rpy=")([^"]*)', tilted, text, flags=re.DOTALL)


def bulk(text: str, rng: random.Random) -> str:
    """Much of something: depth, links, joints in a row, a long name, a comment."""
    kind, many = rng.randrange(5), rng.choice([70, 1000, 20_000])
    head, end = text.rsplit("</robot>", 1)[0], "</robot>"
    if kind == 0:
        return head + "<a>" * many + "</a>" * many + end
    if kind == 1:
        return head + "".join(f'<link name="extra{k}"/>' for k in range(many)) + end
    if kind == 2:
        return head + f"<!-- {'x' * 100 * many} -->" + end
    if kind == 3:
        return head.replace('name="', f'name="{"x" * 10 * many}', 1) + end
    body = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
    first = re.findall(r'<link\s+name="([^"]*)"', text)[-1]
    chain = [first, *(f"more{k}" for k in range(min(many, 1000)))]
    joints = (
        f'<link name="{child}">{body}</link><joint name="to_{child}" type="{rng.choice(["fixed", "revolute"])}">'
        f'<parent link="{parent}"/><child link="{child}"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for parent, child in pairwise(chain)
    )
    return head + "".join(joints) + end


ACCIDENTS: tuple[Accident, ...] = (
    cut, swapped_tags, odd_number, odd_number, odd_name, impossible_body, cycle, entity_bomb, wrong_encoding, elements,
    flipped_bytes, other_arm, other_arm, misaligned, bulk,
)  # fmt: skip


def mutant(seed: int) -> tuple[str, str, bytes]:
    """The seed's mutant: source, accident and content. All kinds of accident befall all sources in turn."""
    rng = random.Random(seed)
    source = list(SOURCES)[seed % len(SOURCES)]
    accident = ACCIDENTS[seed // len(SOURCES) % len(ACCIDENTS)]
    text = accident(SOURCES[source].read_text(encoding="utf-8"), rng)
    return source, accident.__name__, text if isinstance(text, bytes) else text.encode()


# The command ---------------------------------------------------------------------------------------------------------


class _TooLong(BaseException):  # no Exception: nothing in the command may catch it
    pass


@contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Ends what is inside after that many seconds of processor time, or six times as many on the clock."""

    def ring(signum: int, frame: FrameType | None) -> None:
        raise _TooLong

    before = {number: signal.signal(number, ring) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(
        signal.ITIMER_PROF, seconds
    )  # the clock alone would blame a busy machine's other programs on symgen
    signal.alarm(6 * seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass(frozen=True)
class Run:
    """What one mutant came to: "result", "refused", or what went wrong in words; and its processor time [s]."""

    source: str
    accident: str
    outcome: str
    seconds: float


def run(seed: int, folder: Path, capfd: pytest.CaptureFixture[str], *options: str) -> Run:
    """One run of symgen with `options` on the seed's mutant in the empty `folder`; every seventh writes its output, too."""
    source, accident, content = mutant(seed)
    file, out = folder / "arm.urdf", folder / "out"
    file.write_bytes(content)
    arguments = [str(file), "--json", *options, *(["-o", str(out)] if seed % 7 == 0 else [])]
    start = time.process_time()
    try:
        with limited(SECONDS):
            status: object = main(arguments)
    except _TooLong:
        status = f"no end after {SECONDS} s"
    except Exception as error:  # noqa: BLE001 (whatever escapes is what this test is for)
        status = f"{type(error).__name__}: {error}"
    seconds = time.process_time() - start
    printed = capfd.readouterr()
    left = sorted(path.name for path in folder.iterdir() if path != file)
    robot = re.search(rb'<robot[^>]*name="([^"]*)"', content)
    where = (str(file), robot[1].decode(errors="replace") if robot else "arm")  # of the file, or of its arm
    outcome = _judged(status, printed.out, printed.err, where, left)
    for path in (*out.glob("*"), file):
        path.unlink()
    if out.is_dir():
        out.rmdir()
    return Run(source, accident, outcome, seconds)


def _judged(status: object, out: str, err: str, where: tuple[str, ...], left: list[str]) -> str:
    if status == 2:
        if out or left:
            return f"refused, but printed {out[:40]!r} and left {left}"
        named = err.startswith(tuple(f"symgen: {place}: " for place in where))
        if not named or len(err.splitlines()) != 1 or len(err) > 1500 or "report this robot" in err:
            return f"not one clear line: {err[:300]!r}"
        return "refused"
    if status != 0:
        return str(status)
    document = json.loads(out)
    verified = document["verified"]
    cost = document.get("dropped", {"cost": 0.0})["cost"]
    if not (verified["relative_error"] <= ROUNDING + 10 * cost and cost <= DROPPED):
        return f"J(q) is off by {verified['relative_error']}, of which the output says {cost}"
    as_written = verified["relative_error_to_file_as_written"]  # None: Pinocchio does not read this file
    if as_written is not None and as_written > UNSAID and not document["snapped"]:
        return f"J(q) is off by {as_written} from Pinocchio's own reading of the file, and nothing was snapped"
    if document["plan"]["measurements"] != document["shared_rank"] or set(left) - {"out"}:
        return "a plan or an output that is not whole"
    return "result"


def all_runs(seeds: Sequence[int], folder: Path, capfd: pytest.CaptureFixture[str], *options: str) -> list[Run]:
    main([str(SOURCES["ypp3"]), "--json"])  # imports are not charged to the first mutant
    capfd.readouterr()
    before = _peak_megabytes()
    runs = [run(seed, folder, capfd, *options) for seed in seeds]
    risen = _peak_megabytes() - before
    wrong = [(seed, one) for seed, one in zip(seeds, runs, strict=True) if one.outcome not in ("result", "refused")]
    with capfd.disabled():
        if len(seeds) > 100:
            _print(runs, risen)
        for seed, one in wrong:
            print(f"\nseed {seed}, {one.source}, {one.accident}: {one.outcome}", end="")
    assert not wrong
    assert risen < MEGABYTES
    return runs


def _peak_megabytes() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def _print(runs: list[Run], risen: float) -> None:
    print(f"\n{'accident':<18}{'runs':>6}{'results':>9}{'refused':>9}{'wrong':>7}{'worst s':>9}")
    for name in dict.fromkeys([*(accident.__name__ for accident in ACCIDENTS), "all"]):
        own = [one for one in runs if name in (one.accident, "all")]
        count = Counter(one.outcome for one in own)
        wrong = len(own) - count["result"] - count["refused"]
        worst = max(one.seconds for one in own)
        print(f"{name:<18}{len(own):>6}{count['result']:>9}{count['refused']:>9}{wrong:>7}{worst:>9.2f}")
    print(f"{sum(one.seconds for one in runs):.0f} s in all; peak memory rose by {risen:.0f} MB")


def test_16_broken_urdfs_end_in_a_confirmed_result_or_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    runs = all_runs(QUICK, tmp_path, capfd, "--draft")  # how good a plan is, is no matter here
    assert {one.accident for one in runs} == {accident.__name__ for accident in ACCIDENTS}
    count = Counter(one.outcome for one in runs)
    assert min(count["result"], count["refused"]) >= 4, "both happen, so that neither half of the test is idle"


@pytest.mark.bench
def test_2000_broken_urdfs_end_in_a_confirmed_result_or_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    all_runs(range(2000), tmp_path, capfd)
