"""States of bricks that clutch, all of them looked at.

Products are those of the fourth tier of WorkBenchMark (CC BY 4.0).
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from l2a_lab.press_orders import MOST_BRICKS, press_orders
from l2a_lab.workbenchmark import LAYER, Brick, Task, product_of
from learn2assemble.assembly.blocks import Assembly
from learn2assemble.errors import InputError

# Extents [studs], the middle [half studs], and the layer of every brick.
PRODUCTS = {
    5: (
        *("22 -4 24 0", "22 -4 20 0", "22 -8 20 0", "42 -6 22 1", "22 -4 26 1", "42 -6 18 1"),
        *("42 -6 22 2", "24 -6 16 2", "22 -6 26 2", "24 -6 20 3", "42 -6 26 3"),
    ),
    48: (
        *("22 4 24 0", "22 8 26 0", "42 14 26 0", "24 10 26 1", "24 6 26 1", "24 16 26 1"),
        *("42 10 26 2", "42 10 26 3", "22 8 30 2"),
    ),
    66: (
        *("22 4 20 0", "22 8 20 0", "22 8 16 0", "22 6 18 1", "42 6 18 2", "22 6 18 3"),
        *("22 8 22 1", "22 10 18 1", "24 8 24 2", "24 6 24 3", "22 6 22 4"),
    ),
}
HALF = 0.008
"""Half a stud [m]."""


def product(*lines: str) -> Assembly:
    made = []
    for n, line in enumerate(lines):
        size, x, y, layer = line.split()
        kind = "brick_2x2" if size == "22" else "brick_4x2"
        at = int(x) * HALF, int(y) * HALF, int(layer) * LAYER
        made.append(Brick(f"b{n}", kind, "red", at, 90.0 if size == "24" else 0.0))
    return product_of(Task(4, 0, tuple(made), tuple(made)))


@pytest.mark.parametrize("number", [5, 66])
def test_two_products_have_no_order_that_bears_its_presses(number: int) -> None:
    found = press_orders(product(*PRODUCTS[number]))
    assert not found.alone
    assert not found.beside
    assert found.states > 1


def test_the_presses_are_what_forbids_an_order() -> None:
    """The same product is built where it is put together without force."""
    made = product(*PRODUCTS[66])
    assert press_orders(replace(made, joint=replace(made.joint, press=0.0))).beside


def test_a_product_that_takes_parts_built_beside_has_no_order_of_single_bricks() -> None:
    found = press_orders(product(*PRODUCTS[48]))
    assert not found.alone
    assert found.beside


def test_a_tower_has_an_order_of_single_bricks() -> None:
    found = press_orders(product("22 0 0 0", "22 0 0 1", "22 0 0 2"))
    assert found.alone
    assert found.beside
    assert found.states == 4


def test_what_falls_has_no_order() -> None:
    """Bricks that reach out one stud each, without the strength to."""
    lines = [f"22 {2 * k} 0 {k}" for k in range(6)]
    made = product(*lines)
    assert not press_orders(replace(made, joint=replace(made.joint, capacity=0.0))).beside


def test_many_bricks_are_refused() -> None:
    lines = [f"22 0 0 {k}" for k in range(MOST_BRICKS + 1)]
    with pytest.raises(InputError, match="all states are looked at"):
        press_orders(product(*lines))
