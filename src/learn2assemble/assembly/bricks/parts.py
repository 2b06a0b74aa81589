"""Parts and colours of LDraw: its numbers for the bricks and plates that are known here.

Lengths of LDraw are units of 0.4 mm (LDU): studs of small bricks are 20 apart, a brick is 24 high.
"""

from __future__ import annotations

import difflib
import re

from learn2assemble.errors import InputError

LDU = 0.4e-3
"""[m]."""
_SMALL = {
    "1x1": ("3005", "3024"),
    "1x2": ("3004", "3023"),
    "1x3": ("3622", "3623"),
    "1x4": ("3010", "3710"),
    "1x6": ("3009", "3666"),
    "1x8": ("3008", "3460"),
    "2x2": ("3003", "3022"),
    "2x3": ("3002", "3021"),
    "2x4": ("3001", "3020"),
    "2x6": ("2456", "3795"),
    "2x8": ("3007", "3034"),
}
"""Brick and plate of every size in studs."""
_LARGE = {"2x2": "3437", "2x4": "3011", "2x6": "2300", "2x8": "4199"}
"""Duplo bricks."""


def _table() -> dict[str, tuple[int, int, int]]:
    made: dict[str, tuple[int, int, int]] = {}
    for size, (brick, plate) in _SMALL.items():
        a, b = map(int, size.split("x"))
        made[brick], made[plate] = (20 * b, 20 * a, 24), (20 * b, 20 * a, 8)
    for size, part in _LARGE.items():
        a, b = map(int, size.split("x"))
        made[part] = (40 * b, 40 * a, 48)
    return made


SIZES = _table()
"""Extents [LDU] of a part along its x and z, and its height."""
PARTS = {size: part for part, size in SIZES.items()}
_NAME = re.compile(r"(?:.*/)?(\d+)([a-z]?)(?:p[a-z0-9]+)?\.dat")
"""A variant (``3001b``) or a printed part (``3001p01``) has the shape of its part."""


def size_of_part(name: str, where: str) -> tuple[int, int, int]:
    """The extents of a part along its x and z, and its height [LDU].

    Raises:
        InputError: for a part that is not known, with the nearest one that is.
    """
    plain = name.lower().replace("\\", "/")
    found = _NAME.fullmatch(plain)
    if found is not None and found[1] in SIZES:
        return SIZES[found[1]]
    if plain.endswith((".ldr", ".mpd")):
        raise InputError(f"{where}: part", name, "a submodel that is in the same file")
    stem = plain.rsplit("/", 1)[-1].removesuffix(".dat")
    near = difflib.get_close_matches(stem, SIZES, n=1, cutoff=0.0)
    known = ", ".join(f"{part}.dat ({part_words(part)})" for part in near)
    raise InputError(f"{where}: part", name, f"a brick or plate up to 2x8, nearest {known}")


def part_words(part: str) -> str:
    """What a part is, in words: ``plate 2x4``."""
    x, z, height = SIZES[part]
    stud = 40 if height == 48 else 20
    kind = {8: "plate", 24: "brick", 48: "large brick"}[height]
    return f"{kind} {z // stud}x{x // stud}"


def _rgb(digits: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(digits)
    return red, green, blue


COLOURS = {
    int(code): _rgb(digits)
    for code, digits in (
        pair.split(":")
        for pair in [
            "0:1B2A34",
            "1:0055BF",
            "2:257A3E",
            "3:00838F",
            "4:C91A09",
            "5:C870A0",
            "6:583927",
            "7:9BA19D",
            "8:6D6E5C",
            "9:B4D2E3",
            "10:4B9F4A",
            "11:55A5AF",
            "12:F2705E",
            "13:FC97AC",
            "14:F2CD37",
            "15:FFFFFF",
            "17:C2DAB8",
            "18:FBE696",
            "19:E4CD9E",
            "20:C9CAE2",
            "22:81007B",
            "23:2032B0",
            "25:FE8A18",
            "26:923978",
            "27:BBE90B",
            "28:958A73",
            "29:E4ADC8",
            "30:AC78BA",
            "31:E1D5ED",
            "68:F3CF9B",
            "69:CD6298",
            "70:582A12",
            "71:A0A5A9",
            "72:6C6E68",
            "73:5C9DD1",
            "74:73DCA1",
            "77:FECCCF",
            "78:F6D7B3",
            "84:CC702A",
            "85:3F3691",
            "86:7C503A",
            "89:4C61DB",
            "92:D09168",
            "100:FEBABD",
            "110:4354A3",
            "112:6874CA",
            "115:C7D23C",
            "118:B3D7D1",
            "120:D9E4A7",
            "125:F9BA61",
            "151:E6E3E0",
            "191:F8BB3D",
            "212:86C1E1",
            "216:B31004",
            "226:FFF03A",
            "232:56BED6",
            "272:0D325B",
            "288:184632",
            "308:352100",
            "313:54A9C8",
            "320:720E0F",
            "321:1498D7",
            "322:3EC2DD",
            "323:BDDCD8",
            "326:DFEEA5",
            "330:9B9A5A",
            "335:D67572",
            "351:F785B1",
            "366:FA9C1C",
            "373:845E84",
            "378:A0BCAC",
            "379:597184",
            "450:B67B50",
            "462:FFA70B",
            "484:A95500",
            "503:E6E3DA",
        ]
    )
}
"""Opaque colours of LDConfig.ldr by code."""
CODES = {rgb: code for code, rgb in reversed(COLOURS.items())}
MAIN = 16
"""The code of what is coloured by whatever holds it."""


def code_of(colour: tuple[int, int, int] | None) -> str:
    """How a colour is written: its code, or as a direct colour where the table has none."""
    if colour is None:
        return str(MAIN)
    code = CODES.get(colour)
    return "0x2{:02X}{:02X}{:02X}".format(*colour) if code is None else str(code)
