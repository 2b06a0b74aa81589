"""The file of an agent, ``NAME.safetensors``: weights, and in its header what they are.

A safetensors file is the length of its header (8 bytes, little-endian), the header (JSON: type,
shape and place of every tensor, and words under ``__metadata__``) and the numbers. The description
of an agent is JSON, too, under :data:`KEY` of these words; so it is read without the weights, and
without PyTorch.
"""

from __future__ import annotations

import json
import lzma
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from learn2assemble.errors import InputError
from learn2assemble.files import MAX_BYTES, check_exists, decoded
from learn2assemble.values import load_json, mapping

KEY, PACKED = "agent", ".xz"
_WORDS = "__metadata__"
_LENGTH = 8


def described(description: Mapping[str, Any]) -> dict[str, str]:
    """The metadata of a safetensors file that has the description of an agent."""
    return {KEY: json.dumps(description)}


def read_description(file: Path) -> Mapping[str, Any]:
    """The description in the file of an agent.

    Raises:
        InputError: for a file that does not exist, or has no description.
    """
    header = _header(content_of(file, MAX_BYTES), file)
    words = header.get(_WORDS)
    text = cast("dict[str, object]", words).get(KEY) if isinstance(words, dict) else None
    if not isinstance(text, str):
        raise _refused(file, "no description in its header; agents of two files are not read")
    return mapping(load_json(text, str(file), "agent"), f"{file}: agent")


def bare_weights(file: Path) -> bytes:
    """The file of an agent as it would be without its description, for hashes and comparisons.

    Raises:
        InputError: for what is no file of an agent.
    """
    content = content_of(file)
    header = dict(_header(content, file))
    header.pop(_WORDS, None)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % _LENGTH)  # Numbers begin at a multiple of eight bytes.
    return len(text).to_bytes(_LENGTH, "little") + text + content[_end(content) :]


def content_of(file: Path, most: int = -1) -> bytes:
    """The bytes of the file of an agent, unpacked, or the first ``most``.

    Raises:
        InputError: for a file that cannot be read.
    """
    check_exists(file, "file of an agent")
    try:
        with lzma.open(file) if file.suffix == PACKED else file.open("rb") as stream:
            return stream.read(most)
    except OSError as error:
        raise _refused(file, error.strerror or "unreadable") from None
    except (lzma.LZMAError, EOFError) as error:
        raise _refused(file, str(error)) from None


def _end(content: bytes) -> int:
    """Where the header of a file ends."""
    return _LENGTH + int.from_bytes(content[:_LENGTH], "little")


def _header(content: bytes, file: Path) -> Mapping[str, Any]:
    if len(content) < _LENGTH or _end(content) > min(len(content), MAX_BYTES):
        raise _refused(file, "no header of weights")
    try:
        text = decoded(content[_LENGTH : _end(content)], str(file))
        return mapping(load_json(text, str(file), "header of weights"), str(file))
    except InputError:
        raise _refused(file, "no header of weights") from None


def _refused(file: Path, why: str) -> InputError:
    return InputError("agent", str(file), f"a trained agent ({why})")
