"""Work on several processes and machines: each piece once, whatever dies."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from learn2assemble.errors import InputError, MissingExtraError, UnknownNameError
from learn2assemble.workers import MAX_DEATHS, WorkerError, run_all


def note(item: tuple[Path, int]) -> int:
    """Leave a line for every call; the answer is the square."""
    folder, number = item
    with (folder / f"{number}.calls").open("a") as stream:
        stream.write(f"{os.getpid()}\n")
    return number**2


def die_once(item: tuple[Path, int]) -> int:
    """As :func:`note`, but the first process that gets number 3 is killed in the middle of it."""
    folder, number = item
    dead = folder / "dead"
    if number == 3 and not dead.exists():
        dead.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return note(item)


def die(item: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return item


def refuse(item: int) -> int:
    raise UnknownNameError("task", f"no-{item}", ["yes-0"])


def calls(folder: Path) -> dict[int, int]:
    return {int(f.stem): len(f.read_text().splitlines()) for f in folder.glob("*.calls")}


@pytest.mark.parametrize("workers", [1, 2])
def test_every_piece_is_done_once(tmp_path: Path, workers: int) -> None:
    items = [(tmp_path, number) for number in range(7)]
    found = dict(run_all(note, items, workers=workers))
    assert found == {item: item[1] ** 2 for item in items}
    assert calls(tmp_path) == dict.fromkeys(range(7), 1)


def test_a_worker_that_is_killed_loses_nothing(tmp_path: Path) -> None:
    items = [(tmp_path, number) for number in range(8)]
    found = list(run_all(die_once, items, workers=2))
    assert sorted(result for _, result in found) == [n**2 for n in range(8)]
    assert (tmp_path / "dead").exists()


def wait_long(item: Path) -> None:
    item.write_text(str(os.getpid()))
    time.sleep(600)


def running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        # In a container nobody may have asked for how it ended.
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text()
    except ProcessLookupError:
        return False
    except FileNotFoundError:
        return not Path("/proc/self/stat").exists()


def test_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    files = [tmp_path / "0", tmp_path / "1"]
    code = (
        "import sys; from pathlib import Path; from test_workers import wait_long\n"
        "from learn2assemble.workers import run_all\n"
        "if __name__ == '__main__':\n"
        "    list(run_all(wait_long, [Path(name) for name in sys.argv[1:]], workers=2))\n"
    )
    script = tmp_path / "parent.py"
    script.write_text(code)
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    parent = subprocess.Popen(
        [sys.executable, script, *files], env={**os.environ, "PYTHONPATH": path}
    )
    try:
        until(lambda: all(file.exists() and file.read_text() for file in files))
    finally:
        parent.kill()
        parent.wait()
    pids = [int(file.read_text()) for file in files]
    until(lambda: not any(running(pid) for pid in pids))


def until(done: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


def test_workers_that_always_die_end_the_work() -> None:
    with pytest.raises(WorkerError, match=f"died {MAX_DEATHS} times.*2 left"):
        list(run_all(die, [1, 2], workers=2))


@pytest.mark.parametrize("workers", [1, 2])
def test_errors_arrive_with_their_message(workers: int) -> None:
    with pytest.raises(InputError, match=r"^task: got 'no-.', expected one of yes-0"):
        list(run_all(refuse, [1, 2], workers=workers))


@pytest.mark.parametrize("address", ["nowhere", "localhost:x", "localhost:99999999", ":", ""])
def test_addresses_that_make_no_sense(address: str) -> None:
    with pytest.raises(InputError, match=r"^ray"):
        list(run_all(abs, [1], ray=address))


def test_an_address_that_does_not_answer() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(InputError, match=rf"ray: got '127.0.0.1:{port}'"):
        list(run_all(abs, [1], ray=f"127.0.0.1:{port}"))


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"learn2assemble\[ray\]"):
        list(run_all(abs, [1], ray="auto"))


def slow_note(item: tuple[Path, int]) -> int:
    time.sleep(0.5)
    return note(item)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_two_nodes_one_of_which_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every piece has its answer; only what the dead node was at is done again."""
    pytest.importorskip("ray", reason="the extra ray is not installed")
    from ray.cluster_utils import Cluster

    paths = [str(Path(__file__).parent), *sys.path]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        second = cluster.add_node(num_cpus=1)
        items = [(tmp_path, number) for number in range(5)]
        work = run_all(slow_note, items, ray=cluster.address)
        found = [next(work)]
        cluster.remove_node(second, allow_graceful=False)
        found += work
        assert sorted(result for _, result in found) == [n**2 for n in range(5)]
        assert len(found) == 5
    finally:
        cluster.shutdown()


def test_seeds_differ_and_are_resumed(tmp_path: Path) -> None:
    # Not at the top of this file, which every worker above loads.
    from learn2assemble.tasks.learning.run import train_seeds
    from learn2assemble.tasks.networks.agent_file import bare_weights

    options = {"samples": 60, "settings": ["network.width=8"], "device": "cpu"}
    runs = train_seeds("one-sided-3x3-22-24", tmp_path / "mine", seeds=2, **options)
    assert [run.out.name for run in runs] == ["mine-s0", "mine-s1"]
    weights = [bare_weights(run.out / "agent.safetensors") for run in runs]
    assert weights[0] != weights[1]
    with pytest.raises(InputError, match="`resume=`"):
        train_seeds("one-sided-3x3-22-24", tmp_path / "mine", seeds=2, **options)
    again = train_seeds("one-sided-3x3-22-24", tmp_path / "mine", seeds=2, resume=True, **options)
    assert [bare_weights(run.out / "agent.safetensors") for run in again] == weights
