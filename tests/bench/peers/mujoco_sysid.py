"""mujoco.sysid on the records of a campaign: least squares over rollouts, in an environment of its own.

    python mujoco_sysid.py RECORDS.npz OUT.json

RECORDS.npz: `xml` of the declared elastic arm (motor joints "motor<i>", springs "spring<i>", bodies "link<i>"), `rest` [R, 2n]
joint angles at the start, `ctrl` [R, T, a] what the actuators are told, held between samples: torques [n], where motors are guided
angles and velocities, too, `theta` [R, T, n] motor angles, joint side. What is fitted: of every joint armature, stiffness and both dampings, of every body mass, lever arm and principal moments.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from itertools import product
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid

#: Everything may end off its start by this factor: what CAD and datasheets are right to, with room.
REACH = 2.0
MOST_ITERATIONS = 30


def parameters(spec: mujoco.MjSpec, n: int) -> sysid.ParameterDict:
    """Factors on everything that a record can tell of an arm with symmetric links, starting from the declared one."""
    found = sysid.ParameterDict()

    def add(name: str, of: Callable[[mujoco.MjSpec], Any], field: str, k: int | None) -> None:
        unit = np.array(getattr(of(spec), field), dtype=float)

        def write(s: mujoco.MjSpec, p: sysid.Parameter) -> None:
            new = np.array(getattr(of(s), field), dtype=float)
            chosen = slice(None) if k is None else k
            new.reshape(-1)[chosen] = unit.reshape(-1)[chosen] * float(p.value[0])
            setattr(of(s), field, float(new) if new.ndim == 0 else new)

        found.add(sysid.Parameter(name, 1.0, 1.0 / REACH, REACH, modifier=write))

    for i in range(n):
        for joint, field in product((f"motor{i}", f"spring{i}"), ("armature", "stiffness", "damping")):
            if np.any(np.ravel(getattr(spec.joint(joint), field))[:1]):
                add(f"{joint}_{field}", lambda s, joint=joint: s.joint(joint), field, 0)
        for field, k in (("mass", None), ("ipos", None), ("inertia", 0), ("inertia", 1), ("inertia", 2)):
            add(f"link{i}_{field}{k}", lambda s, i=i: s.body(f"link{i}"), field, k)
    return found


def main(records: str, out: str) -> None:
    given = np.load(records)
    spec = mujoco.MjSpec.from_string(str(given["xml"]))
    model = spec.compile()
    R, T, n = given["theta"].shape
    t = np.arange(T) * model.opt.timestep
    states, controls, sensors = [], [], []
    for rest, ctrl, theta in zip(given["rest"], given["ctrl"], given["theta"], strict=True):
        states.append(sysid.create_initial_state(model, rest, np.zeros(2 * n), np.zeros(0)))
        controls.append(sysid.TimeSeries(t, ctrl))
        sensors.append(sysid.TimeSeries.from_names(t, theta, model))
    fitted = sysid.ModelSequences("arm", spec, [f"r{k}" for k in range(R)], states, controls, sensors)
    residual = sysid.build_residual_fn(models_sequences=[fitted])
    begin = time.perf_counter()
    found, result = sysid.optimize(
        initial_params=parameters(spec, n),
        residual_fn=residual,
        optimizer="scipy_parallel_fd",
        verbose=False,
        max_iters=MOST_ITERATIONS,
        x_scale="jac",
    )
    seconds = time.perf_counter() - begin
    made = sysid.apply_param_modifiers_spec(found, spec)
    done = (made if isinstance(made, mujoco.MjSpec) else spec).compile()
    links = [
        {"mass": float(done.body_mass[k]), "com": done.body_ipos[k].tolist(), "quat": done.body_iquat[k].tolist(),
         "moments": done.body_inertia[k].tolist()}
        for k in range(1, n + 1)
    ]  # fmt: skip
    start, end = (float(np.sum(np.concatenate([np.ravel(r) for r in residual(x, found)[0]]) ** 2)) for x in (
        parameters(spec, n).as_vector(), result.x))  # fmt: skip
    answer = {"seconds": seconds, "cost": [start, end], "links": links, "version": mujoco.__version__}
    with open(out, "w", encoding="utf-8") as file:
        json.dump(answer, file)


if __name__ == "__main__":
    main(*sys.argv[1:])
