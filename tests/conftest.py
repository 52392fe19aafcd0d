"""Options of the test run."""

from __future__ import annotations

import gc
import os
from dataclasses import replace
from pathlib import Path

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import symgen.plan
from symgen.plan import Plan, plan_of_robot
from symgen.robot import Robot


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--update", action="store_true", help="rewrite generated/ instead of comparing it")


def pytest_configure() -> None:
    """Robots that differ in nothing that a plan knows of are planned once, whoever asks: it knows no experiment, and no springs."""
    gc.disable()  # until all is loaded
    planned: dict[str, Plan] = {}

    def once(robot: Robot) -> Plan:
        drives = tuple(replace(one, K=0.0, D=0.0, D_spring=0.0, encoder_counts=0) for one in robot.drives)
        own = replace(robot, urdf=Path(), path=Path(), drives=drives, experiment=None)  # type: ignore[arg-type]
        key = repr((robot.urdf.read_bytes(), own))
        if key not in planned:
            planned[key] = plan_of_robot(robot)
        return planned[key]

    symgen.plan.plan_of_robot = once


def pytest_collection_finish() -> None:
    """What is loaded by now stays, and is not looked through again for what may be thrown away."""
    gc.freeze()
    gc.enable()
