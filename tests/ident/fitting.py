"""What a diagnosis fits with, of a campaign whose records fit, choose and report alike."""

from __future__ import annotations

from ident.arm.coupled import declared_start
from ident.arm.evidence import evidence, gravity_basis
from ident.arm.parts import Split
from ident.records.campaign import Campaign
from ident.records.frf import estimate
from ident.search.refits import Bench
from symgen.chain import Chain
from symgen.plan import make_model


def bench_of(c: Campaign, chain: Chain) -> Bench:
    """Every line of every record in each part, the URDF's zeros believed."""
    model = make_model(chain, believe_zeros=True)
    basis = gravity_basis(model, c.gravity)
    responses = tuple(estimate(record, c) for record in c.records)
    data = tuple(evidence(c, model, basis, frf, k, "every") for k, frf in enumerate(responses))
    return Bench(c, model, basis, Split(data, data, data, ""), declared_start(c, model, responses, basis), 1)
