"""Stand-alone HTML pages: one file that asks for nothing, and runs only its own scripts."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Collection, Iterable, Mapping
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from learn2assemble.values import rounded_array

NUMBER = 'class="number"'
"""Attribute of a cell with a number."""


def stand_alone(
    values: Mapping[str, str],
    data: Mapping[str, Any],
    scripts: Collection[str],
    sections: Iterable[str],
) -> str:
    """The text of a page.

    Its content security policy allows only the scripts and the style whose hashes it names, so
    text from a file can never run.

    Args:
        values: HTML for the places of the templates; places without a value stay empty.
        data: what the scripts find in the element ``data``.
        scripts: names of assets, in order; without any the page has no data either.
        sections: names of the assets with the sections of this page, in order.
    """
    texts = [asset(name).strip() + "\n" for name in scripts]
    style = asset("page.css")
    allowed = " ".join(map(_hash, texts)) or "'none'"
    policy = (
        "default-src 'none'; img-src data: blob:; base-uri 'none'; form-action 'none'; "
        f"style-src {_hash(style)}; script-src {allowed}"
    )
    elements = [f'<script type="application/json" id="data">{to_json(data)}</script>']
    elements += [f"<script>{text}</script>" for text in texts]
    places = {
        **values,
        "policy": policy,
        "style": style,
        "scripts": "\n".join(elements if texts else ()),
        "sections": "".join(_filled(asset(name), values) for name in sections),
    }
    return _filled(asset("page.html"), places)


def _filled(template: str, places: Mapping[str, str]) -> str:
    """A template with its places filled in one pass, so that braces in a value stay."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: places.get(match[1], ""), template)


def asset(name: str) -> str:
    return (resources.files("learn2assemble.viewer") / "assets" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def to_json(value: Any) -> str:
    """JSON that cannot end the script element it stands in; arrays are rounded to 1e-6."""

    def listed(array: np.ndarray) -> Any:
        return rounded_array(array).tolist()

    text = json.dumps(
        value, ensure_ascii=True, allow_nan=False, separators=(",", ":"), default=listed
    )
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def row(cells: Iterable[str], attributes: Mapping[int, str], key: str = "", label: str = "") -> str:
    """A row of a table.

    Args:
        cells: HTML.
        attributes: of some of the cells, by column.
        key: attribute of the row and of the button that its first cell becomes.
        label: what the button does.
    """
    columns = list(cells)
    if key:
        columns[0] = f'<button type="button" {key} aria-label="{label}">{columns[0]}</button>'
    told = [f"<td {attributes[k]}>" if k in attributes else "<td>" for k in range(len(columns))]
    inner = "".join(f"{td}{cell}</td>" for td, cell in zip(told, columns, strict=True))
    return f"<tr{key and f' {key}'}>{inner}</tr>"


def prose(text: str) -> str:
    """Words as HTML, in which what stands between backticks, such as the name of a kit, is code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def fact_list(facts: Iterable[tuple[str, str]]) -> str:
    """Name and value of each fact, for the head of a page."""
    return "".join(
        f'<div><dt>{escape(name)}</dt><dd><span class="{"figure" if len(value) < 9 else "words"}">'
        f"{prose(value)}</span><small></small></dd></div>"
        for name, value in facts
    )


def speed_options(speeds: Iterable[float], chosen: float) -> str:
    """The speeds of the timeline as options of a select."""
    return "".join(
        f'<option value="{speed:g}"{" selected" if speed == chosen else ""}>'
        f"{'½' if speed == 0.5 else f'{speed:g}'}×</option>"
        for speed in speeds
    )


def packed(
    values: np.ndarray, kind: type[np.unsignedinteger], limits: tuple[float, float] | None = None
) -> dict[str, Any]:
    """Columns as whole numbers from their smallest to their largest value, base64."""
    low, high = limits or (values.min(0), values.max(0))
    low, high = (np.broadcast_to(np.asarray(v, float), values.shape[1:]) for v in (low, high))
    levels = np.iinfo(kind).max
    scale = np.maximum(high - low, 1e-9) / levels
    whole = np.round((values - low) / scale).clip(0, levels).astype(kind)
    return {
        "low": [float(f"{v:.9g}") for v in low],
        "scale": [float(f"{v:.9g}") for v in scale],
        "bytes": kind(0).nbytes,
        "data": to_base64(whole),
    }


def to_base64(array: np.ndarray) -> str:
    """Its bytes in little-endian order."""
    return base64.b64encode(array.astype(array.dtype.newbyteorder("<")).tobytes()).decode()
