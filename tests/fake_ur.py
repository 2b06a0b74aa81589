"""A controller of Universal Robots for tests: RTDE (port 30004, which the client library does not
let one choose), scripts on a secondary interface, and the dashboard's answer to the model.

Its reader of URScript makes generators of programs, which stand still at whatever takes time on a
controller. What the reader does not know it refuses, as a controller does: functions, numbers of
arguments, names, blocks that are not closed.
"""

from __future__ import annotations

import ast
import contextlib
import re
import socket
import struct
import sys
import threading
from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from fake_controller import CYCLE, FakeController
from learn2assemble.motion.driver import driver_of

RTDE_PORT = 30004
_STOPPED, _PLAYING = 1, 2
_RUNNING = 7


class FakeUr(FakeController):
    """See the module. The vacuum is output 0 of the tool connector, and input 0 says that it is
    made."""

    def __init__(self, host: str) -> None:
        super().__init__(host)
        self.program: Generator[None, None, None] | None = None
        self.outputs: dict[int, int] = {}
        self.inputs: dict[int, int] = {}
        self.scripts = 0
        self._subscribers: list[tuple[socket.socket, list[str]]] = []
        self._open = list[socket.socket]()
        for name, port, serve in (
            ("rtde", RTDE_PORT, self._rtde),
            ("script", 0, self._script),
            ("dashboard", 29999, self._dashboard),
        ):
            listener = socket.create_server((host, port))
            self.ports[name] = listener.getsockname()[1]
            threading.Thread(target=self._accept, args=(listener, serve), daemon=True).start()

    # ------------------------------------------------------------ the program

    def cycle(self) -> None:
        """One step of the program."""
        if self.program is None:
            return
        try:
            next(self.program)
        except (StopIteration, Halt, RuntimeError):
            self.program = None

    def end(self) -> None:
        """The program is over."""
        self.program = None

    def busy(self) -> bool:
        """See the base."""
        return self.program is not None

    def open(self) -> list[socket.socket]:
        """See the base."""
        return list(self._open)

    def heard(self) -> bool:
        """See the base."""
        return bool(self._subscribers)

    def servoj(
        self, q: list[float], t: float = 0.002, lookahead_time: float = 0.1, gain: int = 300
    ) -> Generator[None, None, None]:
        """The drives follow smoothly, critically damped: a step of a milliradian where a program
        begins would push with 40 N what is pressed on something."""
        for _ in range(max(round(t / CYCLE), 1)):
            speed, off = self.speed * self.slow, (np.array(q) - self.told) / lookahead_time
            faster = speed + (off - 2 * speed) / lookahead_time * CYCLE
            self.drive(self.told + (speed + faster) / 2 * CYCLE, faster)
            yield

    def stopj(self, a: float) -> Generator[None, None, None]:
        while self.speed.any():
            speed = self.speed * self.slow
            slower = np.sign(speed) * np.maximum(np.abs(speed) - a * CYCLE, 0.0)
            self.drive(self.told + (speed + slower) / 2 * CYCLE, slower)
            yield

    def sleep(self, t: float) -> Generator[None, None, None]:
        for _ in range(max(round(t / CYCLE), 1)):
            yield

    def sync(self) -> Generator[None, None, None]:
        yield

    def get_steptime(self) -> float:
        return CYCLE

    def norm(self, a: Any) -> float:
        return float(np.linalg.norm(a))

    def get_tcp_force(self) -> list[float]:
        return [*self.force(), 0.0, 0.0, 0.0]

    def get_actual_joint_positions(self) -> list[float]:
        return self.plant.measured()[0].tolist()

    def set_tcp(self, pose: Any) -> None: ...

    def set_payload(self, m: float, cog: Any) -> None:
        self.load(m - driver_of(self.arm).tool_mass)

    def zero_ftsensor(self) -> None: ...

    def textmsg(self, text: Any) -> None: ...

    def set_tool_digital_out(self, n: int, on: bool) -> None:
        if n == 0:
            self.switch(bool(on))

    def set_standard_digital_out(self, n: int, on: bool) -> None: ...

    def get_tool_digital_in(self, n: int) -> bool:
        return n == 0 and bool(self.tool.vacuum)

    def get_standard_digital_in(self, n: int) -> bool:
        return False

    def get_standard_analog_in(self, n: int) -> float:
        return 0.0

    def write_output_integer_register(self, n: int, value: float) -> None:
        self.outputs[n] = int(value)

    def read_input_integer_register(self, n: int) -> int:
        return self.inputs.get(n, 0)

    # ------------------------------------------------------------ connections

    def _accept(self, listener: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        while True:
            connection, _ = listener.accept()
            if self.time < self.cut_until:
                connection.close()
                continue
            self._open.append(connection)
            threading.Thread(target=self._served, args=(connection, serve), daemon=True).start()

    def _served(self, connection: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        with contextlib.suppress(OSError, struct.error):
            serve(connection)
        with self.lock:
            self._subscribers = [one for one in self._subscribers if one[0] is not connection]
            self._open = [one for one in self._open if one is not connection]
        self.gone(connection)

    def cut(self) -> None:
        """All connections break; nobody is let in for a while."""
        self._subscribers.clear()
        for connection in self._open:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        self._open.clear()

    def _script(self, connection: socket.socket) -> None:
        """Programs as text: from ``def`` to an ``end`` in the first column."""
        text = ""
        while True:
            self.comes(connection, within=bool(text))
            part = connection.recv(1 << 16)
            if not part:
                return
            *programs, text = re.split(r"(?<=\nend\n)", text + part.decode("ascii"))
            for program in programs:
                with self.lock:
                    self._take(program)

    def _take(self, text: str) -> None:
        self.scripts += 1
        if self.protective:
            return
        if self.refused and "servoj" in text:
            self.refused -= 1
            return
        try:
            self.program = Script(text).run(self)
        except ScriptError as error:
            print(f"refused: {error}", file=sys.stderr, flush=True)

    def _dashboard(self, connection: socket.socket) -> None:
        connection.sendall(b"Connected: Universal Robots Dashboard Server\n")
        with connection.makefile("r") as lines:
            for line in lines:
                answer = "UR5" if line.strip() == "get robot model" else "?"
                connection.sendall(f"{answer}\n".encode())

    def _rtde(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        recipes: list[list[str]] = []
        wanted: list[str] = []

        def answer(kind: int, content: bytes) -> None:
            with self.lock:  # Nothing may come between its parts.
                connection.sendall(struct.pack("!HB", 3 + len(content), kind) + content)

        while True:
            self.comes(connection)
            size, kind = struct.unpack("!HB", _exactly(connection, 3))
            content = _exactly(connection, size - 3)
            if kind == ord("V"):
                answer(kind, bytes([struct.unpack("!H", content)[0] <= 2]))
            elif kind == ord("v"):
                answer(kind, struct.pack("!4I", 5, 12, 0, 0))
            elif kind == ord("O"):
                wanted = [name for name in content[8:].decode().split(",") if name]
                with self.lock:
                    kinds = [self._value(name)[0] for name in wanted]
                answer(kind, bytes([1]) + ",".join(kinds).encode())
            elif kind == ord("I"):
                names = [name for name in content.decode().split(",") if name]
                recipes.append(names)
                kinds = [_input_type(name) for name in names]
                answer(kind, bytes([len(recipes)]) + ",".join(kinds).encode())
            elif kind == ord("S"):
                answer(kind, b"\1")
                with self.lock:
                    self._subscribers.append((connection, wanted))
                    self.publish()
            elif kind == ord("P"):
                answer(kind, b"\1")
            elif kind == ord("U"):
                at = 1
                for name in recipes[content[0] - 1]:
                    code = _CODES[_input_type(name)]
                    (value,) = struct.unpack_from(code, content, at)
                    at += struct.calcsize(code)
                    if name.startswith("input_int_register_"):
                        with self.lock:
                            self.inputs[int(name.rpartition("_")[2])] = value

    def _value(self, name: str) -> tuple[str, Any]:
        """Type and value of an output."""
        if name.startswith("output_int_register_"):
            return "INT32", self.outputs.get(int(name.rpartition("_")[2]), 0)
        match name:
            case "timestamp":
                return "DOUBLE", self.time + self.jump
            case "actual_q":
                return "VECTOR6D", self.plant.measured()[0]
            case "actual_qd":
                return "VECTOR6D", self.plant.measured()[1]
            case "actual_TCP_force":
                return "VECTOR6D", self.get_tcp_force()
            case "actual_digital_input_bits":
                return "UINT64", int(bool(self.tool.vacuum)) << 16
            case "standard_analog_input0" | "standard_analog_input1":
                return "DOUBLE", 0.0
            case "robot_mode":
                return "INT32", _RUNNING
            case "runtime_state":
                return "UINT32", _STOPPED if self.program is None else _PLAYING
            case "safety_status_bits":
                return "UINT32", 4 if self.protective else 1
            case _:
                return "NOT_FOUND", 0

    def publish(self) -> None:
        """A data package to everybody who wants one."""
        for connection, names in self._subscribers:
            content = bytes([1])
            for name in names:
                kind, value = self._value(name)
                if kind == "VECTOR6D":
                    content += struct.pack("!6d", *value)
                else:
                    content += struct.pack(_CODES[kind], value)
            with contextlib.suppress(OSError):
                connection.sendall(struct.pack("!HB", 3 + len(content), ord("U")) + content)


_CODES = {"DOUBLE": "!d", "INT32": "!i", "UINT32": "!I", "UINT64": "!Q", "UINT8": "!B"}


def _input_type(name: str) -> str:
    if "int_register" in name or name == "speed_slider_mask":
        return "UINT32" if name == "speed_slider_mask" else "INT32"
    if "double_register" in name or name.startswith("standard_analog_output_"):
        return "UINT8" if name.endswith(("mask", "type")) else "DOUBLE"
    return "DOUBLE" if name == "speed_slider_fraction" else "UINT8"


def _exactly(connection: socket.socket, count: int) -> bytes:
    """So many bytes.

    Raises:
        OSError: where the other side ends before.
    """
    found = b""
    while len(found) < count:
        part = connection.recv(count - len(found))
        if not part:
            raise OSError("closed")
        found += part
    return found


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
