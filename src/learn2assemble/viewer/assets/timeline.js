"use strict";
/* The timeline: one number, the time, drives the 3-D view, the plans of the layers and the tables.
   A clock says what the number means: steps of the plan, or seconds of an arm's build (arm.js). */
(() => {
  const root = document.documentElement;
  window.addEventListener("error", (event) => { root.dataset.error = String(event.message); });
  const find = (id) => document.getElementById(id);
  const data = JSON.parse(find("data").textContent);
  const SECONDS_PER_STEP = 1.1;
  const clock = data.arm ? armClock(data) : stepClock();
  const last = clock.last;
  const calm = window.matchMedia("(prefers-reduced-motion: reduce)");
  const marked = [...document.querySelectorAll(".block, .label, #rows tr[data-step]")].map((item) => (
    { item, number: Number(item.dataset.step), state: "" }));
  const rows = document.querySelector(".scroll.tall");
  const playButton = find("play");
  const attempts = [...document.querySelectorAll("[data-segment]")];
  let time = last, shown = "", told = "", playing = false, before = 0;

  const stage = openStage();
  const layers = find("layer-plan") ? createLayers(data, stage) : null;

  /* Time in steps: between k - 1 and k the block of step k is on the way. */
  function stepClock() {
    const end = data.steps;
    return {
      last: end,
      speed: 1 / SECONDS_PER_STEP,
      marks: Array.from({ length: end + 1 }, (_, k) => k),
      exact: false,
      timeOf: (step) => step,
      at(now) {
        const step = Math.ceil(now);
        return { step, current: step > 0 ? step : -1, segment: -1, count: `${step} / ${end}`,
          caption: data.captions[step], text: `Step ${step} of ${end}` };
      },
    };
  }

  function openStage() {
    const probe = document.createElement("canvas").getContext("webgl2");
    if (!probe) {
      document.body.classList.add("flat");
      find("no-webgl").hidden = false;
      root.dataset.webgl = "missing";
      return { update() {}, resetView() {}, nearView() {} };
    }
    probe.getExtension("WEBGL_lose_context")?.loseContext();
    const made = createStage(find("canvas"), data);
    root.dataset.webgl = "ready";
    return made;
  }

  function moveTo(now) {
    time = Math.min(Math.max(now, 0), last);
    stage.update(time);
    const here = clock.at(time);
    const key = `${here.step} ${here.segment}`;
    if (key !== shown) { shown = key; showStep(here); }
    if (here.text !== told) { told = here.text; tell(here); }
    if (clock.exact) find("slider").value = String(time);
  }

  /* Everything that changes only from step to step. */
  function showStep({ step, current, segment, caption }) {
    root.dataset.step = String(step);
    for (const mark of marked) {
      const { item, number } = mark, now = number === current;
      const state = `${now} ${number > step}`;
      if (state === mark.state) continue;
      mark.state = state;
      item.classList.toggle("future", number > step);
      item.classList.toggle("done", number <= step);
      item.classList.toggle("current", now);
      if (now && rows?.contains(item)) {
        rows.scrollTop += item.getBoundingClientRect().top - rows.getBoundingClientRect().top - rows.clientHeight / 2;
      }
    }
    layers?.showStep(step);
    for (const item of attempts) {
      const number = Number(item.dataset.segment);
      item.classList.toggle("current", number === segment);
      item.classList.toggle("future", number > segment);
    }
    if (!clock.exact) find("slider").value = String(step);
    find("caption").textContent = caption;
  }

  /* What is said about this very moment. */
  function tell({ count, text, doing, outcome, good }) {
    find("slider").setAttribute("aria-valuetext", text);
    find("count").textContent = count;
    if (!find("doing")) return;
    find("doing-words").textContent = doing;
    const chip = find("outcome");
    chip.textContent = outcome;
    chip.className = `chip ${good ? "good" : "bad"}`;
  }

  function goTo(now) {
    pause();
    moveTo(now);
    const place = clock.exact ? `#t=${time.toFixed(2)}` : `#step=${clock.at(time).step}`;
    history.replaceState(null, "", place);
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
    const speed = Number(find("speed").value);
    const passed = Math.max(now - before, 0) / 1000 * clock.speed * speed;
    if (calm.matches) {
      // No movement asked for: show each step as it stands, then jump to the next.
      const pause = 1000 * SECONDS_PER_STEP / (clock.exact ? 1 : speed);
      if (now - before >= pause) { before = now; moveTo(next()); }
    } else {
      before = now;
      moveTo(time + passed);
    }
    if (time >= last) goTo(last); else requestAnimationFrame(tick);
  }

  function fromAddress() {
    const step = /^#step=(\d+)$/.exec(location.hash);
    if (step) return Math.min(clock.timeOf(Number(step[1])), last);
    const moment = clock.exact && /^#t=(\d+(?:\.\d+)?)$/.exec(location.hash);
    return moment ? Math.min(Number(moment[1]), last) : last;
  }

  const next = () => clock.marks.find((mark) => mark > time + 1e-6) ?? last;
  const back = () => goTo(clock.marks.findLast((mark) => mark < time - 1e-6) ?? 0);
  const forward = () => goTo(next());
  const toggle = () => { if (playing) { pause(); } else { play(); } };
  find("first").addEventListener("click", () => goTo(0));
  find("back").addEventListener("click", back);
  find("forward").addEventListener("click", forward);
  find("last").addEventListener("click", () => goTo(last));
  playButton.addEventListener("click", toggle);
  find("reset-view").addEventListener("click", () => stage.resetView());
  find("near-view")?.addEventListener("click", () => stage.nearView());
  find("slider").addEventListener("input", (event) => goTo(Number(event.target.value)));
  document.addEventListener("click", (event) => {
    const item = event.target.closest(".block, button[data-step]");
    if (item) goTo(clock.timeOf(Number(item.dataset.step)));
    const attempt = event.target.closest("[data-segment]:is(button, rect)");
    if (attempt) goTo(data.arm.segments[Number(attempt.dataset.segment)].start + 0.01);
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
