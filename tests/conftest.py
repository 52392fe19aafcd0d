"""Options of the test run."""

from __future__ import annotations

import gc
import os
import pickle
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import symgen.plan
from symgen.chain import Chain
from symgen.plan import Model, Plan, make_model, plan_of_robot
from symgen.robot import Robot


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update", action="store_true", help="rewrite generated/ instead of comparing it")


def pytest_configure() -> None:
    """An arm has one model, whoever asks, and robots that differ in nothing that a plan knows of are planned once: it knows no
    experiment, and no springs."""
    gc.disable()  # until all is loaded
    planned: dict[str, Plan] = {}

    def once(robot: Robot) -> Plan:
        drives = tuple(replace(one, K=0.0, D=0.0, D_spring=0.0, encoder_counts=0) for one in robot.drives)
        own = replace(robot, urdf=Path(), path=Path(), drives=drives, experiment=None)  # type: ignore[arg-type]
        key = repr((robot.urdf.read_bytes(), own))
        if key not in planned:
            planned[key] = plan_of_robot(robot)
        return planned[key]

    models: dict[bytes, Model] = {}

    def one_model(chain: Chain, *, believe_zeros: bool = False, entries: Any = None) -> Model:
        key = pickle.dumps((astuple(chain), believe_zeros))
        if key not in models:
            models[key] = make_model(chain, believe_zeros=believe_zeros, entries=entries)
        return models[key]

    symgen.plan.plan_of_robot, symgen.plan.make_model = once, one_model


def pytest_collection_finish() -> None:
    """What is loaded by now stays, and is not looked through again for what may be thrown away."""
    gc.freeze()
    gc.enable()
