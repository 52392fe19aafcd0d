"""The topics of an MCAP file as named arrays of numbers: rosbag2 of ROS 2 (CDR by ros2msg), and JSON messages.

One row a message. What a message names by strings (`name` of a JointState) is a signal of its own: `joint_states/position/elbow`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.errors import ImportingError

#: The two fields of a time, in ROS 2 and as ROS 1 calls them.
_STAMPS = (("sec", "nanosec"), ("secs", "nsecs"))

Decoder = Callable[[bytes], Any]


def read_topics(path: Path) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yields every number of every topic that can be decoded: `topic/field` [T] or [T, m] over its T messages.

    Fields called stamp are seconds since the first stamp of the file, whatever its topic; behind them `topic/log_time`,
    where messages have no such field themselves, since the first message of the file. Other times count from their own
    first. What is not in every message of a topic, or changes its length, is left out. ImportingError if nothing in the
    file can be decoded, or it ends in the middle.
    """
    topics, logged = _messages(path)
    kept = {
        topic: {name: values for name, values in columns.items() if _one_each(values, len(logged[topic]))}
        for topic, columns in topics.items()
    }
    stamps = [columns[name] for columns in kept.values() for name in columns if _is_stamp(name, columns[name])]
    stamped = min((one for values in stamps for one in values if one), default=0)  # 0: never set
    first = min((times[0] for times in logged.values()), default=0)
    for topic, columns in kept.items():
        for name, values in columns.items():
            if not isinstance(values[0], int):
                yield f"{topic}/{name}", np.array(values, float)
            else:
                yield f"{topic}/{name}", _since(stamped if _is_stamp(name, values) else values[0], values)
        if "log_time" not in columns:
            yield f"{topic}/log_time", _since(first, logged[topic])


def _messages(path: Path) -> tuple[dict[str, dict[str, list[Any]]], dict[str, list[int]]]:
    """What all messages hold, by topic and name, and when those of a topic came [ns]. Errors as `read_topics`."""
    from mcap.exceptions import McapError
    from mcap.reader import make_reader
    from zstandard import ZstdError

    topics: dict[str, dict[str, list[Any]]] = {}
    logged: dict[str, list[int]] = {}
    decoders: dict[int, Decoder | None] = {}
    unknown: set[str] = set()
    try:
        with path.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages():
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(channel.message_encoding, schema)
                decode, topic = decoders[channel.id], channel.topic.strip("/")
                if decode is None:
                    unknown.add(f"{channel.topic} ({channel.message_encoding or 'no encoding'})")
                    continue
                columns = topics.setdefault(topic, {})
                logged.setdefault(topic, []).append(message.log_time)
                for name, value in _numbers(decode(message.data), ""):
                    columns.setdefault(name, []).append(value)
    except (McapError, ZstdError, OSError) as error:  # OSError: a place in the file that is before its beginning
        why = "damaged or cut off" if isinstance(error, OSError) else error or type(error).__name__
        raise ImportingError(f"{path}: not a readable MCAP file: {why}") from None
    if unknown and not topics:
        raise ImportingError(
            f"{path}: no topic that can be decoded, but {', '.join(sorted(unknown)[:5])}; expected ROS 2 messages (cdr by ros2msg) or JSON"
        )
    return topics, logged


def _one_each(values: Sequence[Any], messages: int) -> bool:
    """Whether every message has the value, in the same shape."""
    return len(values) == messages and len(set(map(np.shape, values))) == 1


def _is_stamp(name: str, values: Sequence[Any]) -> bool:
    return name.split("/")[-1] == "stamp" and isinstance(values[0], int)


def _since(start: int, nanoseconds: Sequence[int]) -> NDArray[np.float64]:
    """Times as seconds since the start: as they are, floats would round them to a quarter of a microsecond."""
    return np.array([1e-9 * (one - start) for one in nanoseconds])


def _decoder(encoding: str, schema: Any) -> Decoder | None:
    """What makes a message of bytes; None for what nobody here can read."""
    from mcap_ros2.decoder import DecoderFactory

    return json.loads if encoding == "json" else DecoderFactory().decoder_for(encoding, schema)


def _numbers(message: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The numbers of a message by name: floats, lists of floats, and times as whole nanoseconds."""
    fields = _fields(message)
    if fields is None:
        yield from _number(message, name)
        return
    for sec, nanosec in _STAMPS:
        if set(fields) == {sec, nanosec}:
            yield name, int(fields[sec]) * 10**9 + int(fields[nanosec])
            return
    labels = [value for value in fields.values() if _is_list(value) and len(value) and _are(value, str)]
    for key, value in fields.items():
        here = f"{name}/{key}" if name else key
        if not _is_list(value):
            yield from _numbers(value, here)
            continue
        own = next((label for label in labels if len(label) == len(value)), None)
        if own is None and _are(value, int | float):
            yield here, [float(one) for one in value]
            continue
        for label, one in zip(own or range(1, len(value) + 1), value, strict=True):
            yield from _numbers(one, f"{here}/{label}")


def _number(value: Any, name: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, int | float):
        yield name, float(value)


def _is_list(value: Any) -> bool:
    return hasattr(value, "__len__") and not isinstance(value, str | bytes | Mapping)


def _are(values: Iterable[Any], kind: Any) -> bool:
    return all(isinstance(value, kind) for value in values)


def _fields(message: Any) -> Mapping[str, Any] | None:
    """The fields of a message, decoded from CDR or JSON; None for a single value."""
    if isinstance(message, Mapping):
        return message
    names = getattr(message, "__slots__", None)
    return None if names is None else {name: getattr(message, name) for name in names if not name.startswith("_")}
