"use strict";
/* The timeline: one number, the time in steps, drives the 3-D view, the drawings, the chart and
   the table. */
(() => {
  const root = document.documentElement;
  window.addEventListener("error", (event) => { root.dataset.error = String(event.message); });
  const find = (id) => document.getElementById(id);
  const data = JSON.parse(find("data").textContent);
  const last = data.steps;
  const SECONDS_PER_STEP = 1.1;
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  const marked = [...document.querySelectorAll(".block, .label, .dot, #rows tr[data-step]")];
  const cursor = document.querySelector(".cursor");
  const dots = [...document.querySelectorAll(".dot")];
  const playButton = find("play");
  let time = last, shown = -1, playing = false, before = 0;

  const stage = openStage();

  function openStage() {
    const probe = document.createElement("canvas").getContext("webgl2");
    if (!probe) {
      document.body.classList.add("flat");
      find("no-webgl").hidden = false;
      root.dataset.webgl = "missing";
      return { update() {}, resetView() {} };
    }
    probe.getExtension("WEBGL_lose_context")?.loseContext();
    const made = createStage(find("canvas"), data);
    root.dataset.webgl = "ready";
    return made;
  }

  function moveTo(now) {
    time = Math.min(Math.max(now, 0), last);
    stage.update(time);
    const step = Math.ceil(time);
    if (step !== shown) showStep(step);
  }

  /* Everything that changes only from step to step. */
  function showStep(step) {
    shown = step;
    root.dataset.step = String(step);
    for (const item of marked) {
      const number = Number(item.dataset.step);
      item.classList.toggle("future", number > step);
      item.classList.toggle("done", number <= step);
      item.classList.toggle("current", number === step && (step > 0 || item.classList.contains("dot")));
    }
    if (cursor && dots[step]) {
      for (const end of ["x1", "x2"]) cursor.setAttribute(end, dots[step].getAttribute("cx"));
    }
    find("slider").value = String(step);
    find("slider").setAttribute("aria-valuetext", `Step ${step} of ${last}`);
    find("count").textContent = `${step} / ${last}`;
    find("caption").textContent = data.captions[step];
  }

  function goTo(step) {
    pause();
    moveTo(step);
    history.replaceState(null, "", `#step=${shown}`);
  }

  function pause() {
    playing = false;
    document.body.classList.remove("playing");
    playButton.setAttribute("aria-label", "Play");
  }

  function play() {
    if (!last) return;
    if (time >= last) moveTo(0);
    playing = true;
    before = performance.now();
    document.body.classList.add("playing");
    playButton.setAttribute("aria-label", "Pause");
    requestAnimationFrame(tick);
  }

  function tick(now) {
    if (!playing) return;
    const passed = Math.max(now - before, 0) / 1000 / SECONDS_PER_STEP * Number(find("speed").value);
    if (calm.matches) {
      // No movement asked for: show each step as it stands, then jump to the next.
      if (passed >= 1) { before = now; moveTo(Math.floor(time) + 1); }
    } else {
      before = now;
      moveTo(time + passed);
    }
    if (time >= last) goTo(last); else requestAnimationFrame(tick);
  }

  function fromAddress() {
    const match = /^#step=(\d+)$/.exec(location.hash);
    return match ? Math.min(Number(match[1]), last) : last;
  }

  const back = () => goTo(Math.ceil(time) - 1);
  const forward = () => goTo(Math.floor(time) + 1);
  const toggle = () => { if (playing) { pause(); } else { play(); } };
  find("first").addEventListener("click", () => goTo(0));
  find("back").addEventListener("click", back);
  find("forward").addEventListener("click", forward);
  find("last").addEventListener("click", () => goTo(last));
  playButton.addEventListener("click", toggle);
  find("reset-view").addEventListener("click", () => stage.resetView());
  find("slider").addEventListener("input", (event) => goTo(Number(event.target.value)));
  document.addEventListener("click", (event) => {
    const item = event.target.closest(".block, .dot, button[data-step]");
    if (item) goTo(Number(item.dataset.step));
  });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.closest("select, input")) return;
    if (event.key === " " && event.target.closest("button, a")) return;
    const action = {
      ArrowLeft: back, ArrowRight: forward, " ": toggle,
      Home: () => goTo(0), End: () => goTo(last),
    }[event.key];
    if (!action) return;
    event.preventDefault();
    action();
  });
  window.addEventListener("hashchange", () => { pause(); moveTo(fromAddress()); });
  moveTo(fromAddress());
  root.dataset.ready = "yes";
})();
