"""Step cards: an HTML document to print, one small drawing a step, to build from by hand."""

from __future__ import annotations

from html import escape

import numpy as np

from learn2assemble.assembly.blocks import Assembly, Block

_STYLE = """
body { font: 12px/1.4 system-ui, sans-serif; margin: 1rem; color: #111; }
h1 { font-size: 1.3rem; } h2 { font-size: 1rem; margin: 1rem 0 .4rem; break-after: avoid; }
main { display: grid; grid-template-columns: repeat(auto-fill, minmax(11rem, 1fr)); gap: .6rem; }
h2 { grid-column: 1 / -1; }
article { border: 1px solid #999; border-radius: 4px; padding: .4rem; break-inside: avoid; }
article b { float: right; } svg { width: 100%; height: 9rem; display: block; }
.below { fill: #e4e4e4; stroke: #bbb; } .beside { fill: #fff; stroke: #777; }
.new { stroke: #000; stroke-width: 2; } .gone { fill: none; stroke: #b00; stroke-dasharray: 3 2; }
path { vector-effect: non-scaling-stroke; stroke-width: 1; }
@media print { body { margin: 0; } main { grid-template-columns: repeat(4, 1fr); } }
"""


def step_cards(assembly: Assembly) -> str:
    """A stand-alone HTML document with a card for every step.

    A card shows the layer of the step from above: what the layer stands on in grey, the layer's
    earlier blocks in white, the block of the step in its colour; a prop that is taken away is
    outlined in red. Layers are heights of the lower faces; where the layer changes, a heading
    names its height. Blocks without steps are shown in the order they are given.
    """
    lower = {b.id: float(b.vertices[:, 2].min()) for b in assembly.blocks}
    upper = {b.id: float(b.vertices[:, 2].max()) for b in assembly.blocks}
    outline = {b.id: _footprint(b) for b in assembly.blocks}
    points = np.concatenate([b.vertices[:, :2] for b in assembly.blocks])
    low, high = points.min(0), points.max(0)
    margin = 0.05 * float((high - low).max())
    view = (low[0] - margin, -high[1] - margin, *(high - low + 2 * margin))
    box = " ".join(f"{value:.4f}" for value in view)
    steps = [(s.place, s.remove) for s in assembly.steps]
    steps = steps or [(b.id, None) for b in assembly.blocks]
    standing = {b.id for b in assembly.blocks if b.support}
    parts, level = [], None
    for number, (place, remove) in enumerate(steps, 1):
        id_ = place or remove or ""
        block = assembly.block(id_)
        if level is None or abs(lower[id_] - level) > 1e-6:
            level = lower[id_]
            parts.append(f"<h2>Layer from {level * 100:.1f} cm</h2>")
        below = [k for k in standing if abs(upper[k] - level) <= 1e-4]
        beside = [k for k in standing if lower[k] <= level + 1e-4 < upper[k] and k != id_]
        paths = "".join(f'<path class="below" d="{outline[k]}"/>' for k in sorted(below))
        paths += "".join(f'<path class="beside" d="{outline[k]}"/>' for k in sorted(beside))
        colour = "#{:02x}{:02x}{:02x}".format(*(block.colour or (214, 164, 65)))
        new = f'class="new" fill="{colour}"' if place else 'class="gone"'
        paths += f'<path {new} d="{outline[id_]}"/>'
        word = "place" if place else "take away"
        prop = " (prop)" if block.prop else ""
        label = f"{word} {escape(block.kind or 'block')} {escape(id_)}{prop}"
        parts.append(
            f"<article><b>{number}</b>{label}"
            f'<svg viewBox="{box}" role="img" aria-label="{label}">{paths}</svg></article>'
        )
        if place:
            standing.add(id_)
        else:
            standing.discard(id_)
    title = escape(assembly.name or "Assembly")
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}: step cards</title>'
        f"<style>{_STYLE}</style><h1>{title}</h1><p>{len(steps)} steps, seen from above; "
        f"grey: what the layer stands on.</p><main>{''.join(parts)}</main></html>\n"
    )


def _footprint(block: Block) -> str:
    """The faces of a block that look up, as an SVG path; y of the drawing points down."""
    path = []
    for face in block.faces:
        corners = block.vertices[list(face)]
        area = np.cross(corners - corners[0], np.roll(corners, -1, 0) - corners[0]).sum(0)
        if area[2] > 1e-9 * max(float(np.abs(area).max()), 1e-300):
            path.append("M" + "L".join(f"{x:.4f} {-y:.4f}" for x, y in corners[:, :2]) + "Z")
    return "".join(path)
