"""An identified arm as files that other programs read: CasADi, C, URDF, MJCF, robot.toml.

All files say the same: where no rigid links have the estimated constants, every one of them holds the nearest that some
have (`ident.identification.links`), and says how far that is from the estimate.
"""

from __future__ import annotations

import os
import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from ident.errors import IdentError
from ident.identification import identified as identified_arm
from ident.identification.identified import Identified, of_identification
from ident.identification.identify import Identification
from ident.identification.links import Links, nearest_links
from ident.identification.physical import pseudo_inertia
from ident.identification.robot_text import HEAD, one_line, robot_toml
from ident.identification.urdf_text import read_inertias, replace_inertias, xml_comment
from ident.records.campaign import Array
from symgen.chain import Chain, Inertia
from symgen.plan import source_of_J, write_J
from symgen.robot import Robot

#: Of what a link's identified inertia leaves for the links fixed to it, the share they get when they have to be scaled.
WELDED_SHARE = 0.99
#: A remainder smaller than this part of the whole is no body but rounding.
REMAINDER = 1e-6
#: Time step [s] of the MJCF: good for joints up to some 200 Hz.
STEP = 2.5e-4


def write_identified(
    identification: Identification, directory: str | Path, robot: Robot | None = None
) -> tuple[Path, ...]:
    """Writes everything about an identified arm into `directory`, made where missing; returns the paths.

    See `write_files`. `robot` is the robot directory the campaign was made with, where there is one: its encoders, torque
    limits and experiment go into robot.toml. Raises IdentError naming the file that can not be written.
    """
    return write_files(of_identification(identification, robot), directory)


def write_links(arm: Identified, links: Links, directory: str | Path) -> tuple[Path, ...]:
    """Writes what is known of an arm of which nothing but the `links` is: J.casadi, J.c and J.h, identified.urdf; see `write_files`."""
    texts = {**source_of_J(arm.model, links.alpha, arm.model.chain.name), "identified.urdf": urdf(arm, links)}
    return _placed(Path(directory), texts, lambda beside: write_J(arm.model, links.alpha, beside / "J.casadi"))


def write_files(arm: Identified, directory: str | Path) -> tuple[Path, ...]:
    """Writes the arm into `directory` and returns the paths: every file complete or not at all.

    J.casadi (q [n]) -> [n, n], J.c and J.h; identified.urdf, the declared one with identified inertias; identified.xml, the arm
    with its drives for MuJoCo; robot.toml, which makes of `directory` a robot directory; identified.json, from which all of
    them can be written again (`read`). Raises IdentError naming the file that can not be written.
    """
    directory, model = Path(directory), arm.model
    check_place(directory)
    links = nearest_links(model, arm.alpha, arm.covariance, arm.unseen)
    texts = {
        **source_of_J(model, links.alpha, model.chain.name),
        "identified.urdf": urdf(arm, links),
        "identified.xml": mjcf(arm, links),
        "robot.toml": robot_toml(arm, _closeness(links)),
    }

    def more(beside: Path) -> None:
        write_J(model, links.alpha, beside / "J.casadi")
        identified_arm.write(arm, beside / identified_arm.FILE)

    return _placed(directory, texts, more)


def _placed(directory: Path, texts: Mapping[str, str], more: Callable[[Path], None]) -> tuple[Path, ...]:
    """Puts files with these texts, and those that `more` writes into a directory that it is given, into `directory`: all or none."""
    beside = directory / f".identified.{os.getpid()}.part"
    target = directory
    try:
        beside.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            with (beside / name).open("w", encoding="utf-8", newline="") as file:
                file.write(text)
        more(beside)
        names = sorted(path.name for path in beside.iterdir())
        for name in names:
            target = directory / name
            os.replace(beside / name, target)
    except (OSError, RuntimeError) as error:  # CasADi raises the latter
        why = getattr(error, "strerror", None) or one_line(str(error))[:200]
        raise IdentError(f"{target}: cannot be written: {why}") from None
    finally:
        with suppress(OSError):
            shutil.rmtree(beside)
    return tuple(directory / name for name in names)


def check_place(directory: str | Path) -> None:
    """Raises IdentError where the files would replace a robot.toml that somebody else wrote."""
    file = Path(directory) / "robot.toml"
    try:
        foreign = file.is_file() and not file.read_bytes().startswith(HEAD.encode())
    except OSError as error:
        raise IdentError(f"{file}: cannot be read: {error.strerror}") from None
    if foreign:
        raise IdentError(
            f"{file}: a robot's own file, which the identified one would replace; choose another directory"
        )


def read(path: str | Path) -> Identified:
    """Returns the arm in a result's directory, or in its identified.json. IdentError if there is none."""
    path = Path(path)
    file = path / identified_arm.FILE if path.is_dir() else path
    if not file.is_file():
        raise IdentError(f"{file}: no such file; expected what ident fit wrote")
    return identified_arm.read(file)


def urdf(arm: Identified, links: Links) -> str:
    """Returns the declared URDF with the inertias of `links`; all else of it stays.

    What is fixed to a moving link keeps its inertia and the link gets the rest of theirs; where that would be no body, the
    fixed ones are scaled. The comment says which.
    """
    inertias = read_inertias(arm.urdf)
    bodies: dict[str, Inertia] = {}
    scaled: dict[str, float] = {}
    for k, joint in enumerate(arm.model.chain.joints):
        welded = [link for link, onto in arm.model.chain.lumped if onto == joint.link and inertias[link] is not None]
        found, own = links.parameters[k], inertias[joint.link]
        if welded:
            rest = joint.inertia.parameters - (own.parameters if own else 0.0)
            share = _share_left(found, rest)
            found = found - share * rest
            if share < 1.0:
                for link in welded:
                    body = inertias[link]
                    assert body is not None
                    bodies[link], scaled[link] = Inertia(share * body.mass, body.com, share * body.I), share
        bodies[joint.link] = Inertia.of(found)
    return replace_inertias(arm.urdf, bodies, _urdf_comment(arm, links, scaled))


def _share_left(whole: Array, rest: Array) -> float:
    """1 where whole - rest, ten parameters each, is a body; else the share of the rest that leaves one."""
    root = np.linalg.inv(np.linalg.cholesky(pseudo_inertia(whole)))
    largest = float(np.linalg.eigvalsh(root @ pseudo_inertia(rest) @ root.T)[-1])
    return 1.0 if largest < 1.0 - REMAINDER else WELDED_SHARE / largest


def _urdf_comment(arm: Identified, links: Links, scaled: Mapping[str, float]) -> str:
    chain = arm.model.chain
    lines = [
        "The declared robot with identified inertias.",
        f"Identified from: {one_line(arm.source)}.",
        _closeness(links),
        "J(q) shows only some combinations of the inertial parameters; the rest are those of least entropic divergence from",
        "the declared ones. Masses and centres of mass alone are therefore no measurements.",
        f"Changed: the inertial of {', '.join(joint.link for joint in chain.joints)}.",
    ]
    onto = {carrier for _, carrier in chain.lumped}
    if onto:
        lines.append(
            f"Links fixed to {', '.join(sorted(onto))} keep their inertia, their carrier holds what was identified of both"
            + (":" if scaled else ".")
        )
    lines += [f"  but {link} is scaled by {share:.6g}, or its carrier were no body." for link, share in scaled.items()]
    if chain.frozen:
        stand = ", ".join(f"{name} = {value:g}" for name, value in chain.frozen.items())
        lines.append(f"Frozen while identifying: {stand}.")
    if chain.snapped:
        names = ", ".join(sorted({snap.joint for snap in chain.snapped}))
        lines.append(f"Identified for exact angles at {names}; this file keeps its own, off by at most 1e-4 rad.")
    return "\n     ".join(lines)


def _closeness(links: Links) -> str:
    """How the links' constants relate to the estimate, in one line."""
    if links.exact:
        text = "The inertias have the estimated constants of J(q) exactly."
    elif links.ok:
        text = "The inertias have the constants of J(q) that were measured; along what was not, no body has the declared ones."
    else:
        text = (
            "No rigid bodies have the estimated constants of J(q); these have the nearest possible ones, "
            f"{links.distance:.3g} standard deviations away."
        )
    return " ".join((text, *links.status))


def identified_chain(chain: Chain, links: Links) -> Chain:
    """Returns the chain with the bodies of `links`."""
    joints = (
        replace(joint, inertia=Inertia.of(row)) for joint, row in zip(chain.joints, links.parameters, strict=True)
    )
    return replace(chain, joints=tuple(joints))


def mjcf(arm: Identified, links: Links) -> str:
    """Returns the arm with its drives as MJCF: per joint a motor joint and a spring joint on one body (`ident.simulator.plant`)."""
    from ident.simulator import plant

    chain = identified_chain(arm.model.chain, links)
    root = plant.mjcf(chain, arm.drives, arm.gravity, np.zeros(chain.n), range(chain.n), STEP, "RK4")
    root.set("model", chain.name)
    motors = root.iter("motor")
    for body, joint, drive in zip(root.iter("body"), chain.joints, arm.drives, strict=True):
        motor, spring = body.findall("joint")
        body.set("name", joint.link)
        motor.set("name", f"{joint.name}_motor")
        spring.set("name", f"{joint.name}_spring")
        if np.isfinite([joint.lower, joint.upper]).all():
            motor.attrib |= {"limited": "true", "range": f"{joint.lower!r} {joint.upper!r}"}
        limit = repr(drive.tau_max)
        next(motors).attrib |= {
            "name": joint.name,
            "joint": f"{joint.name}_motor",
            "ctrllimited": "true",
            "ctrlrange": f"-{limit} {limit}",
        }
    ET.indent(root)
    return f"{_mjcf_comment(arm, links)}\n{ET.tostring(root, encoding='unicode')}\n"


def _mjcf_comment(arm: Identified, links: Links) -> str:
    lines = [
        f"Arm with elastic joints, identified from: {one_line(arm.source)}.",
        _closeness(links),
        "Joint NAME of the URDF is two coaxial joints of one body: NAME_motor turns by motor angle / N and carries the rotor (armature",
        "N^2 J_m, damping N^2 D), NAME_spring turns by the deflection of the spring (K, D_spring); the link angle is their sum.",
        "The control NAME is the motor torque, motor side [N m]; its gear is N. Links fixed to a link are part of its body.",
    ]
    return xml_comment("\n     ".join(lines))
