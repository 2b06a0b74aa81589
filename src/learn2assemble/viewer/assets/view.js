"use strict";
/* What every 3-D view has: camera and controls for mouse and keyboard, light, table, colours of the
   style sheet, and a picture of it for print. World frame, z up, metres. */
function createView(canvas, { points, edge, floor = 0, first: [turn, aside] }) {
  const names = ["sky", "table", "edge", "accent", "current", "support", "waiting", "soft", "prop", "held", "bad", "blamed", "unbuilt"];
  const theme = () => {
    const style = getComputedStyle(document.documentElement);
    return Object.fromEntries(names.map((name) => [name, style.getPropertyValue("--" + name).trim()]));
  };
  let colours = theme();
  // Where the processor draws, moving pictures are coarse, and the last one is drawn again finely.
  const slow = drawnByProcessor(), ratio = Math.min(window.devicePixelRatio || 1, 2);
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: !slow });
  renderer.setPixelRatio(slow ? 2 : ratio);
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.autoUpdate = false;
  renderer.shadowMap.type = THREE.PCFShadowMap;
  const scene = new THREE.Scene();
  const painted = [], repaint = [];

  // Extent of what has to be seen.
  const low = [0, 1, 2].map((k) => points.reduce((least, p) => Math.min(least, p[k]), Infinity) - (k < 2 ? edge / 2 : 0));
  const high = [0, 1, 2].map((k) => points.reduce((most, p) => Math.max(most, p[k]), -Infinity) + edge / 2);
  low[2] = floor;
  const middle = [0, 1].map((k) => (low[k] + high[k]) / 2);
  const reach = Math.hypot(high[0] - low[0], high[1] - low[1], high[2] - floor) / 2;
  const camera = new THREE.PerspectiveCamera(16, 1, reach / 20, 80 * reach);
  camera.up.set(0, 0, 1);
  const turned = (x, y, z) => new THREE.Vector3(x, y, z).applyAxisAngle(new THREE.Vector3(0, 0, 1), turn);
  const front = turned(aside, -1, 0.6).normalize();
  const behind = document.getElementById("behind"); // What is said where one looks at a drawing from there.

  addLights();
  addTable();
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.maxPolarAngle = 1.54;
  controls.zoomToCursor = true;
  controls.addEventListener("change", draw);
  let touched = false, last = [points, front], ready = false, drawn = 0, still = 0;
  controls.addEventListener("start", () => { touched = true; });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    colours = theme();
    paint();
    for (const action of repaint) action();
  });
  canvas.addEventListener("keydown", onKey);
  window.addEventListener("beforeprint", takePicture);

  return {
    scene, camera, draw, coloured, look, edge,
    colours: () => colours,
    whenRepainted: (action) => repaint.push(action),
    castShadows: () => { renderer.shadowMap.needsUpdate = true; },
    /* After everything is in the scene. */
    start() {
      ready = true;
      paint();
      resize();
      new ResizeObserver(resize).observe(canvas.parentElement);
    },
  };

  function draw() {
    if (!ready) return;
    if (slow) {
      clearTimeout(still);
      if (drawn && performance.now() - drawn < 300) sharpen(0.7);
      still = setTimeout(() => { sharpen(2); render(); }, 400);
    }
    render();
  }

  function render() {
    if (behind) behind.hidden = camera.position.y - controls.target.y < 1e-6 * reach;
    renderer.render(scene, camera);
    drawn = performance.now();
  }

  function sharpen(wanted) {
    if (renderer.getPixelRatio() !== wanted) renderer.setPixelRatio(wanted);
  }

  function resize() {
    const { clientWidth: width, clientHeight: height } = canvas.parentElement;
    if (!width || !height) return;
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    if (touched) draw(); else look(...last);
  }

  /* Look at these points, all of them as near as can be, at first from above the front. */
  function look(wanted = points, from = front) {
    touched = false;
    last = [wanted, from];
    const direction = new THREE.Vector3(...from).normalize();
    const target = new THREE.Vector3(middle[0], middle[1], floor);
    const right = new THREE.Vector3(), up = new THREE.Vector3(), seen = new THREE.Vector3();
    const half = edge * 0.75;
    let distance = 6 * reach;
    for (let round = 0; round < 12; round++) {
      camera.position.copy(target).addScaledVector(direction, distance);
      camera.lookAt(target);
      camera.updateMatrixWorld();
      let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
      for (const [x, y, z] of wanted) {
        for (const [a, b, c] of [[-1, -1, -1], [1, -1, -1], [-1, 1, -1], [1, 1, -1], [-1, -1, 1], [1, -1, 1], [-1, 1, 1], [1, 1, 1]]) {
          seen.set(x + a * half, y + b * half, z + c * half).project(camera);
          x0 = Math.min(x0, seen.x); x1 = Math.max(x1, seen.x);
          y0 = Math.min(y0, seen.y); y1 = Math.max(y1, seen.y);
        }
      }
      const height = distance * Math.tan(camera.fov * Math.PI / 360);
      right.setFromMatrixColumn(camera.matrixWorld, 0);
      up.setFromMatrixColumn(camera.matrixWorld, 1);
      target.addScaledVector(right, (x0 + x1) / 2 * height * camera.aspect);
      target.addScaledVector(up, ((y0 + y1) / 2 + 0.1) * height); // Buttons are over the top edge.
      distance *= Math.min(Math.max((x1 - x0) / 1.9, (y1 - y0) / 1.66, 0.5), 2);
    }
    controls.target.copy(target);
    controls.minDistance = edge * 4;
    controls.maxDistance = distance * 3;
    controls.update();
    draw();
  }

  /* Arrows turn the view about the structure, + and - zoom, 0 shows all of it again. */
  function onKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const turn = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const zoom = { "+": 0.85, "=": 0.85, "-": 1 / 0.85, _: 1 / 0.85 }[event.key];
    if (!turn && !zoom && event.key !== "0") return;
    event.preventDefault();
    event.stopPropagation();
    if (event.key === "0") { look(); return; }
    touched = true;
    const away = camera.position.clone().sub(controls.target);
    const length = Math.min(Math.max(away.length() * (zoom ?? 1), controls.minDistance), controls.maxDistance);
    const azimuth = Math.atan2(away.y, away.x) + (turn ? turn[0] * 0.12 : 0);
    const polar = Math.acos(away.z / away.length()) + (turn ? turn[1] * 0.08 : 0);
    const safe = Math.min(Math.max(polar, 0.01), controls.maxPolarAngle);
    away.set(Math.sin(safe) * Math.cos(azimuth), Math.sin(safe) * Math.sin(azimuth), Math.cos(safe));
    camera.position.copy(controls.target).addScaledVector(away, length);
    controls.update();
    draw();
  }

  /* WebGL is not printed, an ordinary canvas is. */
  function takePicture() {
    const print = document.getElementById("print-view"), paper = scene.background;
    scene.background = new THREE.Color("#ffffff");
    if (slow) sharpen(2);
    render();
    print.width = canvas.width;
    print.height = canvas.height;
    print.getContext("2d").drawImage(canvas, 0, 0);
    scene.background = paper;
    render();
  }

  function paint() {
    scene.background = new THREE.Color(colours.sky);
    for (const [material, name] of painted) material.color.set(colours[name]);
  }

  function coloured(material, name) {
    painted.push([material, name]);
    return material;
  }

  function addLights() {
    scene.add(new THREE.HemisphereLight(0xffffff, 0xd8d2c6, 2.2));
    const sun = new THREE.DirectionalLight(0xffffff, 1.9);
    sun.position.copy(turned(aside > 0 ? -0.9 : 0.9, -1.9, 2.5).multiplyScalar(reach))
      .add(new THREE.Vector3(middle[0], middle[1], floor));
    sun.target.position.set(middle[0], middle[1], floor);
    sun.castShadow = true;
    sun.shadow.mapSize.set(2048, 2048);
    const box = sun.shadow.camera;
    box.left = box.bottom = -1.4 * reach;
    box.right = box.top = 1.4 * reach;
    box.far = 8 * reach;
    sun.shadow.normalBias = edge / 50;
    sun.shadow.radius = 3;
    scene.add(sun, sun.target);
  }

  function addTable() {
    const pad = 1.6 * edge, r = edge;
    const [x0, y0, x1, y1] = [low[0] - pad, low[1] - pad, high[0] + pad, high[1] + pad];
    const shape = new THREE.Shape();
    shape.moveTo(x0 + r, y0).lineTo(x1 - r, y0).absarc(x1 - r, y0 + r, r, -Math.PI / 2, 0)
      .lineTo(x1, y1 - r).absarc(x1 - r, y1 - r, r, 0, Math.PI / 2)
      .lineTo(x0 + r, y1).absarc(x0 + r, y1 - r, r, Math.PI / 2, Math.PI)
      .lineTo(x0, y0 + r).absarc(x0 + r, y0 + r, r, Math.PI, 1.5 * Math.PI);
    const top = new THREE.Mesh(
      new THREE.ShapeGeometry(shape, 12), coloured(new THREE.MeshLambertMaterial(), "table"));
    top.position.z = floor - edge / 125;
    top.receiveShadow = true;
    scene.add(top);
  }
}

/* Whether WebGL has no graphics card behind it. */
function drawnByProcessor() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

/* Numbers as the page carries them: whole numbers from the smallest to the largest, base64. */
function bytes(text) { return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)); }

function unpack({ low, scale, bytes: size, data: text }) {
  const raw = bytes(text), whole = size === 1 ? raw : new Uint16Array(raw.buffer);
  return Float32Array.from(whole, (value, k) => low[k % low.length] + value * scale[k % low.length]);
}
