"""Random serial arms for laws: every kind of joint, of axes and of offsets, with bodies that could exist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from arms import crba, model_of
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from symgen.chain import PRISMATIC, REVOLUTE, Chain, Inertia, Joint, skew
from symgen.urdf import load_chain

REPOSITORY = Path(__file__).parents[2]

AXES = ("generic", "right angle", "parallel", "antiparallel")
OFFSETS = ("generic", "one component", "none")
#: One joint: its type, its axis seen from the joint before, its offset from it.
Kind = tuple[str, str, str]


def kinds(*, sliding: bool = True) -> st.SearchStrategy[Kind]:
    types = st.sampled_from((REVOLUTE, REVOLUTE, REVOLUTE, PRISMATIC)) if sliding else st.just(REVOLUTE)
    return st.tuples(types, st.sampled_from(AXES), st.sampled_from(OFFSETS))


def chains(least: int, most: int, *, sliding: bool = True) -> st.SearchStrategy[Chain]:
    """Arms of `least` to `most` joints."""
    joints = st.lists(kinds(sliding=sliding), min_size=least, max_size=most)
    return st.builds(build, joints, st.integers(0, 2**32 - 1))


#: Joints without any special geometry.
REVOLUTE_ONLY: list[Kind] = [(REVOLUTE, "generic", "generic")] * 10


def general_chain(seed: int, n: int) -> Chain:
    """An arm of n turning joints with no special geometry at all."""
    return build(REVOLUTE_ONLY[:n], seed)


def build(joints: Sequence[Kind], seed: int) -> Chain:
    """The arm described joint by joint; lengths, directions and bodies are drawn from the seed."""
    rng = np.random.default_rng(seed)
    out: list[Joint] = []
    for k, (kind, relation, offset) in enumerate(joints):
        before = out[-1].axis if out else np.array([0.0, 0.0, 1.0])
        axis = _unit(rng)
        R = _rotation(rng)
        if relation == "right angle":
            R, axis = np.eye(3)[:, rng.permutation(3)] * rng.choice([-1.0, 1.0], 3), np.eye(3)[rng.integers(3)]
            R = R * np.linalg.det(R)
        elif relation != "generic":
            R = _aligning(axis, before if relation == "parallel" else -before, rng)
        p = rng.uniform(0.1, 0.4, 3) * rng.choice([-1.0, 1.0], 3) * (offset != "none")
        if offset == "one component":
            p = p * np.eye(3)[rng.integers(3)]
        span = 2.8 if kind == REVOLUTE else 0.5
        out.append(Joint(f"j{k + 1}", kind, R, p, axis, f"l{k + 1}", random_body(rng), -span, span))
    return Chain(f"seed {seed}", tuple(out), "base", "tip")


def random_body(rng: np.random.Generator) -> Inertia:
    """A body of 0.5 to 2 kg: moments of a spread of points, none of them vanishing, so that no small change is impossible."""
    points = rng.normal(size=(3, 3)) * 0.1 + 0.05 * np.eye(3)
    mass, S = rng.uniform(0.5, 2.0), points @ points.T + 1e-3 * np.eye(3)
    return Inertia(mass, rng.normal(size=3) * 0.1, mass * (np.trace(S) * np.eye(3) - S))


def with_bodies(chain: Chain, bodies: Sequence[Inertia]) -> Chain:
    """The same geometry with other bodies."""
    joints = [replace(joint, inertia=body) for joint, body in zip(chain.joints, bodies, strict=True)]
    return replace(chain, joints=tuple(joints))


def body_of(parameters: np.ndarray) -> Inertia:
    """The body with these ten parameters (m > 0)."""
    m, hx, hy, hz, xx, xy, yy, xz, yz, zz = parameters
    com = np.array([hx, hy, hz]) / m
    return Inertia(m, com, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) + m * skew(com) @ skew(com))


def pseudo_inertia(body: Inertia) -> np.ndarray:
    """The 4 x 4 matrix that is positive definite exactly for bodies that can exist (DOI 10.1109/LRA.2017.2729659)."""
    L = body.I - body.mass * skew(body.com) @ skew(body.com)
    h = body.mass * body.com
    return np.block([[np.trace(L) / 2 * np.eye(3) - L, h[:, None]], [h[None, :], np.array([[body.mass]])]])


def postures(chain: Chain, count: int, seed: int = 0) -> np.ndarray:
    """Postures [count, n] anywhere within the limits."""
    low, high = chain.limits.T
    return low + (high - low) * np.random.default_rng(seed).random((count, chain.n))


def judge(chain: Chain, q: np.ndarray) -> np.ndarray:
    """J(q) [m, n, n] by pinocchio's composite-rigid-body algorithm, at postures q [m, n]."""
    model = model_of(chain)
    return np.array([crba(model, posture) for posture in q])


@cache
def own(name: str) -> Chain:
    """One of the robots of this repository."""
    return load_chain(REPOSITORY / "robots" / name / f"{name}.urdf")


def calibrated(chain: Chain, off: float) -> Chain:
    """The arm with every joint turned by `off` [rad] and moved by a third of that [m]."""
    rng = np.random.default_rng(1)
    joints = [
        replace(
            j, R=j.R @ Rotation.from_rotvec(off * rng.normal(size=3)).as_matrix(), p=j.p + off / 3 * rng.normal(size=3)
        )
        for j in chain.joints
    ]
    return replace(chain, joints=tuple(joints))


def _unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def _rotation(rng: np.random.Generator) -> np.ndarray:
    R = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return R * np.linalg.det(R)


def _aligning(axis: np.ndarray, target: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A rotation with R axis = target, turned about it at random."""

    def frame(z: np.ndarray) -> np.ndarray:
        x = np.cross(z, _unit(rng))
        x = x / np.linalg.norm(x)
        return np.column_stack([x, np.cross(z, x), z])

    return frame(target) @ frame(axis).T
