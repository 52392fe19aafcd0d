"""What an engineer must know before using an identified J(q): problems with reason and remedy, what stays unknown."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.arm.coupled import CoupledFit
from ident.identification.identify import OF_TWO_MASSES, Identification, Measurement
from ident.identification.modal import anti_resonances
from ident.identification.physical import Consistency
from ident.joint.certainty import certainty, thin
from ident.joint.drive import SharedDrive
from ident.joint.fit import UNTOLD
from ident.records.campaign import Array
from ident.records.resting import statuses

#: An anti-resonance that carries less than this share of J_ii leaves no visible pair in the response of motor i.
VISIBLE_MODE = 0.01
#: A fit that misses a clear line by more than this share has the wrong shape, not only small errors.
GROSS_MISFIT = 0.2
#: A line is clear when it stands this many standard deviations out of the noise.
CLEAR = 10.0
#: Friction shows below, springs show above.
BANDS = {"below 5 Hz": (0.0, 5.0), "above 5 Hz": (5.0, np.inf)}
#: Constants that bodies can not have, but this close to such: the noise of the measurement explains it.
NOISE_DISTANCE = 3.0
#: What to do about the consequences of records that are not explained.
FIRST = "Remove the causes above first: one biased record is enough for this."
#: Lines of one kind that are listed; the notes have all.
LISTED = 6
#: Where what is missing is looked for.
NEXT = "ident diagnose CAMPAIGN.h5 -o DIR"
#: Significant digits of a number, at most, however well it is known.
MOST_DIGITS = 9
#: Motion of a held motor relative to the excited one, both joint side, that is worth telling.
VISIBLE_MOTION = 0.01


@dataclass(frozen=True)
class Problem:
    """`what` is wrong, `why` with numbers, and the `remedy`; `serious`: part of the result is not to be used."""

    serious: bool
    what: str
    why: str
    remedy: str


def entry(i: int, j: int, n: int) -> str:
    """The name of J_ij of an arm with n joints; i and j from 0."""
    return f"J_{i + 1}{j + 1}" if n < 10 else f"J_{i + 1}_{j + 1}"


def problems(identification: Identification) -> tuple[Problem, ...]:
    """Returns what stands against the result, the serious first; empty when all is well."""
    r = identification
    found = [
        Problem(True, fault.name.capitalize(), f"{fault.line}.", "Correct it and fit again.") for fault in r.faults
    ]
    for joint in dict.fromkeys(m.record.excited for m in r.measurements):
        own = [m for m in r.measurements if m.record.excited == joint]
        if r.coupled is None and not all(m.explained for m in own):
            found.append(_unexplained(r, joint, own))
    if r.coupled is not None and not r.coupled.explained:
        found.append(_coupled_unexplained(r.coupled))
    poor = {m.record.excited for m in r.measurements if not m.explained}
    found += [_different_drives(drive) for drive in r.drives if not drive.agrees and drive.joint not in poor]
    untold = [m for m in r.measurements if m.explained and m.std > UNTOLD * abs(m.J)]
    for joint in dict.fromkeys(m.record.excited for m in untold):
        found.append(_untold([m for m in untold if m.record.excited == joint], r))
    if not r.alpha.agrees:
        found.append(_contradiction(r, bool(poor)))
    if not r.consistency.ok:
        found.append(_impossible_bodies(r.consistency, bool(poor)))
    doubts = statuses(r.campaign.joints, [m.frf for m in r.measurements])
    if doubts:
        more = f"; and {len(doubts) - LISTED} more, see the notes" if len(doubts) > LISTED else ""
        why = "; ".join(doubts[:LISTED]) + more + "."
        found.append(Problem(False, "Some records are doubtful", why, "Record these again, or correct their postures."))
    return tuple(sorted(found, key=lambda problem: not problem.serious))


def _untold(those: Sequence[Measurement], r: Identification) -> Problem:
    """What records of one joint do not tell of its J_ii, though they fit; of a joint that nothing shows to be elastic, why."""
    m, name = those[0], entry(those[0].index, those[0].index, r.campaign.n)
    ids = ", ".join(one.record.id for one in those)
    who = f"Records {ids} do" if len(those) > 1 else f"Record {ids} does"
    drive = next(drive for drive in r.drives if drive.joint == m.record.excited)
    if all(x.std > UNTOLD * x.value for x in (drive.K, drive.J_m)):
        return Problem(
            True,
            f"{who} not tell {name}",
            f"{drive.joint} is as good as rigid here: motor and links move together, and only N² J_m + {name} is seen.",
            f"Take J_m of {drive.joint} off the sum, from its datasheet; or widen the band to its resonance.",
        )
    return Problem(
        True,
        f"{who} not tell {name}",
        f"It reads {_told(m.J, m.std)}: the model fits, because next to nothing is there to contradict it.",
        "Excite more, widen the band, or record more periods; check that the motor moved at all.",
    )


def _coupled_unexplained(fit: CoupledFit) -> Problem:
    chi2, limit = number(fit.chi2_per_dof), number(fit.chi2_limit)
    others = [line for line in fit.status if "chi2/dof" not in line]
    return Problem(
        True,
        "The arm as modelled does not explain the records",
        "; ".join((f"χ²/dof over all records and motors is {chi2}, noise allows {limit}", *others)) + ".",
        "Something is missing that rigid links, joint springs, viscous damping and gravity do not hold: friction, backlash, a "
        f"soft base, a delay. Find it by: {NEXT}. The misfit below the responses shows where in frequency.",
    )


def _different_drives(drive: SharedDrive) -> Problem:
    return Problem(
        True,
        f"{drive.joint}: its records want different drives",
        f"One K and one J_m for all its records miss them by χ²/dof {number(drive.chi2 / drive.dof)}; K scatters by "
        f"{number(drive.K.spread)}, J_m by {number(drive.J_m.spread)}. K and J_m do not change with the posture: "
        "something in the model does.",
        "Each record keeps its own reading. Look for what two masses lack: other springs, friction, an amplitude that "
        "differs between records.",
    )


def _contradiction(r: Identification, follows: bool) -> Problem:
    worst = r.measurements[int(np.argmax(np.abs(r.alpha.standardised)))].record.id
    return Problem(
        True,
        "The measured J_ii contradict each other",
        f"No constants of this arm give all of them: χ² {number(r.alpha.chi2)} for {r.alpha.dof} degrees of freedom; "
        f"record {worst} is furthest from what the others predict.",
        FIRST
        if follows
        else "Check the posture and the joint zero of that record, a payload or tool the URDF lacks, and zeros that are "
        "believed but not true.",
    )


def _impossible_bodies(found: Consistency, follows: bool) -> Problem:
    serious = found.distance > NOISE_DISTANCE
    nearest = f"The nearest constants that bodies can have are {number(found.distance, 2)} standard deviations away"
    cause = "Some record carries a bias, or the URDF's geometry is wrong."
    if not serious:
        cause = "Noise explains that: measure more, or use them as they are."
    elif follows:
        cause = FIRST
    return Problem(
        serious,
        "No rigid bodies have these constants",
        "; ".join((nearest, *found.status)) + ".",
        "The matrix of the estimate may lose positive definiteness, so J.casadi, identified.urdf and the other files of the "
        f"robot hold the nearest ones. {cause}",
    )


def _unexplained(r: Identification, joint: str, own: list[Measurement]) -> Problem:
    """Two masses, or modes, do not explain records of `joint`: by how much, and what the declared arm and the data say of why."""
    poor = [m for m in own if not m.explained]
    worst = max(poor, key=lambda m: m.chi2_per_dof)
    two, name = r.method in OF_TWO_MASSES, entry(worst.index, worst.index, r.campaign.n)
    miss, where = misfit(worst)
    modes, others, bent = held_modes(r, worst), held_motion(r, worst), distorted(worst)
    reasons = [
        f"χ²/dof is {number(worst.chi2_per_dof)} in record {worst.record.id}, noise allows {number(worst.chi2_limit)}.",
        f"The fit misses the response by up to {number(100 * miss, 2)} %, at {number(where)} Hz.",
    ]
    if len(modes) > 1 and two:
        reasons.append(
            "However well the other motors are held, their springs give: K and the declared J(q) put the "
            f"anti-resonances that this motor sees at {_and(modes)} Hz, and two masses have only one."
        )
    if others > VISIBLE_MOTION and two:
        reasons.append(f"Held motors moved up to {number(100 * others, 2)} % as much as the excited one.")
    if bent:
        reasons.append(
            f"Lines that were not excited answer above the noise ({', '.join(bent)}): it is not quite linear."
        )
    remedy = (
        "A stiffer lock is not enough. Fit all joints together (--method coupled), or hold the others on their link side."
        if two and (len(modes) > 1 or others > VISIBLE_MOTION)
        else f"Look at the misfit below the response: where it is large tells what is missing. Find it by: {NEXT}."
    )
    trust = "is not to be trusted" if miss > GROSS_MISFIT else "is further off than noise explains"
    what = f"{'Two masses' if two else 'The modes found'} do not explain {joint} in {len(poor)} of {len(own)} records: {name} {trust}"
    return Problem(True, what, " ".join(reasons), remedy)


def _and(values: Array) -> str:
    *first, last = (number(value) for value in values)
    return f"{', '.join(first)} and {last}"


def misfit(m: Measurement) -> tuple[float, float]:
    """Returns the largest |G - fit| / |G| over the lines that stand out of the noise, and its frequency [Hz]."""
    frf = m.frf
    off = np.abs(frf.G - m.G_model)
    clear = frf.usable & (np.abs(frf.G) > CLEAR * np.sqrt(frf.variance))
    relative = np.where(clear, off / np.abs(frf.G), 0.0)
    return float(relative.max()), float(frf.frequencies[np.argmax(relative)])


def held_modes(identification: Identification, m: Measurement) -> Array:
    """Returns the anti-resonances [k, Hz] of the declared arm at the excited motor, as `anti_resonances` has them.

    Those that carry a visible share of J_ii; empty where K or J is not known.
    """
    c = identification.campaign
    K = c.K.copy()
    for drive in identification.drives:
        k = c.joints.index(drive.joint)
        if not np.isfinite(K[k]):
            K[k] = drive.K.value
    f, share = anti_resonances(m.frf, identification.model.J_cad(m.frf.posture), K)
    return f[share > VISIBLE_MODE][::-1]


def held_motion(identification: Identification, m: Measurement) -> float:
    """Returns the largest rms motion of a held motor over the lines, relative to the excited one's, joint side."""
    moved = np.sqrt(np.sum(np.abs(m.frf.theta / identification.campaign.N) ** 2, axis=0))
    others = np.delete(moved, m.index)
    return float(others.max() / moved[m.index]) if others.size else 0.0


def distortion(m: Measurement, low: float = 0.0, high: float = np.inf) -> dict[str, float | None]:
    """Returns the rms levels at "even" and "odd" lines in [low, high] Hz that were not excited, and of their "noise".

    Relative to the excited lines; zero where nothing stands out of the noise, None where there are no such lines.
    """
    d, i = m.frf.detection, m.index
    band = (d.frequencies >= low) & (d.frequencies <= high)
    levels: dict[str, float | None] = {
        kind: float(d.distortion(odd, low, high)[i]) if (band & (d.odd == odd)).any() else None
        for kind, odd in (("even", False), ("odd", True))
    }
    return levels | {"noise": float(np.sqrt(np.mean(d.noise[band, i] ** 2))) if band.any() else None}


def distorted(m: Measurement) -> list[str]:
    """Returns where distortion stands out of the noise, in words."""
    levels = {name: distortion(m, *band) for name, band in BANDS.items()}
    return [f"{kind} lines {name}" for name in BANDS for kind in ("even", "odd") if levels[name][kind]]


def number(value: float | None, digits: int = 3) -> str:
    """The value with that many significant digits, an exponent only where zeros take over; a dash for no value."""
    if value is None or not np.isfinite(value):
        return "–"
    text = f"{value:.{digits}g}"
    if 1e-4 <= abs(value) < 1e6:
        text = f"{float(text):.12f}".rstrip("0").rstrip(".")
    return re.sub(r"e([+-])0*(\d+)", lambda e: "e" + e[1].strip("+") + e[2], text).replace("-", "−")


def within(value: float | None, std: float | None) -> str:
    """The value to the second digit of its standard deviation, with an exponent where zeros would take over; to six without one."""
    if value is None or std is None or not np.isfinite(value) or not np.isfinite(std) or std <= 0.0:
        return number(value, 6)
    first = int(np.floor(np.log10(max(abs(value), std))))
    last = max(int(np.floor(np.log10(std))) - 1, first - MOST_DIGITS + 1)
    if -3 <= first < 6:
        text, power = f"{round(value, -last) + 0.0:.{max(-last, 0)}f}", ""
    else:
        text, power = f"{round(value / 10.0**first, first - last) + 0.0:.{max(first - last, 0)}f}", f"e{first}"
    return (text + power if float(text) else "0").replace("-", "−")


def not_identifiable(identification: Identification) -> list[dict[str, str]]:
    """Returns {what, why, remedy} for everything these records do not tell: constants, readings, off-diagonals."""
    r = identification
    found: list[dict[str, str]] = []

    def add(what: str, why: str, remedy: str) -> None:
        found.append({"what": what, "why": why, "remedy": remedy})

    names = r.model.names
    shown = r.alpha_std[: r.model.d] if r.coupled is None else r.alpha_std
    open_names = [name for name, std in zip(names, shown, strict=False) if not np.isfinite(std)]
    if open_names:
        add(
            ", ".join(open_names),
            "no combination of these records determines it; CAD's along what none shows",
            "measure more postures: symgen plans them",
        )
    for row in filter(None, map(_reading, r.measurements)):
        add(*row)
    *poor, direction = thin(certainty(r.model, r.covariance, r.unseen)) or ("",)
    for line in poor:
        what, why = line.split(" hardly known: ")
        add(f"{what}, closely", why, f"{direction}; or excite more, record more periods")
    for drive in r.drives:
        for name, value in (("K", drive.K), ("J_m", drive.J_m)):
            if value.std > UNTOLD * value.value:
                remedy = "excite more, record more periods or a wider band"
                add(f"{name} of {drive.joint}", _told(value.value, value.std), remedy)
    groups: dict[tuple[int, int], list[str]] = {}
    for alpha in r.model.factoring.alphas[r.model.d :] if r.coupled is None else ():
        groups.setdefault((alpha.i, alpha.j), []).append(alpha.name)
    for (i, j), members in groups.items():
        add(
            ", ".join(members),
            f"only off-diagonals show it, {entry(i, j, r.campaign.n)} first; no J_ii does; held at CAD",
            f"measure the cross response {i + 1} -> {j + 1} at {len(members)} postures",
        )
    return found


def _reading(m: Measurement) -> tuple[str, str, str] | None:
    """What a record does not tell of J_ii, or not directly; None where it does."""
    (name, reason, remedy), where = _band(m), f"of {m.record.excited}, record {m.record.id}"
    if m.std > UNTOLD * abs(m.J):
        ratio = f"J/(N² J_m) is {number(m.inertia_ratio, 2)}"
        why = "; ".join(filter(None, (_told(m.J, m.std), ratio, reason)))
        return f"J_l {where}", why, remedy or "excite more, record more periods, or measure K elsewhere"
    if reason:
        share = number(100 * m.std / abs(m.J), 2)
        why = f"{reason}; the shape of the response inside it tells J_l to {share} % by noise alone"
        return f"{name} {where}, directly", why, remedy
    return None


def _told(value: float, std: float) -> str:
    return f"{number(value)} with {f'a standard deviation of {number(std, 2)}' if np.isfinite(std) else 'no bound'}"


def _band(m: Measurement) -> tuple[str, str, str]:
    """Which of f_AR and f_R lies outside the band, by how much, and what helps; empty when both are inside."""
    if m.method not in OF_TWO_MASSES or m.two_mass is None:
        return "", "", ""
    low, high = m.frf.frequencies[0], m.frf.frequencies[-1]
    for name, f in (("f_AR", m.two_mass.f_AR), ("f_R", m.two_mass.f_R)):
        if f < low:
            return name, f"{name} {number(f, 4)} Hz is below the band, {number(low, 4)} Hz", "widen the band"
        if f > high:
            reason = f"{name} {number(f, 4)} Hz is above the band, {number(high, 4)} Hz"
            return name, reason, "widen the band, or measure K elsewhere"
    return "", "", ""
