"""Files of bricks: which kind one is, and the assembly it holds."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, Literal

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.assembly.bricks import brick_text, ldraw, stablelego
from learn2assemble.assembly.bricks.model import assembly_of, brick_layers
from learn2assemble.assembly.kit import Kit, load_kit
from learn2assemble.errors import InputError
from learn2assemble.files import decoded

DEFAULT_KIT, LARGE_KIT = "lego", "duplo"
BrickFormat = Literal["ldraw", "brick text"]


def brick_format(content: bytes) -> BrickFormat | None:
    """What kind of text of bricks a file is, or None."""
    start = content[:4096].removeprefix(b"\xef\xbb\xbf")
    if brick_text.BEGIN.match(start):
        return "brick text"
    if start.lstrip()[:1] in (b"0", b"1") and ldraw.BEGIN.search(content[:200_000]):
        return "ldraw"
    return None


def is_of_bricks(content: bytes) -> bool:
    """Whether a file, by its content, is one of bricks: such a text, or JSON of StableLego."""
    start = content[:4096].removeprefix(b"\xef\xbb\xbf").lstrip()
    if start[:1] == b"{":
        foreign = re.search(rb'"(format|dtype)"\s*:', start)
        return not foreign and re.search(rb'"(bricks|brick_id)"\s*:', start) is not None
    return brick_format(content) is not None


def read_bricks(content: bytes, source: str, name: str, kit: str | Kit | None) -> Assembly:
    """The assembly of a text of bricks.

    Args:
        content: of the file, of which :func:`brick_format` knows the kind.
        source: what messages call it.
        name: of the model, where the file has none.
        kit: whose blocks they are; by default ``lego``, and ``duplo`` where all parts of an LDraw
            file are large ones.

    Raises:
        InputError: for what is wrong, in one line.
    """
    if content.count(b"\n") > ldraw.MAX_LINES:
        got = f"{content.count(bytes([10]))} lines"
        raise InputError(source, got, f"at most {ldraw.MAX_LINES}")
    text = decoded(content, source)
    blocks = _kit(kit)
    if brick_format(content) != "ldraw":
        model = brick_text.parse_brick_text(text, source, brick_layers(blocks), name)
        return assembly_of(model, blocks, source)
    try:
        return assembly_of(ldraw.parse_ldraw(text, source, blocks, name), blocks, source)
    except InputError as error:
        # A file of parts does not say whose they are, and large ones fit no small kit.
        if kit is not None:
            raise
        blocks = load_kit(LARGE_KIT)
        try:
            return assembly_of(ldraw.parse_ldraw(text, source, blocks, name), blocks, source)
        except InputError:
            raise error from None


def of_stablelego(document: Any, source: str, name: str, kit: str | Kit | None) -> Assembly:
    """The assembly of a JSON document that :func:`.stablelego.is_stablelego` knows."""
    blocks = _kit(kit)
    model = stablelego.parse_stablelego(document, source, brick_layers(blocks))
    return assembly_of(model if model.name else replace(model, name=name), blocks, source)


def _kit(kit: str | Kit | None) -> Kit:
    return kit if isinstance(kit, Kit) else load_kit(kit or DEFAULT_KIT)
