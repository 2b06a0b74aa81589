"""A semicircular arch of voussoirs: ``python examples/structures/arch.py [FOLDER [VOUSSOIRS]]``."""

import sys
from pathlib import Path

import numpy as np

import learn2assemble as l2a


def arch(
    voussoirs: int = 9, radius: float = 0.3, thickness: float = 0.08, depth: float = 0.1
) -> l2a.Assembly:
    """Voussoirs with radial joints in the plane y = 0, the two lowest ones on the ground.

    Args:
        voussoirs: how many there are.
        radius: from the middle of the arch to the middle of the thickness of every joint [m].
        thickness: along the radius [m].
        depth: along y [m].
    """
    angles = np.linspace(0, np.pi, voussoirs + 1)
    # Joints from the middle, as x and z, times the inner and outer radius.
    joints = np.stack([np.cos(angles), np.zeros_like(angles), np.sin(angles)], 1)
    joints = joints[:, None] * (radius + np.array([-0.5, 0.5]) * thickness)[:, None]
    half = np.array([0.0, depth / 2, 0.0])
    blocks = []
    for k in range(voussoirs):
        corners = joints[k : k + 2].reshape(-1, 3)
        blocks.append(l2a.hull_block(f"v{k}", np.concatenate([corners - half, corners + half])))
    return l2a.Assembly(tuple(blocks), friction=0.6, name=f"arch_{voussoirs}")


def main() -> None:
    """Write the arch, its plan, and the page and picture of the plan."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/arch")
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 9
    assembly = arch(count) if count < 15 else arch(count, 0.5, 0.14)
    out.mkdir(parents=True, exist_ok=True)
    l2a.write_assembly(assembly, out / f"{assembly.name}.json", overwrite=True)
    print(assembly.name, l2a.check(assembly).verdict)
    plan = l2a.build(assembly, progress=print)
    print(plan.status, plan.reason or "")
    print(*plan.save(out).values(), sep="\n")


if __name__ == "__main__":
    main()
