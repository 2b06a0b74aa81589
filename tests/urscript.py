"""A reader of URScript for tests: a program becomes generators that stand still at whatever takes
time on a controller.

What the reader does not know it refuses, as a controller does: functions, numbers of arguments,
names, blocks that are not closed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Generator
from typing import Any

WAITING = {"servoj", "stopj", "sleep", "sync"}
"""Functions that take time."""
ARITY: dict[str, tuple[int, set[str]]] = {
    "servoj": (1, {"t", "lookahead_time", "gain"}),
    "stopj": (1, set()),
    "sleep": (1, set()),
    "sync": (0, set()),
    "get_steptime": (0, set()),
    "norm": (1, set()),
    "get_tcp_force": (0, set()),
    "zero_ftsensor": (0, set()),
    "get_actual_joint_positions": (0, set()),
    "set_tcp": (1, set()),
    "set_payload": (2, set()),
    "set_tool_digital_out": (2, set()),
    "set_standard_digital_out": (2, set()),
    "get_tool_digital_in": (1, set()),
    "get_standard_digital_in": (1, set()),
    "get_standard_analog_in": (1, set()),
    "write_output_integer_register": (2, set()),
    "read_input_integer_register": (1, set()),
    "textmsg": (1, set()),
}
"""Functions of a controller: arguments in their place, and those by name."""


class ScriptError(Exception):
    """A script that a controller would not take."""


class Halt(Exception):
    """The statement ``halt``."""


class _Expression(ast.NodeTransformer):
    """Calls that take time are waited for; what is not known is refused."""

    def __init__(self, functions: dict[str, int], names: set[str]) -> None:
        self.functions, self.names = functions, names

    def visit_Name(self, node: ast.Name) -> ast.AST:
        if node.id not in self.names:
            raise ScriptError(f"unknown name {node.id}")
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        assert isinstance(node.func, ast.Name)
        name, given = node.func.id, len(node.args)
        node.args = [self.visit(one) for one in node.args]
        for one in node.keywords:
            one.value = self.visit(one.value)
        if name in self.functions:
            if self.functions[name] != given or node.keywords:
                raise ScriptError(f"{name} takes {self.functions[name]} arguments")
            return ast.YieldFrom(node)
        if name not in ARITY:
            raise ScriptError(f"unknown function {name}")
        count, named = ARITY[name]
        if count != given or not {one.arg for one in node.keywords} <= named:
            raise ScriptError(f"{name} takes {count} arguments, and {sorted(named)}")
        node.func = ast.Attribute(ast.Name("controller", ast.Load()), name, ast.Load())
        return ast.YieldFrom(node) if name in WAITING else node


class Script:
    """A program as a controller takes it.

    Args:
        text: one function, and nothing else.

    Raises:
        ScriptError: for what a controller would refuse.
    """

    def __init__(self, text: str) -> None:
        lines = [raw.partition("#")[0].rstrip() for raw in text.splitlines()]
        lines = [line for line in lines if line.strip()]
        self.functions: dict[str, int] = {}
        self.shared = set(re.findall(r"\bglobal (\w+) =", text))
        for name, given in re.findall(r"^\s*def (\w+)\(([^)]*)\):", text, re.M):
            self.functions[name] = len([part for part in given.split(",") if part.strip()])
        self._lines, self._at, self._out = lines, 0, list[str]()
        head = re.fullmatch(r"def (\w+)\(\):", lines[0]) if lines else None
        if head is None:
            raise ScriptError("no function")
        self.main = head[1]
        self._function()
        if self._at != len(lines):
            raise ScriptError("something after the program")
        try:
            self.code = compile("\n".join(self._out), "script", "exec")
        except SyntaxError as error:
            raise ScriptError(str(error)) from None

    def run(self, controller: Any) -> Generator[None, None, None]:
        """The program in a controller, which has its functions as methods."""
        names: dict[str, Any] = {"controller": controller, "Halt": Halt}
        exec(self.code, names)
        return names[self.main]()

    def _function(self) -> None:
        """A function, with those inside it before it."""
        line = self._next().strip()
        head = re.fullmatch(r"def (\w+)\(([^)]*)\):", line)
        if head is None:
            raise ScriptError(line)
        given = {part.strip() for part in head[2].split(",") if part.strip()}
        body = self._block(1, given | self.shared | {"True", "False"})
        shared = f"    global {', '.join(sorted(self.shared))}" if self.shared else "    pass"
        ends = "    return\n    yield"
        self._out += [f"def {head[1]}({head[2]}):", shared, *body, ends]

    def _block(self, depth: int, names: set[str]) -> list[str]:
        """The statements up to the ``end`` of a block."""
        out, indent = [], "    " * depth
        while True:
            if self._at == len(self._lines):
                raise ScriptError("a block is not closed")
            line = self._lines[self._at].strip()
            if line.startswith("def "):
                self._function()
                continue
            self._at += 1
            if line == "end":
                return out or [f"{indent}pass"]
            if line in ("else:",) or line.startswith("elif "):
                text = line if line == "else:" else f"elif {self._read(line[5:-1], names)}:"
                out += [f"{indent[4:]}{text}", f"{indent}pass"]
            elif re.match(r"(if|while)\b.*:$", line):
                word, rest = line[:-1].split(maxsplit=1)
                out.append(f"{indent}{word} {self._read(rest, names)}:")
                out += self._block(depth + 1, names)
            elif line == "halt":
                out.append(f"{indent}raise Halt")
            elif line.startswith("return"):
                out.append(f"{indent}return {self._read(line[6:], names)}")
            elif found := re.fullmatch(r"(local |global |)(\w+) = (.*)", line):
                value = self._read(found[3], names)
                if not found[1] and found[2] not in names:
                    raise ScriptError(f"unknown name {found[2]}")
                names.add(found[2])
                out.append(f"{indent}{found[2]} = {value}")
            else:
                out.append(f"{indent}{self._read(line, names)}")

    def _next(self) -> str:
        self._at += 1
        return self._lines[self._at - 1]

    def _read(self, text: str, names: set[str]) -> str:
        try:
            tree = ast.parse(re.sub(r"\bp\[", "[", text.strip()), mode="eval")
        except SyntaxError:
            raise ScriptError(text) from None
        body = _Expression(self.functions, names).visit(tree.body)
        return f"({ast.unparse(ast.fix_missing_locations(body))})"
