"""Read the XMP packet of a photo: tags of DJI, Parrot, Autel, Skydio, Yuneec, Pix4D's `Camera` and panoramas."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import NamedTuple

SPACES = {  # part of a namespace: prefix. `camera` is Pix4D's, also in use by Autel, senseFly, Sentera and MicaSense
    "dji": "dji:", "camera/1.0": "camera:", "drone-parrot": "parrot:", "drone-autel": "autel:",
    "drone-skydio/": "skydio:", "drone-yuneec": "yuneec:", "photos/1.0/panorama": "gpano:",
}  # fmt: skip
RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"
FRAME = (RDF, "{adobe:ns:meta/}", "{http://www.w3.org/XML/1998/namespace}")  # namespaces of enclosing tags
_META = re.compile(r"<(\w{1,40}):xmpmeta\b")
_PREFIX = re.compile(r"[<\s]([a-zA-Z][\w-]{0,39}):\w")


class Xmp(NamedTuple):
    """Values of an XMP packet by name, such as `dji:GimbalYawDegree`."""

    values: dict[str, str]
    fault: str  # what is wrong with the packet; empty: nothing


def parse_xmp(packet: bytes | str) -> Xmp:
    """Parse values from an XMP packet, written as attributes or elements; a damaged packet is read up to the damage.

    A field of a structure is prefixed with the structure's name (`skydio:CameraOrientationNEDYaw`). Items of a list are
    joined by commas.
    """
    text = _text(packet)[:1_000_000]
    if "<!" in text.replace("<!--", ""):  # a document type, which no camera writes, is a known attack
        return Xmp({}, "its XMP has a document type")
    undeclared = set(_PREFIX.findall(text)) - {"xml", "xmlns", *re.findall(r"xmlns:([\w-]+)", text)}
    declared = "".join(f' xmlns:{p}="{p}/1.0"' for p in sorted(undeclared))
    builder, fault = ET.TreeBuilder(), "its XMP is malformed" if declared else ""
    parser = ET.XMLParser(target=builder)
    try:
        parser.feed(re.sub(r"(<[\w:-]+)", rf"\1{declared}", text, count=1))
        root = parser.close()
    except ET.ParseError:
        root, fault = builder.close(), "its XMP is malformed"
    found, elements, lists = dict[str, str](), dict[str, str](), dict[str, list[str]]()
    waiting = [] if root is None else [(root, "")]
    while waiting:
        element, owner = waiting.pop()
        inside = owner if element.tag.startswith(FRAME) else _within(owner, element.tag)
        found |= {_within(inside, k): v.strip() for k, v in element.attrib.items() if not k.startswith(FRAME)}
        waiting += [(child, inside) for child in reversed(element)]
        value = (element.text or "").strip()
        if len(element) or not inside:
            continue
        if element.tag == f"{RDF}li":
            lists.setdefault(inside, []).append(value)
        elif value:
            elements.setdefault(inside, value)
    return Xmp({k: ",".join(v) for k, v in lists.items()} | elements | found, fault)


def _text(packet: bytes | str) -> str:
    text = packet.decode("utf-8", errors="replace") if isinstance(packet, bytes) else packet
    start = _META.search(text)
    end = text.rfind(f"</{start.group(1)}:xmpmeta>") if start else -1
    whole = start is not None and end > start.start()
    return text[start.start() : text.index(">", end) + 1] if start and whole else text.strip("\0\ufeff \r\n\t")


def _within(owner: str, tag: str) -> str:
    """Return the name of a tag or attribute, prefixed with its structure `owner` or, without one, its namespace."""
    space, _, name = tag.rpartition("}")
    prefix = owner[:200] or next((prefix for part, prefix in SPACES.items() if part in space.lower()), "")
    return prefix + name
