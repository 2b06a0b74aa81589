"""The report of a plan: its page and picture, and the server that shows it."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html
import json
import re
import socket
import tempfile
import threading
from collections.abc import Iterator
from html.parser import HTMLParser
from http.client import HTTPConnection, HTTPException
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arm_record import arm_plan
from headless import SPATIAL, browse, pixels, read_picture, shoot
from learn2assemble.errors import InputError
from learn2assemble.planning.plan import Plan, PlanTarget, SearchReport, SearchStage
from learn2assemble.viewer.html import to_json
from learn2assemble.viewer.page import write_plan_page
from learn2assemble.viewer.picture import write_progress
from learn2assemble.viewer.server import PageServer, _Handler, open_server, serve
from learn2assemble.viewer.words import percent

EXAMPLE = Path(__file__).parent / "data" / "example_plan"


def render_page(plan: Plan) -> str:
    with tempfile.TemporaryDirectory() as folder:
        write_plan_page(plan, Path(folder) / "view.html")
        return (Path(folder) / "view.html").read_text(encoding="utf-8")


@pytest.fixture
def plan() -> Plan:
    return Plan.load(EXAMPLE)


def page_data(text: str) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text)
    assert found
    return json.loads(found[1])


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


def test_page_says_what_the_plan_says(plan: Plan) -> None:
    text = html.unescape(render_page(plan)).replace("\u00a0", " ")
    for words in (
        "9 of 22",
        "100 % of the target (97.5 % needed)",
        "agent with search, budget 10",
        plan.verified_by,
        "To the left of b1; front 100 %, back 57.5 %.",
        "fills the target",
        "56.2 %",
        ">Front</button>",
        ">Back</button>",
        "relational-cubes-s0",
    ):
        assert words in text, words
    rows = [a for a in _Page(text).having("tr") if "data-step" in a]
    assert [int(a["data-step"] or 0) for a in rows] == list(range(1, len(plan.steps) + 1))


@pytest.mark.parametrize("status", ["complete", "incomplete", "refused"])
def test_every_kind_of_plan_becomes_a_small_page(tmp_path: Path, plan: Plan, status: str) -> None:
    """Also without a step; the reason why it ends is said."""
    assert plan.assembly is not None
    steps = {"complete": 8, "incomplete": 5, "refused": 0}[status]
    made = dataclasses.replace(
        plan,
        status=status,
        reason=None if status == "complete" else "Too few blocks.",
        steps=plan.steps[:steps],
        assembly=dataclasses.replace(
            plan.assembly,
            blocks=plan.assembly.blocks[: steps + 1],
            steps=plan.assembly.steps[:steps],
        ),
    )
    path = tmp_path / "view.html"
    write_plan_page(made, path)
    assert path.stat().st_size < 1_500_000
    text = path.read_text(encoding="utf-8")
    assert "{{" not in re.sub(r"<script.*?</script>", "", text, flags=re.S)
    reasons = [a for a in _Page(text).having("div") if a.get("class") == "reason"]
    assert len(reasons) == (status != "complete")
    assert status == "complete" or "Too few blocks." in text


def test_targets_of_the_page_are_those_of_the_plan(plan: Plan) -> None:
    """They look away from the structure, and stand in the plane of its outer faces."""
    assert plan.assembly is not None
    data = page_data(render_page(plan))
    points = np.concatenate([block.vertices for block in plan.assembly.blocks])
    for drawn, target in zip(data["targets"], plan.design.targets, strict=True):
        np.testing.assert_allclose(drawn["outline"], target.outline)
        out = np.array(drawn["outward"])
        assert np.linalg.norm(out) == pytest.approx(1)
        plane = np.array(target.outline) @ out
        np.testing.assert_allclose(plane, plane[0], atol=1e-9)
        assert (points @ out).max() == pytest.approx(plane[0], abs=1e-3)


@given(st.floats(0, 6.28), st.floats(-1, 1), st.floats(-1, 1))
def test_a_target_is_seen_from_where_it_runs_clockwise(turn: float, x: float, y: float) -> None:
    c, s = np.cos(turn), np.sin(turn)
    flat = [(-0.1, 0.0), (-0.05, 0.2), (0.07, 0.15), (0.1, 0.0)]
    outline = tuple((float(c * u + x), float(s * u + y), v) for u, v in flat)
    np.testing.assert_allclose(PlanTarget("x", outline).outward, [s, -c, 0], atol=1e-9)


def test_a_plan_without_its_blocks_says_what_is_missing(plan: Plan, tmp_path: Path) -> None:
    bare = dataclasses.replace(plan, assembly=None)
    for write in (write_plan_page, write_progress):
        with pytest.raises(InputError, match=r"assembly\.json beside plan\.json"):
            write(bare, tmp_path / "file")


def test_page_needs_no_network(plan: Plan) -> None:
    text = render_page(plan)
    page = _Page(text)
    for tag, attrs in page.tags:
        for name in ("src", "href", "srcset", "action", "data", "poster", "xlink:href"):
            assert (attrs.get(name) or "data:").startswith(("data:", "#")), (tag, attrs)
        assert not any(name.startswith("on") or name == "style" for name in attrs), (tag, attrs)
    assert not page.having("link") or all(a["href"] == "data:," for a in page.having("link"))
    # Names of namespaces are no addresses that are asked for.
    names = {"http://www.w3.org/1999/xhtml", "http://www.w3.org/2000/svg"}
    assert set(re.findall(r"https?://[^\s\"'`<>]+", text)) <= names
    assert not re.search(r"@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket|sendBeacon", text)
    policy = next(a for a in page.having("meta") if "http-equiv" in a)["content"] or ""
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy


def test_policy_names_exactly_the_scripts_and_style_of_the_page(plan: Plan) -> None:
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
def test_text_from_a_plan_never_becomes_markup(plan: Plan, evil: str) -> None:
    incomplete = dataclasses.replace(plan, status="incomplete", reason="short")
    clean = _Page(render_page(incomplete))
    targets = tuple(dataclasses.replace(t, name=evil) for t in plan.design.targets)
    text = render_page(
        dataclasses.replace(
            incomplete,
            reason=evil,
            agent=evil,
            verified_by=evil,
            design=dataclasses.replace(plan.design, name=evil, source=evil, targets=targets),
            search=SearchReport(evil, 0, (SearchStage(evil, evil, 0.0),)),
        )
    )
    page = _Page(text)
    assert len(_scripts(page)) == len(_scripts(clean))
    assert not page.having("img")
    assert len(page.having("svg")) == len(clean.having("svg"))
    assert all(not name.startswith("on") for _, attrs in page.tags for name in attrs)
    assert "".join(page.texts["h1"]) == evil, "the name reads as it was given"
    assert text.count("<!--") == render_page(plan).count("<!--")


@given(st.text())
def test_data_cannot_end_its_element(text: str) -> None:
    written = to_json({text: [text + "</script><!--"]})
    assert not set(written) & set("<>&\u2028")
    assert json.loads(written) == {text: [text + "</script><!--"]}


@given(st.text())
@settings(max_examples=15, deadline=None)
def test_any_name_survives_as_text(name: str) -> None:
    plan = arm_plan(3)
    plan = dataclasses.replace(plan, design=dataclasses.replace(plan.design, name=name))
    heading = re.search(r"<h1>(.*?)</h1>", render_page(plan), flags=re.S)
    assert heading
    assert "<" not in heading[1]
    if name.isprintable():
        assert html.unescape(heading[1]) == name


def test_page_is_the_same_every_time(plan: Plan) -> None:
    assert render_page(plan) == render_page(Plan.load(EXAMPLE))


def test_percent_never_rounds_up_to_all() -> None:
    assert percent(0.9999) == "99.9\u00a0%"
    assert percent(1) == "100\u00a0%"
    assert percent(0.0) == "0\u00a0%"
    assert percent(None) == "–"


# --- the picture --------------------------------------------------------------------------------


def test_picture_has_its_size_and_colours(tmp_path: Path, plan: Plan) -> None:
    write_progress(plan, tmp_path / "progress.png")
    image = read_picture(tmp_path / "progress.png")
    assert image.shape[:2] == (800, 1440)
    wood = (image[..., 0] > 1.3 * image[..., 2]).reshape(2, 400, 3, 480).mean((1, 3)).ravel()
    assert wood[0] > 0.02
    assert wood[-1] > wood[0]
    assert pixels(image, "#0b7285") > 1000, "outlines"


def test_a_path_that_cannot_be_written_is_an_input_error(plan: Plan) -> None:
    for write in (write_plan_page, write_progress):
        with pytest.raises(InputError, match="can be written"):
            write(plan, Path("no-such-folder") / "file")


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
    for target in (
        "/plan.json",
        "/.secret",
        "/link.html",
        "/../",
        "/..%2f.secret",
        "//etc/passwd",
        "/my%20view.html/",
        "/%00",
        "*",
    ):
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


@pytest.mark.parametrize("left", [BrokenPipeError, ConnectionResetError])
def test_a_browser_that_leaves_is_no_traceback(
    left: type[OSError],
    running: PageServer,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    done = threading.Event()

    def leave(*_: object) -> None:
        raise left

    monkeypatch.setattr(_Handler, "do_GET", leave)
    monkeypatch.setattr(running, "shutdown_request", lambda request: (request.close(), done.set()))
    with pytest.raises((OSError, HTTPException)):
        _ask(running, "/")
    assert done.wait(10)
    assert capsys.readouterr().err == ""


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
def test_page_runs_without_an_error(browser: str, tmp_path: Path, plan: Plan) -> None:
    name = "</script><script>document.documentElement.dataset.evil=1</script>"
    plan = dataclasses.replace(plan, design=dataclasses.replace(plan.design, name=name))
    write_plan_page(plan, tmp_path / "view.html")
    address = (tmp_path / "view.html").as_uri()
    dom, log = browse(
        browser,
        tmp_path / "run",
        f"{address}#step=5",
        *SPATIAL,
        "--dump-dom",
        "--window-size=500,600",
    )
    root = re.search(r"<html[^>]*>", dom)
    assert root, log
    assert 'data-ready="yes"' in root[0], log
    assert 'data-step="5"' in root[0]
    assert "data-error" not in root[0]
    assert "data-evil" not in root[0]
    assert "Uncaught" not in log
    assert "Content Security Policy" not in log
    assert "Place b5 (cube), layer 1." in dom
    assert re.findall(r'<tr data-step="(\d+)" class="[^"]*current', dom) == ["5"]


@pytest.mark.browser
def test_targets_stand_in_the_3d_view(browser: str, tmp_path: Path, plan: Plan) -> None:
    write_plan_page(plan, tmp_path / "view.html")
    images, log = shoot(browser, tmp_path, ("step=0", "step=8"), (1000, 720), *SPATIAL)
    assert "Uncaught" not in log, log
    stage = [image[180:470, 40:560] for image in images]
    if pixels(stage[0], "#f1efea") > 0.95 * stage[0][..., 0].size:
        pytest.skip("this browser has no software WebGL")
    outline = [pixels(image, "#0b7285") for image in stage]
    assert outline[0] > 200
    assert outline[0] > outline[1] > 50, "blocks hide the outlines behind them"
    changed = np.abs(stage[0] - stage[1]).max(-1) > 0.1
    assert changed.mean() > 0.03, "the structure is built"
