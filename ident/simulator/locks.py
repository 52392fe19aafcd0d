"""How the joints of a record are held: the stiffest lock of those that are safe on the declared robot, and what to do where none is."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import inf

import numpy as np

from ident.errors import ExperimentError
from ident.simulator.dob import (
    HOLD_REMEDY,
    LOCK_DAMPING,
    ClosedLoop,
    Margins,
    Servo,
    check_stable,
    close_loop,
    hold_servo,
    lock_servo,
    margins,
)
from ident.simulator.plant import Linear, Plant
from symgen.robot import Experiment

#: Locks are tried as declared, then softer, until no motor's loop comes nearer to -1 than `DISTANCE` and each bears `DELAY`
#: samples of delay: (share of the PD's bandwidth, observer on). PD alone is stable at any bandwidth far below the sampling
#: rate. 0.25 leaves 14 deg of phase and bears a gain wrong by 20 % downwards, 33 % upwards, the true arm being off by as much.
#: A controller that reads, computes and acts at the next sample is late by one; half of one more is for its amplifier.
SOFTER = ((1.0, True), (0.7, True), (0.5, True), (1.0, False), (0.5, False), (0.25, False))
#: Of small rotors under large links an observer is unstable (see `LOCK_DAMPING`), a soft PD lets gravity push a link away, and the rotor
#: swings on the spring: where none of the above is safe, PDs of twice the damping are tried without an observer, stiffer ones first.
STIFFER, DAMPED = (1.0, 2.0, 3.0, 4.0, 8.0, 0.5, 0.25), 2.0
DISTANCE, DELAY = 0.25, 1.5


@dataclass(frozen=True)
class _Lock:
    """How joints are held: a PD of bandwidth `pd` [Hz] and damping ratio `damping`, an observer of `dob` [Hz, 0: none]."""

    pd: float
    dob: float
    damping: float = LOCK_DAMPING

    def __str__(self) -> str:
        damped = "" if self.damping == LOCK_DAMPING else f" of damping {self.damping:g}"
        return f"PD {self.pd:.3g} Hz{damped}, {f'observer of {self.dob:g} Hz' if self.dob else 'no observer'}"


def locked(
    plant: Plant, linear: Linear, e: Experiment, excited: int, sags: float, where: str
) -> tuple[ClosedLoop, tuple[Servo, ...], Margins, str]:
    """The declared plant under a soft hold of the excited joint, which `sags` as far at most if that is safe, and the stiffest lock of
    the others that is; where none is, one that is more damped.

    ExperimentError where none is; the note says what was changed.
    """
    several, sampled = len(plant.live) > 1, linear.sampled(1 / e.fs)
    softer = [_Lock(share * e.lock_pd, e.lock_dob if observed else 0.0) for share, observed in SOFTER]
    damped = [_Lock(share * e.lock_pd, 0.0, DAMPED) for share in STIFFER]
    first, steady = "", []
    tried: list[tuple[float, _Lock, ClosedLoop, Margins | None]] = []
    for locks in (softer, damped) if several else (softer[:1],):
        for sinks, lock in product((sags, inf), locks):
            try:
                servos = _servos(plant, linear, excited, sinks, lock)
            except ExperimentError as error:
                raise ExperimentError(f"{where}: {error}") from None
            loop = close_loop(*sampled, servos, 1 / e.fs)
            found = margins(loop) if loop.growth < 0 else None
            lacking = _lacking(found, e.fs)
            tried.append((found.distance if found else -loop.growth, lock, loop, found))
            if found is not None and found.distance >= DISTANCE:
                eased = "hold softened, lock" if sinks > sags else "lock softened to" if locks is softer else "lock"
                steady.append((loop, servos, found, f"{eased} {lock}: {first}" if first else ""))
                if not lacking:
                    return steady[-1]
            first = first or f"as declared it {lacking}"
        if steady:  # so slow a sampling that none bears a late torque
            loop, servos, found, note = max(steady, key=lambda one: one[2].delay)
            late = f"the {'best lock' if several else 'hold'} {_lacking(found, e.fs)}: raise the sampling rate"
            return loop, servos, found, "; ".join(filter(None, (note, late)))
    _, lock, loop, found = max(tried, key=lambda one: one[0])
    if several:
        raise ExperimentError(f"{where}: no lock is safe: {_unsafe(plant, linear, e, excited, lock, loop, found)}")
    check_stable(loop, where)
    raise ExperimentError(f"{where}: its hold is not safe: it {_lacking(found, e.fs)}; {HOLD_REMEDY}")


def _unsafe(
    plant: Plant, linear: Linear, e: Experiment, excited: int, lock: _Lock, loop: ClosedLoop, found: Margins | None
) -> str:
    """What the best lock tried lacks, what gravity has to do with it, and what helps: nothing that was tried and is worse."""
    rate = "" if found else f" (growth rate {loop.growth:+.3g} 1/s, expected < 0)"
    told, too_soft = f"the best one tried, {lock}, {_lacking(found, e.fs)}{rate}", lock.pd == max(STIFFER) * e.lock_pd
    gravity = np.diag(linear.gravity_stiffness([plant.drives[k].K for k in plant.live]))
    for k, dG in zip(plant.live, gravity, strict=True):
        drive = plant.drives[k]
        holds, stiffest = (
            drive.N**2 * lock_servo(drive.J_m, share * e.lock_pd, 0.0).kp for share in (1.0, max(STIFFER))
        )
        if k != excited and -dG >= holds:
            unit = "N/m" if drive.linear else "N m/rad"
            told += f", and gravity pushes {drive.joint!r} away with {-dG:.3g} {unit}, a PD of {e.lock_pd:g} Hz on its rotor holds {holds:.2g}"
            too_soft = too_soft or -dG >= stiffest
    too_stiff = lock.pd == min(STIFFER) * e.lock_pd
    way = "raise lock_pd_Hz, " if too_soft else "lower lock_pd_Hz, " if too_stiff else ""
    return f"{told}; {way}raise the sampling rate, check J_m_kgm2, another posture, or --lock rigid where brakes hold"


def _lacking(found: Margins | None, fs: float) -> str:
    """What a loop with these margins, None if it is unstable, lacks to be safe at `fs` [Hz]; empty where nothing."""
    if found is None:
        return "is unstable"
    if found.distance < DISTANCE:
        return f"is {found.distance:.2f} from instability, allowed {DISTANCE:g}"
    if found.delay * fs < DELAY:
        return f"bears a delay of {found.delay * fs:.2f} samples, expected {DELAY:g}"
    return ""


def _servos(plant: Plant, linear: Linear, excited: int, sags: float, lock: _Lock) -> tuple[Servo, ...]:
    drives = [plant.drives[k] for k in plant.live]
    gravity = np.diag(linear.gravity_stiffness([drive.K for drive in drives]))
    servos = []
    for k, drive, J, dG in zip(plant.live, drives, np.diag(linear.link_inertia), gravity, strict=True):
        if k == excited:
            inertia, damping = float(J) + drive.N**2 * drive.J_m, drive.N**2 * drive.D
            bears = drive.N * float(plant.preload[k])
            servos.append(hold_servo(drive.N, inertia, float(dG), damping, drive.K, bears, sags))
        else:
            servos.append(lock_servo(drive.J_m, lock.pd, lock.dob, lock.damping))
    return tuple(servos)
