"""What goes wrong, in one line a person can act on."""

from __future__ import annotations


class IdentError(Exception):
    """Bad input or misuse: the message names the file, the element, what was found and what was expected.

    The command line prints it as one line and exits with status 2.
    """


class CampaignError(IdentError):
    """A campaign file or record that breaks a rule of the format."""


class ExperimentError(IdentError):
    """An experiment that cannot be run as asked: unstable lock, torque beyond the limit, posture outside the limits."""


class ImportingError(IdentError):
    """A measured record or a map that can not become a campaign: a missing variable, a unit, dropped samples, no period."""
