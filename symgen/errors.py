"""What goes wrong, in one line a person can act on."""

from __future__ import annotations


class SymgenError(Exception):
    """Bad input or misuse: the message names the file, the element, what was found and what was expected.

    The command line prints it as one line and exits with status 2.
    """


class UrdfError(SymgenError):
    """A robot description that cannot be read or is physically impossible."""


class RobotError(SymgenError):
    """A robot.toml that breaks a rule."""


class PlanError(SymgenError):
    """A plan file or a request for postures that cannot be met."""


class NoPlanError(PlanError):
    """A plan of the kind asked for does not exist for this arm: nothing is wrong with the input. Exit status 1."""
