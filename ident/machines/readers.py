"""Files of other programs as named arrays of numbers: MAT, CSV, NPZ, HDF5, MCAP. What is no number is left out.

The campaign file has its own door, `store`; these files are foreign and are only read.
"""

from __future__ import annotations

import csv
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.errors import ImportingError
from ident.machines.text_tables import BYTE_ORDERS, Seconds, read_text

Array = NDArray[np.float64]


class Variables(dict[str, Array]):
    """Name -> numbers: a scalar [], a signal [T] or several side by side [T, m]; `left_out` says in words what others are, `in_seconds` names
    what is time in s."""

    def __init__(self, found: Iterable[tuple[str, Array | Seconds | str]]) -> None:
        super().__init__()
        self.left_out: dict[str, str] = {}
        self.in_seconds: set[str] = set()
        for name, value in found:
            if isinstance(value, str):
                self.left_out[name] = value
            elif isinstance(value, Seconds):
                self[name] = value.values
                self.in_seconds.add(name)
            else:
                self[name] = value

    @property
    def others(self) -> str:
        """What was left out, in words; "" where that is nothing."""
        return "; ".join(f"{name!r} is {what}" for name, what in list(self.left_out.items())[:5])


#: Fewest samples of a record.
FEWEST = 200

#: What the libraries are known to raise on a damaged file.
_DAMAGE = (
    OSError, ValueError, TypeError, LookupError, ArithmeticError, MemoryError, AttributeError, RuntimeError, EOFError,
    csv.Error, zlib.error, zipfile.BadZipFile, struct.error, SyntaxError, NameError, tokenize.TokenError,
)  # fmt: skip

_MAT73 = b"MATLAB 7.3"
#: What MATLAB 7.3 keeps of a complex number.
_COMPLEX = ("real", "imag")
#: What kinds of numpy's are that are no real numbers, in words; the rest is text.
_OTHERS = {"c": "complex", "O": "a cell array or an array of structs", "V": "a table of several fields"}
_HDF5 = b"\x89HDF\r\n\x1a\n"
_MCAP = b"\x89MCAP"


def read_variables(path: str | Path) -> Variables:
    """Returns every array of real numbers in the file, by name, with at most two dimensions.

    Fields of a MATLAB struct are called `log.q`, datasets of an HDF5 group `log/q`, columns of a CSV file by their
    heading or, without one, by their number from 1, fields of an MCAP topic as in `mcap_topics`. A vector stored as one row or one column is [T]. The kind is told by
    the content, not by the name. ImportingError, one line that starts with the path, for what can not be read.
    """
    path = Path(path)
    try:
        if not path.is_file():
            raise ImportingError(f"{path}: no such file; expected a record (MAT, CSV, NPZ, HDF5 or MCAP)")
        with path.open("rb") as file:
            head = file.read(1024)
        kind, reader = _reader(path, head)
    except (OSError, ValueError) as error:
        raise ImportingError(f"{path}: cannot be read: {_line(error)}") from None
    try:
        found = Variables(reader(path))
    except ImportingError:
        raise
    except _DAMAGE as error:
        raise ImportingError(f"{path}: not a readable {kind} file: {_line(error)}") from None
    if not found:
        expected = f", but {found.others}" if found.others else "; expected the samples of a record"
        raise ImportingError(f"{path}: a {kind} file without numbers{expected}")
    return found


def transposed(values: Array) -> bool:
    """Returns whether signals lie in rows: a record has more samples than signals."""
    return values.ndim == 2 and values.shape[1] > max(len(values), FEWEST)


def _reader(path: Path, head: bytes) -> tuple[str, Callable[[Path], Iterator[tuple[str, Array | Seconds | str]]]]:
    if head.startswith(_MCAP):
        return "MCAP", _mcap
    if head.startswith(_MAT73) or (_HDF5 in (head[:8], head[512:520]) and path.suffix.lower() == ".mat"):
        return "MAT 7.3", _mat73
    if head.startswith(_HDF5):
        return "HDF5", _hdf5
    if head.startswith(b"PK"):
        return "NPZ", _npz
    if head.startswith(b"MATLAB") or path.suffix.lower() == ".mat":
        return "MAT", _mat
    if b"\0" in head and not head.startswith(tuple(BYTE_ORDERS)):
        raise ImportingError(f"{path}: a binary file of unknown kind; expected MAT, CSV, NPZ, HDF5 or MCAP")
    return "CSV", read_text


# MAT, NPZ, HDF5, MCAP -------------------------------------------------------------------------------------------------------


def _mat(path: Path) -> Iterator[tuple[str, Array | str]]:
    from scipy.io import loadmat

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # variables without a name, objects of unknown classes: left out anyway
        content = loadmat(path, simplify_cells=True)
    yield from _fields({name: value for name, value in content.items() if not name.startswith("__")}, "")


def _fields(content: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Array | str]]:
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _fields(value, f"{prefix}{name}.")
        elif (elements := _structs(value)) is not None:
            yield from _fields({f"{name}({k})": element for k, element in enumerate(elements, 1)}, prefix)
        else:
            yield f"{prefix}{name}", _numbers(value)


def _structs(value: Any) -> Sequence[Mapping[str, Any]] | None:
    """The elements of an array of structs, else None."""
    listed = value.ravel().tolist() if isinstance(value, np.ndarray) and value.dtype == object else value
    return listed if isinstance(listed, list) and listed and all(isinstance(e, Mapping) for e in listed) else None


def _npz(path: Path) -> Iterator[tuple[str, Array | str]]:
    if not zipfile.is_zipfile(path):
        raise ImportingError(f"{path}: a damaged NPZ file: its end is missing")
    with path.open("rb") as file, np.load(file, allow_pickle=False) as content:  # numpy leaves a damaged file open
        for name in content.files:
            try:
                array = content[name]
            except ValueError:
                yield name, "an array of Python objects"
            else:
                yield from _columns(name, array, ".")


def _columns(name: str, array: Any, mark: str) -> Iterator[tuple[str, Array | str]]:
    """The array, or the fields that every element of it has."""
    fields = getattr(getattr(array, "dtype", None), "names", None)
    if fields is None:
        yield name, _numbers(array)
        return
    for field in fields:
        yield from _columns(f"{name}{mark}{field}", array[field], mark)


def _hdf5(path: Path) -> Iterator[tuple[str, Array | str]]:
    for name, dataset in _datasets(path):
        yield from _columns(name, dataset[()], "/")


def _mcap(path: Path) -> Iterator[tuple[str, Array | str]]:
    from ident.machines.mcap_topics import read_topics

    return read_topics(path)


def _mat73(path: Path) -> Iterator[tuple[str, Array | str]]:
    """MATLAB keeps arrays column by column: what HDF5 calls [m, T] was [T, m]."""
    for name, dataset in _datasets(path):
        kind = dataset.attrs.get("MATLAB_class", b"")
        if name.startswith("#") or kind in (b"char", b"cell") or "MATLAB_empty" in dataset.attrs:
            continue
        yield name.replace("/", "."), _numbers(np.transpose(dataset[()]))


def _datasets(path: Path) -> Iterator[tuple[str, Any]]:
    import h5py

    with h5py.File(path, "r") as file:
        names: list[str] = []
        file.visit(names.append)
        for name in names:
            if isinstance(file[name], h5py.Dataset):
                yield name, file[name]


def _numbers(value: Any) -> Array | str:
    """The value as floats with the axes of length one taken off; what it is where it is no array of real numbers."""
    try:
        array = np.asarray(value)
    except ValueError:
        return "a cell array of different shapes"
    if array.dtype.kind not in "biuf":
        kind = "c" if array.dtype.names == _COMPLEX else array.dtype.kind
        return _OTHERS.get(kind, "text")
    if array.size == 0:
        return "empty"
    array = array.squeeze()
    return array.astype(float) if array.ndim <= 2 else f"of {array.ndim} dimensions"


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
