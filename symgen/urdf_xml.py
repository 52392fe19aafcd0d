"""URDF file -> XML elements and checked numbers. No entity is ever defined, no file read that is not one."""

from __future__ import annotations

import codecs
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

from symgen.chain import Array, readonly
from symgen.errors import UrdfError

MAX_NUMBER = 1e6  # rad, kg, kg m2: anything beyond is a slip, or milli-units
MAX_LENGTH = 1e3  # m: no arm is that long, and the squares of its lengths must leave digits to those of its wrist
_MAX_BYTES = 20_000_000
_MAX_DEPTH = 200  # XML elements within each other; a URDF needs 5, simulator extras 20
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_DECLARATION = re.compile(rb"""<\?xml[^>]*?encoding\s*=\s*["']([A-Za-z0-9._-]+)["']""")
_ENCODING = re.compile(  # Python also calls escapes and compressors "encodings"
    r"utf-?8|utf-?16|(us-)?ascii|iso-?8859-\d+|latin-?1|windows-\d+|cp\d+|gbk|gb2312|gb18030|big5|shift_jis|euc-\w+|koi8-\w"
)


def shown(value: object) -> str:
    """Returns a value of the file as it may stand in a one-line message."""
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


# Bytes and elements --------------------------------------------------------------------------------------------------


def read_bytes(path: Path) -> bytes:
    """Returns the file's bytes. UrdfError if it is no readable regular file or is too large."""
    try:
        if path.is_dir():
            raise UrdfError(f"{path}: a directory; expected a URDF file")
        if not path.exists():
            raise UrdfError(f"{path}: no such file; expected a URDF file")
        if path.suffix == ".xacro":
            raise UrdfError(f"{path}: a xacro macro file; expected a URDF file, run: xacro {path} > out.urdf")
        if not path.is_file():
            raise UrdfError(f"{path}: not a regular file; expected a URDF file")
        if path.stat().st_size > _MAX_BYTES:
            raise UrdfError(f"{path}: larger than {_MAX_BYTES // 10**6} MB; expected a URDF file")
        return path.read_bytes()
    except OSError as error:
        raise UrdfError(f"{path}: cannot be read: {error.strerror}") from None


def decode(data: bytes) -> str:
    """Returns the text of an XML file: by its byte-order mark, else by its declaration, else UTF-8."""
    encoding = "utf-8"
    declared = _DECLARATION.match(data)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif data.startswith(codecs.BOM_UTF8):
        encoding = "utf-8-sig"
    elif declared:
        encoding = declared[1].decode().lower()
        if not _ENCODING.fullmatch(encoding):
            raise UrdfError(f"text encoding {encoding!r} is not supported; expected utf-8")
    try:
        return data.decode(encoding)
    except LookupError:
        raise UrdfError(f"text encoding {encoding!r} is not supported; expected utf-8") from None
    except UnicodeDecodeError as error:
        raise UrdfError(f"not {encoding} text: byte {error.start} is wrong; expected an XML file") from None


def root_element(text: str) -> ET.Element:
    """Returns the <robot> element of a URDF text. UrdfError for bad XML, a DOCTYPE (and with it every entity
    definition), a xacro macro, and any other kind of document."""
    if len(text) > _MAX_BYTES:
        raise UrdfError(f"larger than {_MAX_BYTES // 10**6} MB; expected a URDF")
    if not text.strip("\ufeff \t\r\n"):
        raise UrdfError("empty; expected a <robot> element")
    builder, depth = ET.TreeBuilder(), 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _MAX_DEPTH:
            raise UrdfError(f"XML elements nested deeper than {_MAX_DEPTH}; expected a URDF")
        if tag.startswith("xacro:"):
            raise UrdfError(f"<{shown(tag)[1:-1]}> is a xacro macro; expected a URDF, run: xacro FILE > out.urdf")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    def doctype(*_: object) -> None:
        raise UrdfError("a DOCTYPE is not allowed in a URDF (it can define entities); remove it")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(text.removeprefix("\ufeff"), True)
    except expat.ExpatError as error:
        raise UrdfError(f"not well-formed XML: {error}") from None
    root = builder.close()
    if root.tag != "robot":
        raise UrdfError(f"root element <{shown(root.tag)[1:-1]}>; expected <robot> (a URDF)")
    return root


def only(element: ET.Element, tag: str, where: str) -> ET.Element | None:
    """Returns the one child with this tag, or None. UrdfError if there are several."""
    found = element.findall(tag)
    if len(found) > 1:
        raise UrdfError(f"{where}: {len(found)} <{tag}> elements; expected one")
    return found[0] if found else None


def needed(element: ET.Element, tag: str, where: str) -> ET.Element:
    """Returns the one child with this tag. UrdfError if there is none, or several."""
    found = only(element, tag, where)
    if found is None:
        raise UrdfError(f"{where}: <{tag}> is missing")
    return found


# Attributes ----------------------------------------------------------------------------------------------------------


def attribute(element: ET.Element, key: str, where: str) -> str:
    """Returns the text of an attribute. UrdfError if it is missing."""
    value = element.get(key)
    if value is None:
        raise UrdfError(f"{where}: <{element.tag}> has no attribute {key!r}")
    return value


def number(text: str, what: str, largest: float = MAX_NUMBER) -> float:
    """Returns one finite number; UrdfError naming `what` it is if it is none, or larger than a robot has."""
    if "${" in text:
        raise UrdfError(f"{what}: found {shown(text)}, a xacro expression; run: xacro FILE > out.urdf")
    if not _NUMBER.fullmatch(text.strip()):
        raise UrdfError(f"{what}: found {shown(text)}, expected a finite number")
    value = float(text)
    if abs(value) > largest:
        raise UrdfError(f"{what}: found {shown(text)}, expected at most {largest:g} in size")
    return value


def triple(text: str, what: str, largest: float = MAX_NUMBER) -> Array:
    """Returns three numbers [3]; UrdfError naming `what` they are, as of `number`."""
    words = [text] if "${" in text else text.split()
    if len(words) != 3 and "${" not in text:
        raise UrdfError(f"{what}: found {shown(text)}, expected 3 numbers")
    return readonly([number(word, what, largest) for word in words])
