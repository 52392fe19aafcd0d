"""Judges a verdict: what the diagnosis wrote about a campaign file, held against what was put in."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import Any

import numpy as np

from ident.effects.base import Effect
from loop.cases import Case, arm, built
from symgen.kinematics import inertia_matrix
from symgen.plan import make_model

#: A held-out error may be this many times the noise floor; J(q) this many times as wrong as without the effect.
NEAR_NOISE, NEAR_CLEAN = 1.1, 2.0
#: What a learned curve has to make of the error.
CUT = 0.5
POSTURES = 500

Named = dict[str, Any]

#: What is asked of the verdict on a case of each kind.
ASKED = {
    "clean": ("explained",),
    "one": ("named first", "named", "port", "near noise", "J(q)"),
    "two": ("both named", "one named", "near noise"),
    "outside": ("not misnamed", "port", "joint", "place", "cut"),
    "faint": ("named first", "named", "port", "near noise"),
}


def judged(case: Case, truth: Sequence[Named], verdict: dict[str, Any]) -> dict[str, bool]:
    """{what is asked: whether it is so}, for a case of its kind; `truth` and the verdict's effects: name, joint, port."""
    status, effects = verdict["status"], verdict["effects"]
    if case.kind == "clean":
        return {"explained": status == "explained"}
    error = verdict["error"]
    after, floor = error["after"]["all"], error["noise_floor"]
    near = {"near noise": after <= NEAR_NOISE * floor}
    if case.kind == "two":
        return {
            "both named": all_named(truth, effects),
            "one named": any(all_named([t], effects) for t in truth),
        } | near
    (true,) = truth
    port, joint = place(verdict)
    first = effects[0] if effects else None
    if case.kind in ("one", "faint"):
        named = first is not None and stands_for(first, true)
        return {"named first": named, "named": all_named(truth, effects), "port": named or port == true["port"]} | near
    return {
        "not misnamed": status != "effect-found" or first is None or first["name"] == "unknown",
        "port": port == true["port"], "joint": joint == true["joint"],
        "place": (port, joint) == (true["port"], true["joint"]),
        "cut": after <= max(CUT * error["before"]["all"], NEAR_NOISE * floor),
    }  # fmt: skip


def stands_for(found: Named, true: Named) -> bool:
    """Whether a found effect is the true one, or says that it cannot be told from it."""
    those = [(found["name"], found["joint"]), *((c["name"], c["joint"]) for c in found["confounded_with"])]
    return (true["name"], true["joint"]) in those


def all_named(truth: Sequence[Named], effects: Sequence[Named]) -> bool:
    """Whether every true effect is named by a found one of its own."""
    return any(
        all(stands_for(found, true) for found, true in zip(chosen, truth, strict=True))
        for chosen in permutations(effects, len(truth))
    )


def place(verdict: dict[str, Any]) -> tuple[str | None, str | None]:
    """Port and joint that the verdict names first: those of its first effect, else of what stays unexplained."""
    rows = verdict["effects"] or verdict["unexplained"]
    return (rows[0]["port"], rows[0]["joint"]) if rows else (None, None)


def bias(case: Case, effects: Sequence[Effect], verdict: dict[str, Any]) -> float:
    """How wrong J(q) of the corrected arm is: rms over postures of the entry that is worst, relative to sqrt(J_ii J_jj)."""
    chain = arm(case.robot)[1]
    model = make_model(chain, believe_zeros=verdict["declared"]["believed_zeros"] > 0)
    true = built(case)
    for effect in effects:
        true = effect.arm(true, 0)
    alpha = np.array([verdict["inertia"]["alpha_after"][name]["value"] for name in model.names])
    q = model.random_postures(POSTURES, np.random.default_rng(0))
    J = inertia_matrix(true.chain, q)
    size = np.sqrt(np.einsum("pi,pj->pij", *(np.einsum("pii->pi", J),) * 2))
    return float(np.sqrt(np.mean(((model.J(q, alpha) - J) / size) ** 2, axis=0)).max())
