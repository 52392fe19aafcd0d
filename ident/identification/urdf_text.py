"""The text of a URDF with other inertias in it: every other byte, comments and line ends included, stays."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from symgen.chain import Inertia

_TAG = re.compile(rb"""<(?:[^<>"']|"[^"]*"|'[^']*')*>""")
_ENCODING = re.compile(r"""(<\?xml[^>]*?encoding\s*=\s*["'])[^"']*""")


def read_inertias(text: str) -> dict[str, Inertia | None]:
    """Returns the <inertial> of every link of a sound URDF, in link axes; None where a link has none."""
    root = ET.fromstring(text.removeprefix("\ufeff").encode(), ET.XMLParser(encoding="utf-8"))
    return {link.get("name", ""): _inertia(link.find("inertial")) for link in root.findall("link")}


def _inertia(element: ET.Element | None) -> Inertia | None:
    if element is None:
        return None
    origin, mass, inertia = (element.find(tag) for tag in ("origin", "mass", "inertia"))
    stated = {} if origin is None else origin.attrib
    assert mass is not None and inertia is not None
    xyz, rpy = (np.array(stated.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
    xx, xy, xz, yy, yz, zz = (float(inertia.attrib[key]) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    R = Rotation.from_euler("xyz", rpy).as_matrix()
    return Inertia(float(mass.attrib["value"]), xyz, R @ [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] @ R.T)


def replace_inertias(text: str, bodies: Mapping[str, Inertia], comment: str) -> str:
    """Returns the URDF `text` with the <inertial> of the links in `bodies` replaced, or inserted, in link axes.

    `comment` (lines of text) goes in front of <robot>. Numbers are written with all their digits; the result is UTF-8
    whatever the text declared.
    """
    data = _ENCODING.sub(r"\g<1>utf-8", text, count=1).encode()
    spans = _spans(data)
    edits = [(spans.robot, spans.robot, xml_comment(comment).encode() + b"\n")]
    for name, body in bodies.items():
        start, end = spans.links[name]
        if name in spans.inertials:
            first, last = spans.inertials[name]
            edits.append((first, last, _element(body, _indent(data, first))))
        elif data[end - 2 : end] == b"/>":
            own = _indent(data, start)
            inside = own + b"  "
            edits.append((end - 2, end, b">\n" + inside + _element(body, inside) + b"\n" + own + b"</link>"))
        else:
            inside = _indent(data, start) + b"  "
            edits.append((end, end, b"\n" + inside + _element(body, inside)))
    for first, last, new in sorted(edits, reverse=True):
        data = data[:first] + new + data[last:]
    return data.decode()


def xml_comment(text: str) -> str:
    """Returns the text as an XML comment; two hyphens would end it."""
    return f"<!-- {re.sub('-(?=-)', '- ', text).rstrip('- ')} -->"


@dataclass
class _Spans:
    """Where things stand [bytes]: the <robot> tag, the start tag of each link, the whole <inertial> of each that has one."""

    robot: int = 0
    links: dict[str, tuple[int, int]] = field(default_factory=dict)
    inertials: dict[str, tuple[int, int]] = field(default_factory=dict)


def _spans(data: bytes) -> _Spans:
    found, path, link, begin = _Spans(), list[str](), "", 0
    parser = expat.ParserCreate("utf-8")

    def tag_end(at: int) -> int:
        match = _TAG.match(data, at)
        assert match is not None
        return match.end()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal link, begin
        at = parser.CurrentByteIndex
        path.append(tag)
        if len(path) == 1:
            found.robot = at
        elif path[1:] == ["link"]:
            link = attributes["name"]
            found.links[link] = at, tag_end(at)
        elif path[1:] == ["link", "inertial"]:
            begin = at

    def end(tag: str) -> None:
        if path[1:] == ["link", "inertial"]:
            found.inertials[link] = begin, tag_end(parser.CurrentByteIndex)
        path.pop()

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(data, True)
    return found


def _indent(data: bytes, at: int) -> bytes:
    """The white space in front of a tag that begins its line; else nothing."""
    before = data[data.rfind(b"\n", 0, at) + 1 : at]
    return before if not before.strip() else b""


def _element(body: Inertia, indent: bytes) -> bytes:
    I = body.I
    moments = {"ixx": I[0, 0], "ixy": I[0, 1], "ixz": I[0, 2], "iyy": I[1, 1], "iyz": I[1, 2], "izz": I[2, 2]}
    inertia = " ".join(f'{key}="{_number(value)}"' for key, value in moments.items())
    lines = [
        "<inertial>",
        f'  <origin xyz="{" ".join(map(_number, body.com))}" rpy="0 0 0"/>',
        f'  <mass value="{_number(body.mass)}"/>',
        f"  <inertia {inertia}/>",
        "</inertial>",
    ]
    return (b"\n" + indent).join(line.encode() for line in lines)


def _number(value: float) -> str:
    return repr(float(value) + 0.0)
