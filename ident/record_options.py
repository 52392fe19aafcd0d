"""The options of `cli` on how many records there are and how long they last, and what they make of a robot and its cells."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ident.errors import IdentError

if TYPE_CHECKING:
    from ident.identification.precision import Precision
    from symgen.plan import Cell, Model
    from symgen.robot import Robot


def add_target(sub: argparse.ArgumentParser) -> None:
    """Adds --target and --realisations."""
    sub.add_argument(
        "--target", type=_share, metavar="SHARE", help="the least robot time that tells J(q) to this standard deviation, relative "
        "to sqrt(J_ii J_jj), as 1%% or 0.01: spacing of the lines, and periods of each record",
    )  # fmt: skip
    sub.add_argument(
        "--realisations", type=int, default=1, metavar="M", help="records of each cell, the same lines in other phases (default 1): "
        "what they tell differently beyond noise is nonlinear distortion",
    )  # fmt: skip


def add_lengths(sub: argparse.ArgumentParser) -> None:
    """Adds --spacing and --periods."""
    sub.add_argument("--spacing", type=float, metavar="HZ", help="of the lines, in place of robot.toml's")
    sub.add_argument(
        "--periods",
        type=int,
        metavar="N",
        help="recorded, the settling ones included, likewise; more where transients last longer",
    )


def check(options: argparse.Namespace) -> None:
    """IdentError for options that contradict each other, or ask for no record."""
    for name in ("spacing", "periods"):
        if getattr(options, "target", None) and getattr(options, name, None):
            raise IdentError(f"--target does not go with --{name}, which it chooses")
    if getattr(options, "realisations", 1) < 1:
        raise IdentError(f"--realisations {options.realisations}: expected 1 or more")


def shortened(robot: Robot, options: argparse.Namespace) -> Robot:
    """Returns the robot with the line spacing and the periods of the command line, where given: what robot.toml may have."""
    from symgen.robot import MOST_SAMPLES, recordable

    e = robot.experiment
    f0, periods = getattr(options, "spacing", None), getattr(options, "periods", None)
    if f0 is not None:
        if not (e.fs / 2 > e.band[1] >= f0 > 0.0 and recordable(e.fs, f0)):
            raise IdentError(
                f"--spacing {f0:g}: expected Hz that divide the sampling rate of {e.fs:g} Hz, below {e.band[1]:g}, into "
                f"at most {MOST_SAMPLES:g} samples"
            )
        e = replace(e, f0=f0, band=(max(e.band[0], f0), e.band[1]))
    if periods is not None:
        if periods < 2:
            raise IdentError(f"--periods {periods}: expected 2 or more (at least one settles)")
        e = replace(e, periods=periods)
    if not recordable(e.fs, e.f0, e.periods):
        given = [f"--{name} {value:g}" for name, value in (("spacing", f0), ("periods", periods)) if value is not None]
        raise IdentError(
            f"{' '.join(given)}: {e.periods} periods of {e.fs / e.f0:g} samples each; expected a record of at most "
            f"{MOST_SAMPLES:g} samples"
        )
    return replace(robot, experiment=e)


def wanted(
    model: Model, robot: Robot, cells: Sequence[Cell], options: argparse.Namespace, lock: str = "dob"
) -> Precision | None:
    """Returns the campaign for the precision of --target; None where none is asked for."""
    if not options.target:
        return None
    from ident.identification.precision import for_target

    pairs = [(cell.joint, cell.q) for cell in cells]
    return for_target(
        model, robot, pairs, options.target, lock=lock, seed=options.seed, realisations=options.realisations
    )


def told(found: Precision, options: argparse.Namespace) -> dict[str, Any]:
    """Returns what was asked for and what is predicted, as JSON has it."""
    return {"target": options.target, "predicted": found.sigma, "robot_time_s": found.seconds}


def _share(text: str) -> float:
    """1% or 0.01, as a number."""
    try:
        value = float(text[:-1]) / 100 if text.endswith("%") else float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"found {text!r}; expected a share such as 1% or 0.01")
    return value
