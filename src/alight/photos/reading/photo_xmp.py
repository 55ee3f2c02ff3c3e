"""The XMP packet of a photo as names and values: tags of DJI, Parrot, Autel, Skydio, Yuneec and Pix4D's `Camera`."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

SPACES = {  # parts of XMP namespaces: DJI, Pix4D (also Autel, senseFly, Sentera, MicaSense), Parrot, Autel, ...
    "dji": "dji:", "camera/1.0": "camera:", "drone-parrot": "parrot:", "drone-autel": "autel:",
    "drone-skydio/": "skydio:", "drone-yuneec": "yuneec:",
}  # fmt: skip
RDF = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}"
ITEM = f"{RDF}li"
FRAME = (RDF, "{adobe:ns:meta/}", "{http://www.w3.org/XML/1998/namespace}")  # tags that enclose values and name none
_META = re.compile(r"<(\w{1,40}):xmpmeta\b")
_NAME = r"([\w-]{1,40}):(\w{1,80})"
_DECLARED = re.compile(r"""xmlns:([\w-]{1,40})\s*=\s*["']([^"'<>]*)["']""")
_ATTRIBUTE = re.compile(rf"""\s{_NAME}\s*=\s*["']([^"'<>]*)["']""")
_ELEMENT = re.compile(rf"<{_NAME}(?:\s[^<>]*)?>([^<>]*)</\1:\2\s*>")
_LIST = re.compile(rf"<{_NAME}(?:\s[^<>]*)?>\s*<rdf:(?:Seq|Bag|Alt)>((?:\s*<rdf:li[^<>]*>[^<>]*</rdf:li>)*)")
_ITEM = re.compile(r"<rdf:li[^<>]*>([^<>]*)<")


def parse_xmp(packet: bytes | str) -> dict[str, str]:
    """Take values from an XMP packet, written as attributes or as elements.

    A part of a structure has the structure's name before its own (`skydio:CameraOrientationNEDYaw`), the items of a
    list are joined by commas.

    Raises:
        ValueError: the packet is no XML.
    """
    text = _text(packet)
    if "<!" in text.replace("<!--", ""):  # a document type: no camera writes one, and it is a known attack
        raise ValueError("its XMP has a document type")
    try:
        root = ET.fromstring(text.strip("\0\ufeff \r\n\t"))
    except ET.ParseError as e:
        raise ValueError("its XMP is malformed") from e
    found, elements, lists = dict[str, str](), dict[str, str](), dict[str, list[str]]()
    waiting = [(root, "")]
    while waiting:
        element, owner = waiting.pop()
        inside = owner if element.tag.startswith(FRAME) else _within(owner, element.tag)
        found |= {_within(inside, k): v.strip() for k, v in element.attrib.items() if not k.startswith(FRAME)}
        waiting += [(child, inside) for child in reversed(element)]
        value = (element.text or "").strip()
        if len(element) or not inside:
            continue
        if element.tag == ITEM:
            lists.setdefault(inside, []).append(value)
        elif value:
            elements.setdefault(inside, value)
    return {k: ",".join(v) for k, v in lists.items()} | elements | found


def salvage_xmp(packet: bytes | str) -> dict[str, str]:
    """Extract values from a packet that is no valid XML, such as one with an undeclared prefix."""
    text = _text(packet)[:1_000_000]  # that much of a damaged packet is searched
    spaces = dict(_DECLARED.findall(text))

    def key(prefix: str, name: str) -> str:
        return _qualified(spaces.get(prefix, f"{prefix}/1.0"), name)

    lists = {key(p, n): ",".join(v.strip() for v in _ITEM.findall(items)) for p, n, items in _LIST.findall(text)}
    elements = {key(p, n): v.strip() for p, n, v in _ELEMENT.findall(text) if p != "rdf"}
    attributes = {key(p, n): v.strip() for p, n, v in _ATTRIBUTE.findall(text) if p not in ("rdf", "xml", "xmlns")}
    return {k: v for k, v in (lists | elements | attributes).items() if v}


def _text(packet: bytes | str) -> str:
    text = packet.decode("utf-8", errors="replace") if isinstance(packet, bytes) else packet
    start = _META.search(text)
    end = text.rfind(f"</{start.group(1)}:xmpmeta>") if start else -1
    return text[start.start() : text.index(">", end) + 1] if start and end > start.start() else text


def _within(owner: str, tag: str) -> str:
    """The name of a tag or attribute, in a structure or (owner "") by itself."""
    space, _, name = tag.rpartition("}")
    return owner + name if owner else _qualified(space, name)


def _qualified(space: str, name: str) -> str:
    return next((prefix for part, prefix in SPACES.items() if part in space.lower()), "") + name
