"""What would make a finished structure of given blocks stand that falls: said with its refusal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from learn2assemble.assembly.blocks import Assembly
from learn2assemble.linear_programs import Clock
from learn2assemble.planning.posts import Post, find_posts
from learn2assemble.planning.sequence import list_ids
from learn2assemble.statics.rigid_blocks import Joints

_MOST = 400
"""Blocks and posts of a structure up to which it is tried."""
_EACH = 6
"""Blocks that move of which posts are tried one at a time."""
_ROUGH = (0.7, 1.0)
"""Coefficients of friction that are tried."""


def what_would_carry(
    assembly: Assembly, moving: Sequence[int], friction: float, clock: Clock
) -> str:
    """What lets blocks stand that fall, in words; empty where nothing that was tried does.

    A post that stays under one of the blocks that move, posts under all of them, or more friction.

    Args:
        assembly: all of the blocks.
        moving: indices of those that move first.
        friction: with which they fall.
    """
    joints, fixed = Joints(assembly), any(block.support for block in assembly.blocks)
    lowest = min(float(b.vertices[:, 2].min()) for b in assembly.blocks if b.support == fixed)
    under: dict[int, Post] = {}
    for post in find_posts(assembly.blocks, joints.faces, lowest if fixed else 0.0):
        if post.carries in moving:
            under.setdefault(post.carries, post)
    tries = [[post] for post in list(under.values())[:_EACH]]
    tries += [list(under.values())] if len(under) > 1 else []
    for posts in tries:
        few = clock.left > 0 and len(assembly.blocks) + len(posts) <= _MOST
        if few and _stand(assembly, posts, friction):
            names = list_ids(assembly.blocks, [post.carries for post in posts])
            return (
                f"with {'a post' if len(posts) == 1 else 'posts'} under {names} to stay it stands"
            )
    few = len(assembly.blocks) <= _MOST
    for more in _ROUGH:
        if few and more > friction and clock.left > 0 and joints.decide(more).result.stands:
            return f"with a friction of {more:g} it stands"
    return ""


def _stand(assembly: Assembly, posts: Sequence[Post], friction: float) -> bool:
    ids = {block.id for block in assembly.blocks}
    more = tuple(
        replace(post.block, id=f"{post.block.id}{'+' * (post.block.id in ids)}", prop=False)
        for post in posts
    )
    whole = replace(assembly, blocks=(*assembly.blocks, *more), steps=(), not_built=())
    return Joints(whole).decide(friction).result.stands
