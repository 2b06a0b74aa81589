"""A dome of rings of voussoirs: ``python examples/structures/dome.py [FOLDER]``."""

import sys
from pathlib import Path

import numpy as np

import learn2assemble as l2a


def dome(
    rings: int = 10,
    voussoirs: int = 12,
    radius: float = 0.5,
    thickness: float = 0.1,
    top: float = 80.0,
    key: bool = True,
) -> l2a.Assembly:
    """Rings of voussoirs with radial joints, on the ground, with a key stone or an open eye.

    Every joint is a plane through the middle of the dome, so the voussoirs of all rings stand
    over one another.

    Args:
        rings: one on the other.
        voussoirs: of a ring.
        radius: to the middle of the thickness at every corner [m].
        thickness: along the radius [m].
        top: elevation of the upper edge of the last ring, seen from the middle [deg].
        key: whether a stone closes the eye.
    """
    up, round_ = np.radians(np.linspace(0, top, rings + 1)), np.arange(voussoirs + 1)
    round_ = 2 * np.pi / voussoirs * (round_ % voussoirs)
    up, round_ = up[:, None], round_[None]
    sphere = np.stack(
        np.broadcast_arrays(np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)),
        -1,
    )
    shells = np.stack([(radius + side * thickness / 2) * sphere for side in (-1, 1)])
    blocks = []
    for ring in range(rings):
        for k in range(voussoirs):
            corners = shells[:, ring : ring + 2, k : k + 2].reshape(-1, 3)
            blocks.append(l2a.hull_block(f"r{ring}v{k}", corners))
    if key:
        blocks.append(l2a.hull_block("key", shells[:, -1, :-1].reshape(-1, 3)))
    return l2a.Assembly(tuple(blocks), friction=0.6, name="dome")


def main() -> None:
    """Write the dome, its plan, and the page and picture of the plan."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/dome")
    assembly = dome()
    out.mkdir(parents=True, exist_ok=True)
    l2a.write_assembly(assembly, out / f"{assembly.name}.json", overwrite=True)
    print(assembly.name, l2a.check(assembly).verdict)
    plan = l2a.build(assembly, progress=print)
    print(plan.status, plan.reason or "")
    print(*plan.save(out).values(), sep="\n")


if __name__ == "__main__":
    main()
