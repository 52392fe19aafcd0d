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


def short(value: object) -> str:
    """Returns a value as found, for a message: one line of 60 characters at most."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # an integer of more than 4300 digits
        return "a huge integer"
    return text if len(text) <= 60 else text[:57] + "..."


def message(error: BaseException) -> str:
    """Returns what an error of another library says, on one line; its name where it says nothing."""
    return " ".join(str(error).split()) or type(error).__name__
