"use strict";
/* The 3-D view. World frame, z up, metres; time is counted in steps: at time k step k is done,
   between k - 1 and k its block is on the way. With an arm it is counted in seconds (arm.js).

   Whatever moves is an actor: {group, update(time)}. */
function createStage(canvas, data) {
  const theme = () => {
    const style = getComputedStyle(document.documentElement);
    const names = ["sky", "table", "edge", "accent", "first", "wall", "current", "support", "waiting", "soft"];
    return Object.fromEntries(names.map((name) => [name, style.getPropertyValue("--" + name).trim()]));
  };
  let colours = theme();
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = THREE.PCFShadowMap;
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(16, 1, 0.05, 60);
  camera.up.set(0, 0, 1);
  const edge = data.edge;
  const actors = [];
  const painted = [];

  // Extent of what has to be seen; near: without the arm.
  const near = [
    ...(data.arm ? data.arm.cells.map((cell) => cell.position)
      : [...data.blocks.map((b) => b.position), ...data.waiting.filter(Boolean)]),
    ...data.faces.flat(),
  ];
  const points = data.arm ? [...near, ...data.arm.extent] : near;
  const low = [0, 1, 2].map((k) => Math.min(...points.map((p) => p[k])) - (k < 2 ? edge / 2 : 0));
  const high = [0, 1, 2].map((k) => Math.max(...points.map((p) => p[k])) + edge / 2);
  low[2] = 0;
  const middle = [0, 1].map((k) => (low[k] + high[k]) / 2);
  const reach = Math.hypot(high[0] - low[0], high[1] - low[1], high[2]) / 2;
  const built = [...data.blocks.map((b) => b.position[2]), ...data.faces.flat().map((p) => p[2])];
  const roof = Math.max(edge, ...built) + edge / 2;

  addLights();
  addTable();
  for (const face of data.faces) addTarget(face);
  if (data.arm) {
    actors.push(createArm(data, { edge, cube, coloured, addPlace, colours: () => colours }));
  } else {
    addBlocks();
  }
  for (const actor of actors) scene.add(actor.group);

  const controls = new THREE.OrbitControls(camera, canvas);
  controls.maxPolarAngle = 1.54;
  controls.zoomToCursor = true;
  controls.addEventListener("change", draw);
  let touched = false, shown = points;
  controls.addEventListener("start", () => { touched = true; });
  let time = data.arm ? data.arm.duration : data.steps;
  paint();
  resize();
  new ResizeObserver(resize).observe(canvas.parentElement);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    colours = theme();
    paint();
    update(time);
  });

  return { update, resetView: () => resetView(points), nearView: () => resetView(near) };

  function addBlocks() {
    const used = new Map();
    for (const block of data.blocks) {
      actors.push(blockActor(block));
      if (block.waiting !== null) used.set(block.waiting, block);
    }
    data.waiting.forEach((place, index) => {
      if (!place) return; // The first block stands from the start.
      addPlace(place);
      if (!used.has(index)) addSpare(place);
    });
  }

  function update(now) {
    time = now;
    for (const actor of actors) actor.update(now);
    draw();
  }

  function draw() { renderer.render(scene, camera); }

  function resize() {
    const { clientWidth: width, clientHeight: height } = canvas.parentElement;
    if (!width || !height) return;
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    if (touched) draw(); else resetView(shown);
  }

  /* Look from the front and above, as near as shows all these points: from the left, but from the
     right where an arm stands on the left. */
  function resetView(wanted) {
    touched = false;
    shown = wanted;
    const direction = new THREE.Vector3(data.arm ? 0.5 : -0.5, -1, 0.6).normalize();
    const target = new THREE.Vector3(middle[0], middle[1], 0);
    const right = new THREE.Vector3(), up = new THREE.Vector3(), seen = new THREE.Vector3();
    const half = edge * 0.75;
    let distance = 6 * reach;
    for (let round = 0; round < 12; round++) {
      camera.position.copy(target).addScaledVector(direction, distance);
      camera.lookAt(target);
      camera.updateMatrixWorld();
      const xs = [], ys = [];
      for (const [x, y, z] of wanted) {
        for (const [a, b, c] of [[-1, -1, -1], [1, -1, -1], [-1, 1, -1], [1, 1, -1], [-1, -1, 1], [1, -1, 1], [-1, 1, 1], [1, 1, 1]]) {
          seen.set(x + a * half, y + b * half, z + c * half).project(camera);
          xs.push(seen.x);
          ys.push(seen.y);
        }
      }
      const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
      const height = distance * Math.tan(camera.fov * Math.PI / 360);
      right.setFromMatrixColumn(camera.matrixWorld, 0);
      up.setFromMatrixColumn(camera.matrixWorld, 1);
      target.addScaledVector(right, (x0 + x1) / 2 * height * camera.aspect);
      target.addScaledVector(up, (y0 + y1) / 2 * height);
      distance *= Math.min(Math.max((x1 - x0) / 1.9, (y1 - y0) / 1.86, 0.5), 2);
    }
    controls.target.copy(target);
    controls.minDistance = edge * 4;
    controls.maxDistance = distance * 3;
    controls.update();
    draw();
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
    sun.position.set(middle[0] - 0.9 * reach, middle[1] - 1.9 * reach, 2.5 * reach);
    sun.target.position.set(middle[0], middle[1], 0);
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
    top.position.z = -0.0004;
    top.receiveShadow = true;
    scene.add(top);
  }

  function addTarget(face) {
    // The film stands a hair behind the face plane, also after the cubes' own offset in depth: it
    // shows what is not filled yet.
    const corners = face.map((p) => new THREE.Vector3(...p));
    const normal = faceNormal(corners);
    for (const c of corners) c.addScaledVector(normal, -edge / 50);
    const along = new THREE.Vector3(normal.y, -normal.x, 0);
    const shape = new THREE.Shape();
    corners.forEach((c, k) => (k ? shape.lineTo(c.dot(along), c.z) : shape.moveTo(c.dot(along), c.z)));
    const sheet = new THREE.ShapeGeometry(shape);
    // A plane through the outline: local x runs along the side, local y is up.
    sheet.rotateX(Math.PI / 2);
    sheet.rotateZ(Math.atan2(along.y, along.x));
    const offset = normal.clone().multiplyScalar(corners[0].dot(normal));
    sheet.translate(offset.x, offset.y, 0);
    for (const c of corners) c.addScaledVector(normal, edge / 50);
    const film = new THREE.Mesh(sheet, coloured(new THREE.MeshBasicMaterial({
      transparent: true, opacity: 0.2, side: THREE.DoubleSide, depthWrite: false,
      polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 4,
    }), "accent"));
    film.renderOrder = 2;
    scene.add(film);
    corners.forEach((a, k) => {
      const b = corners[(k + 1) % corners.length];
      const rod = new THREE.Mesh(
        new THREE.CylinderGeometry(edge / 40, edge / 40, a.distanceTo(b), 8),
        coloured(new THREE.MeshBasicMaterial(), "accent"));
      rod.position.copy(a).add(b).multiplyScalar(0.5);
      rod.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), b.clone().sub(a).normalize());
      scene.add(rod);
    });
  }

  /* The side's outward direction: horizontal, away from the middle of the structure's footprint
     where the outline's own turning direction leaves it open. */
  function faceNormal(corners) {
    let area = new THREE.Vector3();
    for (let k = 0; k < corners.length; k++) {
      area.add(corners[k].clone().cross(corners[(k + 1) % corners.length]));
    }
    const normal = new THREE.Vector3(area.x, area.y, 0).normalize();
    if (!normal.lengthSq()) normal.set(0, -1, 0);
    const solid = data.blocks.length ? data.blocks.map((b) => b.position) : data.faces.flat();
    const mean = new THREE.Vector3();
    for (const p of solid) mean.add(new THREE.Vector3(...p));
    mean.divideScalar(solid.length);
    return corners[0].clone().sub(mean).dot(normal) < 0 ? normal.negate() : normal;
  }

  /* A cube whose side faces carry an upright picture of its number. */
  function cubeGeometry() {
    const h = edge / 2, position = [], normals = [], uv = [], index = [];
    const faces = [
      [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
      [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
      [[0, 0, 1], [1, 0, 0], [0, 1, 0]], [[0, 0, -1], [1, 0, 0], [0, -1, 0]],
    ];
    faces.forEach(([n, u, v], f) => {
      for (const [a, b] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
        position.push(...[0, 1, 2].map((k) => h * (n[k] + a * u[k] + b * v[k])));
        normals.push(...n);
        uv.push((a + 1) / 2, (b + 1) / 2);
      }
      index.push(...[0, 1, 2, 0, 2, 3].map((k) => 4 * f + k));
    });
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(position, 3));
    geometry.setAttribute("normal", new THREE.Float32BufferAttribute(normals, 3));
    geometry.setAttribute("uv", new THREE.Float32BufferAttribute(uv, 2));
    geometry.setIndex(index);
    return geometry;
  }

  function numberPicture(number) {
    const picture = document.createElement("canvas");
    picture.width = picture.height = 128;
    const pen = picture.getContext("2d");
    pen.fillStyle = "#fff";
    pen.fillRect(0, 0, 128, 128);
    pen.fillStyle = "#26221c";
    pen.font = "600 56px system-ui, 'Liberation Sans', Arial, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    if (number !== null) pen.fillText(String(number), 64, 68);
    const texture = new THREE.CanvasTexture(picture);
    texture.colorSpace = THREE.SRGBColorSpace;
    texture.anisotropy = 8;
    return texture;
  }

  function cube(number) {
    createStage.cube ??= cubeGeometry();
    createStage.rim ??= new THREE.EdgesGeometry(new THREE.BoxGeometry(edge, edge, edge));
    const material = new THREE.MeshLambertMaterial({
      map: numberPicture(number), polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2,
    });
    const mesh = new THREE.Mesh(createStage.cube, material);
    mesh.castShadow = mesh.receiveShadow = true;
    const rim = coloured(new THREE.LineBasicMaterial(), "edge");
    const group = new THREE.Group().add(mesh, new THREE.LineSegments(createStage.rim, rim));
    return { group, material };
  }

  function blockActor(block) {
    const { group, material } = cube(block.number);
    const [w, x, y, z] = block.quaternion;
    const goal = new THREE.Vector3(...block.position);
    const goalTurn = new THREE.Quaternion(x, y, z, w);
    const start = block.waiting === null ? goal : new THREE.Vector3(...data.waiting[block.waiting]);
    const clear = roof + edge;
    const ease = (t) => { const u = Math.min(Math.max(t, 0), 1); return u * u * (3 - 2 * u); };
    return {
      group,
      update(now) {
        const share = block.number === 0 ? 1 : Math.min(Math.max(now - block.number + 1, 0), 1);
        const lift = ease(share / 0.3), across = ease((share - 0.22) / 0.5), lower = ease((share - 0.66) / 0.34);
        group.position.lerpVectors(start, goal, across);
        if (share < 1) {
          const up = start.z + (clear - start.z) * lift;
          group.position.z = up + (goal.z - clear) * lower;
        }
        group.quaternion.identity().slerp(goalTurn, across);
        const current = block.number > 0 && Math.ceil(now) === block.number;
        material.color.set(colours[current ? "current" : share > 0 ? block.kind : "waiting"]);
      },
    };
  }

  function addSpare(place) {
    const { group, material } = cube(null);
    coloured(material, "waiting");
    group.position.set(...place);
    scene.add(group);
  }

  /* The mark on the table where a block waits. */
  function addPlace([x, y, z]) {
    const h = edge / 2;
    const corners = [[-h, -h], [h, -h], [h, h], [-h, h]].map(
      ([a, b]) => new THREE.Vector3(x + a, y + b, z - h + 0.0006));
    const line = coloured(new THREE.LineBasicMaterial({ transparent: true, opacity: 0.5 }), "soft");
    scene.add(new THREE.LineLoop(new THREE.BufferGeometry().setFromPoints(corners), line));
  }
}
