"""All that symgen writes of an arm: what its model alone gives, which may be made while the plan is sought, and the plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from symgen import equations, typeset
from symgen.formula import alpha_formulas
from symgen.plan import Model, Plan
from symgen.typeset import Block

if TYPE_CHECKING:
    from symgen.emit import Expressions


@dataclass(frozen=True)
class OfModel:
    """What a model alone gives: the `texts` of the files with its functions, by name, and the `blocks` of the equations but for
    what is to be measured."""

    texts: Mapping[str, str]
    blocks: Sequence[Block]


def of_model(model: Model, expressions: Expressions | None = None) -> OfModel:
    """Returns what of the files needs no plan; `expressions`, if there are some of this model, save work."""
    from symgen.emit import Expressions, function_texts

    factoring, formulas = model.factoring, alpha_formulas(model.factoring)
    texts = function_texts(factoring, model.chain.name, formulas, expressions or Expressions(factoring))
    return OfModel(texts, equations.document(factoring, formulas=formulas))


def write_all(plan: Plan, directory: Path, made: OfModel | None = None) -> list[str]:
    """Writes all that symgen has to say of an arm into `directory`; returns the file names.

    `plan.json`, `equations.md`, `equations.tex`, and `emit.function_texts`; `made` of the plan's model saves work. Raises OSError.
    """
    made = made or of_model(plan.model)
    blocks = [*made.blocks, *equations.measurements(plan.model.factoring, plan.document)]
    texts = {"equations.md": typeset.markdown(blocks), "equations.tex": typeset.latex(blocks), **made.texts}
    plan.write(directory / "plan.json")
    for file, text in texts.items():
        (directory / file).write_text(text, encoding="utf-8")
    return ["plan.json", *texts]
