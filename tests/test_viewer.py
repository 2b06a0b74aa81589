"""The report of a build plan: page, picture, server."""

from __future__ import annotations

import base64
import copy
import hashlib
import html
import json
import re
import socket
import threading
from collections.abc import Iterator
from html.parser import HTMLParser
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from matplotlib.image import imread

from headless import FLAT, SPATIAL, browse, pixels, shoot
from learn2assemble.errors import InputError
from learn2assemble.planning.plan import Plan
from learn2assemble.viewer import page as plan_page
from learn2assemble.viewer import picture as isometric
from learn2assemble.viewer import scene as scenes
from learn2assemble.viewer.html import to_json
from learn2assemble.viewer.picture import moments, side_normal
from learn2assemble.viewer.scene import hull
from learn2assemble.viewer.server import PageServer, open_server, serve
from learn2assemble.viewer.words import percent, summary
from learn2assemble.world.layouts import side_frames, waiting_places

EDGE = 0.05
EXAMPLE = Path(__file__).parent / "data" / "example_plan.json"


def render_page(plan: dict[str, Any]) -> str:
    return plan_page.render_page(Plan.from_dict(plan))


def write_page(plan: dict[str, Any], path: Path) -> None:
    plan_page.write_page(Plan.from_dict(plan), path)


def read_scene(plan: dict[str, Any]) -> scenes.Scene:
    return scenes.read_scene(Plan.from_dict(plan))


@pytest.fixture
def plan() -> dict[str, Any]:
    return json.loads(EXAMPLE.read_text())


def make_plan(sides: int, status: str = "complete") -> dict[str, Any]:
    """A plan on the lattice: a wall for one side, two for two, a ring of walls for more."""
    rings = {
        1: [(0, 0), (1, 0), (-1, 0)],
        2: [(0, 0), (1, 0), (-1, 0), (0, 1), (1, 1), (-1, 1)],
        3: [(0, 0), (1, 0), (1, 1), (1, 2), (0, 2), (-1, 2)],
        4: [(0, 0), (1, 0), (1, 1), (1, 2), (0, 2), (-1, 2), (-1, 1), (-1, 0)],
    }
    cells = [(x, y, z) for z in range(2) for x, y in rings[sides]]
    outline = [[-0.074, 0], [-0.06, 0.095], [0.06, 0.095], [0.074, 0]]
    steps = [
        {
            "step": k, "block": k, "reference": k - 1, "relation": "top" if z else "right",
            "position": [EDGE * x, EDGE * y, EDGE * z + EDGE / 2], "quaternion": [1, 0, 0, 0],
            "coverage": k / (len(cells) - 1), "plane_coverage": 0.9 * k / (len(cells) - 1),
            "stability_margin": None, "speed_sum": None, "stable": True, "outside": False,
        }
        for k, (x, y, z) in enumerate(cells)
    ][1:]  # fmt: skip
    if status == "refused":
        steps = []
    elif status == "incomplete":
        steps = steps[:-2]
    return {
        "format": "learn2assemble-plan", "version": 1,
        "design": {
            "name": f"{sides}-sided house", "source": "house.json", "num_sides": sides,
            "frames": side_frames(sides).tolist(),
            "elevations": [{"name": f"View {i + 1}", "outline": outline} for i in range(sides)],
            "success_threshold": 0.975, "block_edge": EDGE,
        },
        "agent": "test", "status": status,
        "reason": None if status == "complete" else "Too few blocks for the outline.",
        "search": {"needed": "agent alone", "budget": 0, "attempts": [], "backtracks": 1},
        "blocks": {
            "available": 20, "used": len(steps) + 1,
            "waiting": [[0, 0, EDGE / 2], *waiting_places("rows", 19).position.tolist()],
        },
        "first_block": {
            "block": 0, "position": [0, 0, EDGE / 2], "quaternion": [1, 0, 0, 0],
        },
        "steps": steps, "coverage": steps[-1]["coverage"] if steps else 0.0,
        "verified_by": "MuJoCo 4.0.0" if steps else None, "seconds": 0.5,
    }  # fmt: skip


class _Page(HTMLParser):
    """Every element with its attributes, and the text inside each kind of element."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, list[str]] = {}
        self._open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        self.texts.setdefault(self._open[-1] if self._open else "", []).append(data)

    def having(self, name: str) -> list[dict[str, str | None]]:
        return [attrs for tag, attrs in self.tags if tag == name]


def _scripts(page: _Page) -> list[dict[str, str | None]]:
    return [attrs for attrs in page.having("script") if attrs.get("type") != "application/json"]


# --- the page -----------------------------------------------------------------------------------


@pytest.mark.parametrize("sides", [1, 2, 3, 4])
@pytest.mark.parametrize("status", ["complete", "incomplete", "refused"])
def test_every_kind_of_plan_becomes_a_small_page(tmp_path: Path, sides: int, status: str) -> None:
    plan = make_plan(sides, status)
    path = tmp_path / "view.html"
    write_page(plan, path)
    assert path.stat().st_size < 1_500_000
    text = path.read_text(encoding="utf-8")
    assert "{{" not in re.sub(r"<script.*?</script>", "", text, flags=re.S)
    page = _Page(text)
    drawings = [a for a in page.having("svg") if a.get("class") == "elevation"]
    assert len(drawings) == sides
    rows = [a for a in page.having("tr") if "data-step" in a]
    assert [int(a["data-step"] or 0) for a in rows] == list(range(1, len(plan["steps"]) + 1))
    reasons = [a for a in page.having("div") if a.get("class") == "reason"]
    assert len(reasons) == (status != "complete")
    assert status == "complete" or plan["reason"] in text
    charts = [a for a in page.having("svg") if a.get("class") == "chart"]
    assert len(charts) == (status != "refused")


def test_page_says_what_the_plan_says(plan: dict[str, Any]) -> None:
    text = html.unescape(render_page(plan)).replace("\u00a0", " ")
    for words in (
        "15 of 24 blocks", "99.9 % of the target (97.5 % needed)", "agent with search, budget 10",
        plan["verified_by"], "2 steps taken back", "to the left of block 5", "on top of block 4",
    ):  # fmt: skip
        assert words in text, words


def test_page_needs_no_network(plan: dict[str, Any]) -> None:
    text = render_page(plan)
    page = _Page(text)
    for tag, attrs in page.tags:
        for name in ("src", "href", "srcset", "action", "data", "poster", "xlink:href"):
            assert (attrs.get(name) or "data:").startswith(("data:", "#")), (tag, attrs)
        assert not any(name.startswith("on") or name == "style" for name in attrs), (tag, attrs)
    assert not page.having("link") or all(a["href"] == "data:," for a in page.having("link"))
    # The XHTML namespace inside three.js is a name, not an address that is asked for.
    assert set(re.findall(r"https?://[^\s\"'`<>]+", text)) <= {"http://www.w3.org/1999/xhtml"}
    assert not re.search(r"@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket|sendBeacon", text)
    policy = next(a for a in page.having("meta") if "http-equiv" in a)["content"] or ""
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy


def test_policy_names_exactly_the_scripts_and_style_of_the_page(plan: dict[str, Any]) -> None:
    text = render_page(plan)
    policy = re.search(r'Security-Policy" content="([^"]*)"', text)
    assert policy
    inline = re.findall(r"<script>(.*?)</script>", text, flags=re.S)
    inline += re.findall(r"<style>(.*?)</style>", text, flags=re.S)
    hashes = {base64.b64encode(hashlib.sha256(body.encode()).digest()).decode() for body in inline}
    assert set(re.findall(r"'sha256-([^']+)'", policy[1])) == hashes
    assert len(hashes) == 5


EVIL = (
    "</script><script>alert(1)</script>",
    "<img src=x onerror=alert(1)>",
    '"><svg onload=alert(1)>',
    "<!--<script>",
    "{{scripts}} & 'x' \u2028 $\\frac",
)


@pytest.mark.parametrize("evil", EVIL)
def test_text_from_a_plan_never_becomes_markup(plan: dict[str, Any], evil: str) -> None:
    clean = _Page(render_page(plan))
    design = plan["design"]
    design["name"] = design["source"] = plan["reason"] = plan["agent"] = evil
    plan["status"], plan["verified_by"] = "incomplete", evil
    plan["search"]["needed"] = evil
    design["elevations"][0]["name"] = evil
    plan["search"]["attempts"][0].update(stage=evil, result=evil)
    text = render_page(plan)
    page = _Page(text)
    assert len(_scripts(page)) == len(_scripts(clean))
    assert not page.having("img")
    assert len(page.having("svg")) == len(clean.having("svg"))
    assert all(not name.startswith("on") for _, attrs in page.tags for name in attrs)
    assert "".join(page.texts["h1"]) == evil, "the name reads as it was given"
    assert text.count("<!--") == render_page(json.loads(EXAMPLE.read_text())).count("<!--")


@given(st.text())
def test_data_cannot_end_its_element(text: str) -> None:
    written = to_json({text: [text + "</script><!--"]})
    assert not set(written) & set("<>&\u2028")
    assert json.loads(written) == {text: [text + "</script><!--"]}


@given(st.text())
@settings(max_examples=15, deadline=None)
def test_any_name_survives_as_text(name: str) -> None:
    plan = make_plan(1)
    plan["design"]["name"] = name
    heading = re.search(r"<h1>(.*?)</h1>", render_page(plan), flags=re.S)
    assert heading
    assert "<" not in heading[1]
    if name.isprintable():
        assert html.unescape(heading[1]) == name


def test_data_in_the_page_is_the_plan(plan: dict[str, Any]) -> None:
    data = json.loads(
        re.findall(r'<script type="application/json" id="data">(.*?)</script>', render_page(plan))[
            0
        ]
    )
    assert [place is None for place in data["waiting"]] == [True] + 23 * [False]
    assert data["steps"] == len(plan["steps"]) == len(data["captions"]) - 1
    for block, step in zip(data["blocks"][1:], plan["steps"], strict=True):
        np.testing.assert_allclose(block["position"], step["position"], atol=1e-5)
        assert block["waiting"] == step["block"]
    assert [b["number"] for b in data["blocks"] if b["kind"] == "support"] == [
        s["step"] for s in plan["steps"] if s["outside"]
    ]


def test_page_is_the_same_every_time(plan: dict[str, Any]) -> None:
    assert render_page(plan) == render_page(copy.deepcopy(plan))


# --- the geometry behind it ---------------------------------------------------------------------


def test_sides_see_their_own_wall(plan: dict[str, Any]) -> None:
    scene = read_scene(plan)
    for side, row in enumerate((0.0, EDGE)):
        face = {s.number for s in scene.seen_from(side) if s.layer == "face"}
        own = {b.number for b in scene.blocks if abs(b.position[1] - row) < EDGE / 2}
        assert face == own
    back = {s.number: s for s in scene.seen_from(1)}
    # Block 8 stands at world x = -0.1; seen from behind it is on the right.
    np.testing.assert_allclose(back[8].centre, [0.1, EDGE / 2], atol=1e-3)
    layers = [s.layer for s in scene.seen_from(1)]
    assert layers == sorted(layers, key=("behind", "face", "front").index), "farthest first"


def test_a_block_before_the_face_plane_is_drawn_in_front(plan: dict[str, Any]) -> None:
    plan["steps"][-1]["position"] = [0.0, -EDGE, EDGE / 2]
    last = read_scene(plan).seen_from(0)[-1]
    assert (last.number, last.layer) == (len(plan["steps"]), "front")
    drawing = render_page(plan).split('class="elevation"')[1].split("</svg>")[0]
    assert f">{last.number}</text>" in drawing
    assert ">0</text>" not in drawing, "the number of a hidden block is left out"


@given(st.integers(0, 3), st.lists(st.floats(-1, 1), min_size=3, max_size=3))
@settings(max_examples=30, deadline=None)
def test_local_and_world_frames_are_inverse(side: int, point: list[float]) -> None:
    elevation = read_scene(make_plan(4)).elevations[side]
    there = elevation.to_world(np.array(point))
    np.testing.assert_allclose(elevation.to_local(there), point, atol=1e-12)
    out = elevation.to_world(np.array([0, -1.0, 0])) - elevation.to_world(np.zeros(3))
    np.testing.assert_allclose(side_normal(elevation.frame), out, atol=1e-12)


@given(st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), min_size=1, max_size=12))
@settings(max_examples=50, deadline=None)
def test_hull_is_convex_and_holds_every_point(points: list[tuple[int, int]]) -> None:
    around = hull(np.array(points, float))
    if len(around) < 3:
        return
    edges = np.roll(around, -1, 0) - around
    for point in np.array(points, float):
        offset = point - around
        assert (edges[:, 0] * offset[:, 1] - edges[:, 1] * offset[:, 0] >= -1e-6).all()


def test_waiting_places_are_kept_where_they_can_be_drawn() -> None:
    plan = make_plan(2)
    scene = read_scene(plan)
    assert not scene.rearranged
    np.testing.assert_array_equal(scene.waiting, plan["blocks"]["waiting"])
    assert scene.first == 0, "the first block stands; it does not wait"


def test_a_plan_may_list_only_blocks_that_wait() -> None:
    plan = make_plan(2)
    plan["blocks"]["waiting"] = waiting_places("rows", 20).position.tolist()
    assert read_scene(plan).first is None


@pytest.mark.parametrize("count", [1, 24, 60])
def test_node_positions_are_drawn_as_a_tray(plan: dict[str, Any], count: int) -> None:
    plan["steps"] = []
    plan["first_block"] = None
    plan["blocks"]["waiting"] = waiting_places("line", count).position.tolist()
    scene = read_scene(plan)
    assert scene.rearranged
    assert scene.waiting.shape == (count, 3)
    np.testing.assert_allclose(scene.waiting[:, 2], EDGE / 2)
    gap = np.abs(scene.waiting[:, None] - scene.waiting[None]).max(-1)
    assert (gap[~np.eye(count, dtype=bool)] > 1.3 * EDGE).all()
    assert (scene.waiting[:, 1] < -2 * EDGE).all(), "in front of the structure"


def _turned(plan: dict[str, Any], degrees: float) -> np.ndarray:
    half = np.radians(degrees) / 2
    plan["first_block"]["quaternion"] = [float(np.cos(half)), 0, 0, float(np.sin(half))]
    return read_scene(plan).blocks[0].corners(EDGE)


def test_quaternions_turn_blocks_about_their_centre(plan: dict[str, Any]) -> None:
    corners = _turned(plan, 45)
    assert np.abs(corners[:, 0]).max() == pytest.approx(EDGE / np.sqrt(2))
    np.testing.assert_allclose(corners.mean(0), plan["first_block"]["position"], atol=1e-12)


def test_percent_never_rounds_up_to_all() -> None:
    assert percent(0.9999) == "99.9\u00a0%"
    assert percent(1) == "100\u00a0%"
    assert percent(0.0) == "0\u00a0%"
    assert percent(None) == "–"


def test_summary_of_every_status_differs() -> None:
    plans = [make_plan(2, status) for status in ("complete", "incomplete", "refused")]
    assert len({summary(Plan.from_dict(plan)) for plan in plans}) == 3


# --- the picture --------------------------------------------------------------------------------


@pytest.mark.parametrize("steps", [0, 1, 3, 6, 7, 8, 14, 60])
def test_moments_run_from_start_to_end(steps: int) -> None:
    shown = moments(steps)
    assert shown[0] == 0
    assert shown[-1] == steps
    assert shown == sorted(set(shown))
    assert len(shown) == min(8, steps + 1)


@pytest.mark.parametrize(
    ("sides", "status"), [(1, "incomplete"), (3, "complete"), (4, "refused"), (2, None)]
)
def test_picture_has_its_size_and_colours(
    tmp_path: Path, plan: dict[str, Any], sides: int, status: str | None
) -> None:
    plan = make_plan(sides, status) if status else plan
    # Neither a formula sign nor a script the font lacks may stop it.
    plan["design"]["name"] = "price $x_{1$ 家"
    isometric.write_progress(Plan.from_dict(plan), tmp_path / "progress.png")
    image = imread(tmp_path / "progress.png")
    assert image.shape[1] == 1600
    assert 500 < image.shape[0] < 1600
    assert pixels(image, "#e0764a") > 300, "first block"
    assert (pixels(image, "#ecca90") > 3000) == bool(plan["steps"]), "placed blocks"
    assert (pixels(image, "#63b0f2") > 300) == bool(plan["steps"]), "block of the step"
    assert pixels(image, "#0b7285") > 1000, "outlines"


def test_a_path_that_cannot_be_written_is_an_input_error() -> None:
    plan = Plan.from_dict(make_plan(1, "refused"))
    for write in (plan_page.write_page, isometric.write_progress):
        with pytest.raises(InputError, match="can be written"):
            write(plan, Path("no-such-folder") / "file")


_CELLS = st.tuples(st.integers(-3, 3), st.integers(-3, 3), st.integers(0, 3))
_SHIFT = st.tuples(*[st.floats(0, 0.9)] * 3)


def _common_ray(a: np.ndarray, b: np.ndarray) -> float | None:
    """How far ``b`` has to move towards the viewer to meet ``a``; None where no ray meets both."""
    ends = np.sort(
        [(a - b - EDGE) / isometric.TO_VIEWER, (a - b + EDGE) / isometric.TO_VIEWER], axis=0
    )
    enter, leave = ends[0].max(), ends[1].min()
    return (enter + leave) / 2 if leave - enter > 1e-3 * EDGE else None


@given(st.lists(st.tuples(_CELLS, _SHIFT), min_size=2, max_size=14))
@settings(max_examples=80, deadline=None)
# Comparing centres would draw the second cube first here, though it stands in front.
@example([((0, 0, 0), (0.0, 0.9, 0.9)), ((-1, 0, 0), (0.0, 0.0, 0.0))])
@example([((0, 0, 0), (0.0, 0.0, 0.0)), ((-1, 0, -1), (0.0, 0.8, 0.6))])
def test_nearer_cubes_are_drawn_later(spec: list[Any]) -> None:
    kept: list[np.ndarray] = []
    for cell, shift in spec:
        position = EDGE * (np.array(cell, float) + np.array(shift))
        if all(np.abs(position - other).max() >= EDGE for other in kept):
            kept.append(position)
    order = isometric.painters_order(np.array(kept), EDGE)
    assert sorted(order) == list(range(len(kept)))
    for place, i in enumerate(order):
        for j in order[place + 1 :]:
            # j covers i, so where one ray meets both it must meet j nearer to the viewer.
            move = _common_ray(kept[i], kept[j])
            assert move is None or move < 0


def test_a_cube_shows_three_faces_and_no_mirrored_number(plan: dict[str, Any]) -> None:
    block = read_scene(plan).blocks[0]
    faces = isometric.visible_faces(block, EDGE)
    assert len(faces) == 3
    for face in faces:
        right, up = face.corners[1] - face.corners[0], face.corners[3] - face.corners[0]
        assert right[0] * up[1] - right[1] * up[0] > 0
    front = isometric.numbered_face(faces, block, np.zeros((0, 3)), EDGE)
    assert front is not None
    np.testing.assert_allclose(front.normal, [0, -1, 0])
    before = block.position[None] - np.array([0, EDGE, 0])
    beside = isometric.numbered_face(faces, block, before, EDGE)
    assert beside is not None
    np.testing.assert_allclose(beside.normal, [-1, 0, 0])


# --- the server ---------------------------------------------------------------------------------


def _page_in(folder: Path) -> Path:
    path = folder / "my view.html"
    path.write_text("hello", encoding="utf-8")
    return path


def _ask(server: PageServer, target: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    """Status and body; the request line is sent as it is."""
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    try:
        connection.putrequest(method, target, skip_host=True)
        for name, value in {"Host": f"127.0.0.1:{server.server_port}", **headers}.items():
            if value:
                connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


@pytest.fixture
def running(tmp_path: Path) -> Iterator[PageServer]:
    with open_server(_page_in(tmp_path)) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def test_server_gives_the_page_and_nothing_else(running: PageServer, tmp_path: Path) -> None:
    assert running.address == f"http://127.0.0.1:{running.server_port}/my%20view.html"
    (tmp_path / "plan.json").write_text("{}")
    (tmp_path / ".secret").write_text("secret")
    (tmp_path / "link.html").symlink_to(tmp_path / ".secret")
    assert _ask(running, "/my%20view.html") == (200, b"hello")
    assert _ask(running, "/")[1] == b"hello"
    assert _ask(running, "/my%20view.html", "HEAD") == (200, b"")
    for target in ("/plan.json", "/.secret", "/link.html", "/../", "/..%2f.secret", "//etc/passwd",
                   "/my%20view.html/", "/%00", "*"):  # fmt: skip
        assert _ask(running, target)[0] in (400, 404), target
    assert _ask(running, "/", "POST")[0] == 501


def test_server_refuses_other_names_and_links(running: PageServer, tmp_path: Path) -> None:
    port = running.server_port
    assert _ask(running, "/", Host=f"localhost:{port}")[0] == 200
    for host in (f"evil.example:{port}", f"127.0.0.1.evil:{port}", f"127.0.0.1:{port + 1}", ""):
        assert _ask(running, "/", Host=host)[0] == 403, host
    page = tmp_path / "my view.html"
    page.rename(tmp_path / "moved.html")
    page.symlink_to(tmp_path / "moved.html")
    assert _ask(running, "/")[0] == 404
    with pytest.raises(InputError, match="not a link"):
        open_server(page)


def test_serve_reports_the_address_and_ends_when_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    opened: list[str] = []
    monkeypatch.setattr(PageServer, "serve_forever", interrupt)
    monkeypatch.setattr("webbrowser.open", opened.append)
    told: list[str] = []
    address = serve(_page_in(tmp_path), report=told.append)
    assert told == opened == [address]
    assert serve(_page_in(tmp_path), open_browser=False) != ""
    assert len(opened) == 1


def test_serve_refuses_what_it_cannot_serve(tmp_path: Path) -> None:
    path = _page_in(tmp_path)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match="free port"):
            serve(path, taken.getsockname()[1], open_browser=False)
    with pytest.raises(InputError, match="65535"):
        serve(path, 70000, open_browser=False)
    with pytest.raises(InputError, match="existing"):
        serve(tmp_path / "none.html", open_browser=False)


# --- in a browser -------------------------------------------------------------------------------


@pytest.mark.browser
def test_drawings_follow_the_timeline_without_webgl(
    browser: str, tmp_path: Path, plan: dict[str, Any]
) -> None:
    write_page(plan, tmp_path / "view.html")
    images, log = shoot(browser, tmp_path, ("step=0", "step=5", "step=14"), (1000, 1200), *FLAT)
    assert "CONSOLE" not in log, log
    wood = [pixels(image, "#ecca90") for image in images]
    assert wood[0] < 400, "only the legend before the first step"
    assert wood[0] + 1500 < wood[1], wood
    assert wood[1] + 3000 < wood[2], wood
    assert all(pixels(image, "#e0764a") > 500 for image in images), "first block"
    assert pixels(images[1], "#63b0f2") > pixels(images[0], "#63b0f2") + 500, "current block"
    assert not np.array_equal(images[0], images[2])


@pytest.mark.browser
def test_page_runs_without_an_error(browser: str, tmp_path: Path, plan: dict[str, Any]) -> None:
    plan["design"]["name"] = "</script><script>document.documentElement.dataset.evil=1</script>"
    write_page(plan, tmp_path / "view.html")
    address = (tmp_path / "view.html").as_uri()
    dom, log = browse(
        browser, tmp_path / "run", f"{address}#step=5", *SPATIAL, "--dump-dom",
        "--window-size=500,600",
    )  # fmt: skip
    root = re.search(r"<html[^>]*>", dom)
    assert root, log
    assert 'data-ready="yes"' in root[0], log
    assert 'data-step="5"' in root[0]
    assert "data-error" not in root[0]
    assert "data-evil" not in root[0]
    assert "Uncaught" not in log
    assert "Content Security Policy" not in log
    assert "Block 5 goes to the left of block 2" in dom
    assert re.findall(r'<tr data-step="(\d+)" class="[^"]*current', dom) == ["5"]


@pytest.mark.browser
def test_blocks_move_in_the_3d_view(browser: str, tmp_path: Path, plan: dict[str, Any]) -> None:
    write_page(plan, tmp_path / "view.html")
    images, log = shoot(browser, tmp_path, ("step=0", "step=14"), (1000, 720), *SPATIAL)
    assert "Uncaught" not in log, log
    stage = [image[400:, 40:560] for image in images]
    if pixels(stage[0], "#f1efea") > 0.95 * stage[0][..., 0].size:
        pytest.skip("this browser has no software WebGL; the drawings are tested without it")
    changed = np.abs(stage[0] - stage[1]).max(-1) > 0.1
    assert changed[:180].mean() > 0.03, "the structure is built"
    assert changed[200:].mean() > 0.03, "its blocks leave their waiting places"
