"""Reading a campaign file field by field: presence, kind and shape are checked, and damage is told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ident.errors import CampaignError, message, short
from ident.records.campaign import Array

#: What h5py raises when bytes are not what they should be; nothing else is done inside the guarded calls.
DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, OverflowError, MemoryError)


@dataclass(frozen=True)
class Node:
    """One group of a `file`, and how to speak of it.

    Each method returns one field of it, or raises CampaignError, one line naming file, group, field, what was found and
    what was expected.
    """

    group: h5py.Group
    file: str

    def error(self, field: str, problem: str) -> CampaignError:
        return CampaignError(f"{self.file}: {self.group.name}: {field}: {problem}")

    def attribute(self, name: str) -> Any:
        if name not in self.group.attrs:
            raise self.error(name, "missing; expected an attribute")
        value = self.group.attrs[name]
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else value

    def string(self, name: str) -> str:
        value = self.attribute(name)
        if not isinstance(value, str):
            raise self.error(name, f"found {short(value)}, expected a string")
        return value

    def numbers(self, name: str) -> Array:
        value = self.attribute(name)
        if np.asarray(value).dtype.kind not in "iuf":
            raise self.error(name, f"found {short(value)}, expected numbers")
        return np.array(value, dtype=float)

    def number(self, name: str) -> float:
        value = self.numbers(name)
        if value.size != 1:
            raise self.error(name, f"found {value.size} numbers, expected one")
        return float(value.item())

    def wholes(self, name: str) -> NDArray[np.int64]:
        value = self.numbers(name)
        if not np.all((np.abs(value) < 2**53) & (np.floor(value) == value)):
            raise self.error(name, f"found {short(value)}, expected whole numbers")
        return value.astype(np.int64)

    def whole(self, name: str) -> int:
        self.number(name)
        return int(self.wholes(name).item())

    def dataset(self, name: str) -> h5py.Dataset:
        return self._child(name, h5py.Dataset)

    def below(self, name: str) -> Node:
        return Node(self._child(name, h5py.Group), self.file)

    def strings(self, name: str, ndim: int) -> Any:
        """A string (ndim 0) or a list of them (ndim 1)."""
        dataset = self.dataset(name)
        if h5py.check_string_dtype(dataset.dtype) is None or dataset.ndim != ndim:
            expected = "one UTF-8 string" if ndim == 0 else "UTF-8 strings [n]"
            raise self.error(name, f"found {dataset.dtype} of shape {dataset.shape}, expected {expected}")
        try:
            return np.array(dataset.asstr()[()], dtype=object).tolist()
        except DAMAGE as error:
            raise self.error(name, f"damaged: {message(error)}") from None

    def array(self, name: str, shape: tuple[int, ...]) -> Array:
        dataset = self.dataset(name)
        if dataset.shape != shape or dataset.dtype.kind not in "iuf":
            raise self.error(name, f"found {dataset.dtype} of shape {dataset.shape}, expected numbers of shape {shape}")
        try:
            return np.array(dataset[()], dtype=float)
        except DAMAGE as error:
            raise self.error(name, f"damaged: {message(error)}") from None

    def _child(self, name: str, kind: type) -> Any:
        expected = kind.__name__.lower()
        if name not in self.group:
            raise self.error(name, f"missing; expected a {expected}")
        try:
            child = self.group[name]
        except DAMAGE as error:
            raise self.error(name, f"damaged: {message(error)}") from None
        if not isinstance(child, kind):
            raise self.error(name, f"found a {type(child).__name__.lower()}, expected a {expected}")
        return child
