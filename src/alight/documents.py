"""YAML, JSON and plain text from outside, within limits of size and depth that no settings file or scene exceeds."""

from __future__ import annotations

import json
import math
import os
import re
import sys
import unicodedata
from collections import Counter
from collections.abc import Hashable
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

LONGEST = 1_000_000  # bytes of a YAML file; Alight's largest one has 20,000
LARGEST_JSON = 64_000_000  # bytes
DEEPEST = 40  # levels of nested mappings and lists
DEEP = f"nested more than {DEEPEST} deep; write it flat"
MOST_VALUES = 50_000  # values in a YAML document; an alias counts each time it is used
PLAIN = {  # words of pydantic, in this order
    "Value error, ": "",
    "Input should be ": "must be ",
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    "greater than": "more than",
    ", unable to parse string as a number": "",
    ", unable to parse string as an integer": "",
    ", got a number with a fractional part": "",
    "a valid number": "a number",
    "a valid integer": "a whole number",
    "a valid boolean, unable to interpret input": "true or false",
}

Model = TypeVar("Model", bound=BaseModel)


class DocumentError(ValueError):
    """A text that is not a valid document; the message gives the reason in one line."""


def read_bytes(path: Path, largest: int) -> bytes:
    """Return the bytes of a plain file.

    Raises:
        DocumentError: the path is a pipe or device, which may never end, or the file is larger than `largest` bytes.
        OSError: the file cannot be read.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise DocumentError("is a pipe or a device; give a plain file")
    with path.open("rb") as file:
        if os.fstat(file.fileno()).st_size > largest:
            raise DocumentError(f"is larger than {largest / 1e6:g} MB; give the right file")
        return file.read()


def read_text(path: Path, largest: int = LONGEST) -> str:
    """Return the text of a plain UTF-8 file, without its byte order mark.

    Raises:
        DocumentError: the file is not UTF-8 text, or `read_bytes` refuses it.
        OSError: the file cannot be read.
    """
    try:
        return read_bytes(path, largest).decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise DocumentError("not text in UTF-8; give a text file") from e


class _Loader(yaml.SafeLoader):
    """YAML loader without dates, octal or sexagesimal numbers; the keys of a mapping are strings and unique."""

    _merged = 0  # number of values that merge keys have added

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Expand merge keys (`<<`); refuse too many merged values, because a few lines can merge into billions."""
        named = [value for key, value in node.value if key.tag == "tag:yaml.org,2002:merge"]
        listed = [v for value in named for v in (value.value if isinstance(value, yaml.SequenceNode) else [value])]
        for source in (v for v in listed if isinstance(v, yaml.MappingNode)):
            self.flatten_mapping(source)
            self._merged += len(source.value)
            if self._merged > MOST_VALUES:
                raise DocumentError(f"more than {MOST_VALUES} values, merged ones written out; write it shorter")
        super().flatten_mapping(node)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Construct a mapping; refuse keys that are repeated or not strings."""
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        if twice := [name for name, count in Counter(names).items() if count > 1]:
            raise DocumentError(f"the key {twice[0][:40]!r} stands twice; write it once")
        tree = super().construct_mapping(node, deep=deep)
        for key in tree:
            if not isinstance(key, str):
                raise DocumentError(f"the key {str(key)[:40]!r} is no word; put it into quotes")
        return tree

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        return int(node.value)


_NUMBERS = {
    "tag:yaml.org,2002:int": r"[-+]?[0-9]+$",
    "tag:yaml.org,2002:float": (
        r"[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?$|[-+]?\.(?:inf|Inf|INF)$|\.(?:nan|NaN|NAN)$"
    ),
}
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in some if tag not in {"tag:yaml.org,2002:timestamp", *_NUMBERS}]
    for first, some in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _tag, _pattern in _NUMBERS.items():
    _Loader.add_implicit_resolver(_tag, re.compile(_pattern), list("-+.0123456789"))


def parse_yaml(text: str) -> Any:
    """Parse a YAML text into mappings, lists, strings, numbers, booleans and None.

    Raises:
        DocumentError: the text is not valid YAML, is too deep, is too large with its aliases expanded, or holds a value
            of any other type.
    """
    if len(text) > LONGEST:
        raise DocumentError(f"not valid YAML: longer than {LONGEST} characters")
    try:
        tree = yaml.load(text, _Loader)
        _check(tree, MOST_VALUES)
    except yaml.YAMLError as e:
        mark = getattr(e, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark is not None else ""
        why = " ".join(str(getattr(e, "problem", None) or e).split())[:300].replace("'<stream end>'", "the end")
        raise DocumentError(f"not valid YAML{where}: {why}") from e
    except RecursionError as e:
        raise DocumentError(DEEP) from e
    except DocumentError:
        raise
    except (ValueError, TypeError, OverflowError, AttributeError) as e:
        raise DocumentError(f"not valid YAML: {' '.join(str(e).split())[:300]}") from e
    return tree


def parse_json(text: str | bytes) -> Any:
    """Parse a JSON text into mappings, lists, strings, numbers, booleans and None.

    Raises:
        DocumentError: the text is not valid JSON, is too deep, or holds integers beyond 64 bits.
    """
    try:
        tree = json.loads(text)
    except RecursionError as e:
        raise DocumentError(DEEP) from e
    except ValueError as e:
        raise DocumentError(f"not valid JSON: {e}") from e
    _check(tree, math.inf)
    return tree


def validated(kind: type[Model], tree: Any) -> Model:
    """Validate the value of a parsed document as a record of type `kind`, and return the record.

    Raises:
        DocumentError: a key is missing, unknown or of a wrong type; the message names the first such key.
    """
    try:
        return kind.model_validate(tree)
    except ValidationError as e:
        first = e.errors(include_url=False)[0]
        key = ".".join(str(part)[:40] for part in first["loc"])
        raise DocumentError(f"{key or 'it'} is damaged ({first['msg'].lower()})") from e


def plain_words(message: str) -> str:
    """Return the message of a failed validation in plain words, such as "must be at least 1"."""
    for theirs, ours in PLAIN.items():
        message = message.replace(theirs, ours)
    return message


def _check(tree: Any, most: float) -> None:
    """Refuse a tree with too deep nesting, more than `most` values, too large integers, or values that JSON lacks."""
    waiting, count = [(tree, 0)], 0
    while waiting:
        (value, depth), count = waiting.pop(), count + 1
        if depth > DEEPEST:
            raise DocumentError(DEEP)
        if count > most:
            raise DocumentError(f"more than {most} values, aliases written out; write it shorter")
        if isinstance(value, float):  # first: a file of zones has a hundred thousand
            continue
        if isinstance(value, dict | list):
            waiting += [(v, depth + 1) for v in (value.values() if isinstance(value, dict) else value)]
        elif isinstance(value, int) and abs(value) > sys.maxsize:
            raise DocumentError("an integer of more than 19 digits; check the number")
        elif not isinstance(value, str | int | None):
            raise DocumentError(f"a {type(value).__name__} is neither a word nor a number; put it into quotes")


def printable(text: str) -> str:
    """Return text from outside with the characters escaped that control a terminal or the writing direction.

    Line breaks, tabs and spaces of any width stay.
    """
    escaped = {c for c in set(text) if not c.isprintable() and c not in "\n\t" and unicodedata.category(c) != "Zs"}
    return text if not escaped else text.translate({ord(c): c.encode("unicode_escape").decode() for c in escaped})
