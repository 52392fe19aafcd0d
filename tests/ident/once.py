"""What is made once of the same, whoever asks again."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def once(target: str, make: Callable[..., Any], key: Callable[..., Hashable]) -> Iterator[None]:
    """`target`, a dotted name, as `make`, called once for all arguments of the same `key`."""
    made: dict[Hashable, Any] = {}

    def asked(*given: Any, **named: Any) -> Any:
        of = key(*given, **named)
        if of not in made:
            made[of] = make(*given, **named)
        return made[of]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(target, asked)
        yield
