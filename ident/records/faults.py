"""Faults of the recording that would end in a wrong number: named, with the joint, the record and what to do.

A sign, a unit, a gear ratio or a pair of cables is recognised from the data; what is found is only what no error of CAD or of
a datasheet explains.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from ident.errors import IdentError
from ident.records.cables import played, swapped
from ident.records.campaign import Campaign, is_copy
from ident.records.gear_ratio import wrong_ratio
from ident.records.joint_faults import at_rest, in_motion
from ident.records.looks import observe
from ident.records.reversed_gear import reversed_gear
from ident.records.signal_faults import FLAG, REFUSE, Fault, of_signals
from symgen.plan import Model

__all__ = ["FLAG", "REFUSE", "Fault", "faults", "refuse", "refuse_first"]


def faults(campaign: Campaign, model: Model) -> tuple[Fault, ...]:
    """Returns what is wrong with the records; empty where nothing is. `model` is the declared arm's.

    Nothing is concluded from J_m or K where the campaign has none.
    """
    looks = [observe(campaign, model, record) for record in campaign.records]
    mixed = list(played(campaign, looks))
    found = [*mixed, *_copies(campaign)]
    spoilt = {fault.record for fault in found}
    pairs = list(swapped(campaign, [one for one in looks if one.record.id not in spoilt]))
    found += [fault for *_, fault in pairs]
    exchanged = {campaign.joints[j] for i, k, _ in pairs for j in (i, k)}
    for record in campaign.records:
        others = [
            fault
            for fault in of_signals(campaign, record)
            if fault.name != "stuck encoder" or not (record.id in spoilt or fault.joint in exchanged)
        ]
        found += others
        spoilt |= {record.id for _ in others}
    sound = [one for one in looks if one.record.id not in spoilt]
    free = [j for j, name in enumerate(campaign.joints) if sound and not mixed and name not in exchanged]
    # at rest, in motion, in motion and finely: a fault of one joint disturbs the motion that is expected of the others
    found += [fault for j in free for fault in at_rest(campaign, sound, j)]
    if not found:
        found += [fault for j in free for fault in in_motion(campaign, sound, j)]
    if not found:
        found += [fault for j in free for fault in wrong_ratio(campaign, sound, j)]
    if not found:
        found += [fault for j in free for fault in reversed_gear(campaign, sound, j)]
    return tuple(found)


def refuse(campaign: Campaign, model: Model) -> tuple[Fault, ...]:
    """Returns the faults that leave numbers of some use. IdentError, one line naming the first, if there is one that does not."""
    found = faults(campaign, model)
    refuse_first(found)
    return found


def refuse_first(found: Sequence[Fault]) -> None:
    """IdentError, one line naming the first of some faults that leaves no numbers of use, if there is one, and the others behind it."""
    fatal = [fault for fault in found if fault.severity == REFUSE]
    if fatal:
        more = "; ".join(dict.fromkeys(f"{fault.name} ({fault.joint or fault.record})" for fault in fatal[1:]))
        raise IdentError(fatal[0].line + (f" [{len(fatal) - 1} more: {more}]" if more else ""))


def _copies(campaign: Campaign) -> Iterator[Fault]:
    """Records that are others again."""
    for one, other in combinations(campaign.records, 2):
        if is_copy(one, other):
            line = f"record {other.id} has the samples of record {one.id}: a copy tells nothing more; leave it out"
            yield Fault("copied record", "", other.id, line, REFUSE)
