"use strict";
/* The 3-D view of an assembly. All blocks are one mesh and all their edges one set of lines, so that
   thousands are drawn in two calls, and all knobs are instances of one cylinder. Sides and knobs that
   are covered by blocks that stand, and edges between such sides, are left out: of a wall that is
   most of them. */
function createStage(canvas, data) {
  const edge = data.edge, sun = sunOf(data.view), blocks = readBlocks(data), shapes = readShapes(data.shapes, sun);
  const points = blocks.flatMap(({ shape, at }) => {
    const { low, high } = shapes[shape];
    return [at.map((v, k) => v + low[k]), at.map((v, k) => v + high[k])];
  }).concat(data.targets.flatMap(({ outline }) => outline), data.boxes.flatMap(({ low, high }) => [low, high]),
    data.marks.flatMap(({ boxes }) => boxes.flatMap((box) => [box.slice(0, 3), box.slice(3)])));
  const there = data.arm ?? data.standing;
  const areas = (data.standing?.areas ?? []).flat(2).map(([x, y]) => [x, y, data.floor]);
  const seen = there ? [...points, ...there.extent, ...areas] : points;
  const view = createView(canvas, { points: seen, edge, floor: data.floor, first: data.view });
  const roof = points.reduce((most, p) => Math.max(most, p[2]), -Infinity);

  let corners = 0, ends = 0;
  for (const block of blocks) {
    const shape = shapes[block.shape];
    Object.assign(block, { corner: corners, end: ends, state: "" });
    corners += shape.corners.length;
    ends += shape.edges.length;
  }
  const skin = geometry(corners, ["position", "color"]), lines = geometry(ends, ["position"]);
  for (const made of [skin, lines]) {
    made.setIndex(Array.from({ length: made.attributes.position.count }, (_, k) => k));
  }
  // Blocks do not turn, so the light on their faces is part of their colours.
  const material = new THREE.MeshBasicMaterial({
    vertexColors: true, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2,
  });
  const rim = view.coloured(new THREE.LineBasicMaterial(), "edge");
  const mesh = new THREE.Mesh(skin, material), edges = new THREE.LineSegments(lines, rim);
  mesh.castShadow = true;
  mesh.frustumCulled = edges.frustumCulled = false;
  view.scene.add(mesh, edges);
  const knobs = addKnobs();
  for (const target of data.targets) addTarget(target);
  for (const goal of data.boxes) addBox(goal);
  for (const mark of data.marks) addMark(mark);
  addUnbuilt();
  // An arm moves every block on its own; the mesh of all is for the layers then.
  const arm = data.arm
    ? createArm(data, { cube: solid, coloured: view.coloured, colours: view.colours }) : null;
  if (arm) view.scene.add(arm.group);
  if (data.standing) view.scene.add(createStanding(data.standing, data.floor, view.coloured));
  const overlays = { joints: addJoints(), forces: addForces() };

  const end = data.arm ? data.arm.duration : data.steps;
  let time = end, cut = null, standing = -1;
  view.whenRepainted(() => { for (const block of blocks) block.state = ""; update(time); });
  view.start();
  canvas.addEventListener("pointerdown", (event) => { canvas.pressed = [event.clientX, event.clientY]; });
  canvas.addEventListener("pointerup", (event) => {
    const [x, y] = canvas.pressed ?? [Infinity, Infinity];
    if (Math.hypot(event.clientX - x, event.clientY - y) < 4) tellPicked(event);
  });
  for (const name of ["joints", "forces"]) {
    document.getElementById("show-" + name)?.addEventListener("change", () => update(time));
  }
  document.getElementById("from-above").addEventListener("click", () => view.look(points, [0, -0.001, 1]));
  for (const button of document.querySelectorAll("button[data-side]")) {
    const [x, y] = data.targets[Number(button.dataset.side)].outward;
    button.addEventListener("click", () => view.look(points, [x, y, 0.04]));
  }

  return {
    update(now) { cut = null; update(now); },
    showLayer(layer) { cut = layer; update(time); },
    resetView: () => view.look(),
    nearView: () => view.look(points),
  };

  function update(now) {
    time = now;
    if (arm) {
      arm.group.visible = cut === null;
      mesh.visible = edges.visible = cut !== null;
      if (knobs) knobs.mesh.visible = mesh.visible;
      if (cut === null) {
        arm.update(now);
        for (const group of Object.values(overlays)) group.visible = false;
        view.castShadows();
        view.draw();
        return;
      }
    }
    const colours = view.colours(), moved = [];
    let count = 0;
    for (const block of blocks) {
      const { lift, colour } = cut === null ? atTime(block, now) : inLayer(block);
      if (colour !== null && !lift) count += 1;
      const state = colour === null ? "" : `${colour} ${lift}`;
      if (state === block.state) continue;
      block.state = state;
      moved.push(block);
      write(block, colour === null ? null : lift, colour === null ? "" : shade(colour, colours));
    }
    refresh(moved);
    if (moved.length) { leaveOutCovered(); knobs?.place(); }
    const whole = cut === null && now >= end;
    let glass = false;
    for (const [name, group] of Object.entries(overlays)) {
      group.visible = whole && Boolean(document.getElementById("show-" + name)?.checked);
      glass ||= group.visible;
    }
    if (material.transparent !== glass) {
      Object.assign(material, { transparent: glass, opacity: glass ? 0.25 : 1, depthWrite: !glass, needsUpdate: true });
      Object.assign(rim, { transparent: glass, opacity: glass ? 0.3 : 1, needsUpdate: true });
      if (knobs) Object.assign(knobs.mesh.material, { transparent: glass, opacity: glass ? 0.25 : 1, depthWrite: !glass, needsUpdate: true });
      mesh.castShadow = !glass;
    }
    if (count !== standing) view.castShadows(); // Not for every place a block passes on its way.
    standing = count;
    view.draw();
  }

  /* What the blocks of a task shall cover: a film a hair behind their faces, which shows what is not
     filled yet, with its outline. */
  function addTarget({ outline, outward }) {
    const normal = new THREE.Vector3(...outward), along = new THREE.Vector3(-normal.y, normal.x, 0);
    const corners = outline.map((p) => new THREE.Vector3(...p));
    const shape = new THREE.Shape();
    corners.forEach((c, k) => (k ? shape.lineTo(c.dot(along), c.z) : shape.moveTo(c.dot(along), c.z)));
    // Local x runs along the side, local y is up.
    const sheet = new THREE.ShapeGeometry(shape).rotateX(Math.PI / 2).rotateZ(Math.atan2(along.y, along.x));
    sheet.translate(...normal.clone().multiplyScalar(corners[0].dot(normal) - edge / 50));
    const film = new THREE.Mesh(sheet, view.coloured(
      new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.2, side: THREE.DoubleSide, depthWrite: false }), "accent"));
    film.renderOrder = 2;
    view.scene.add(film);
    corners.forEach((a, k) => addRod(a, corners[(k + 1) % corners.length], "accent"));
  }

  function addRod(a, b, tone) {
    const length = a.distanceTo(b);
    const rod = new THREE.Mesh(new THREE.CylinderGeometry(edge / 40, edge / 40, length, 8),
      view.coloured(new THREE.MeshBasicMaterial(), tone));
    rod.position.copy(a).add(b).multiplyScalar(0.5);
    rod.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), b.clone().sub(a).divideScalar(length));
    view.scene.add(rod);
  }

  /* Goals and obstacles: a film over all sides of a box, or over a face, with its edges. */
  function addBox({ what, low, high }) {
    const tone = what === "obstacle" ? "bad" : "accent";
    const size = high.map((v, k) => Math.max(v - low[k], edge / 100));
    const film = new THREE.Mesh(new THREE.BoxGeometry(...size), view.coloured(
      new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.2, depthWrite: false }), tone));
    film.position.set(...low.map((v, k) => (v + high[k]) / 2));
    film.renderOrder = 2;
    view.scene.add(film);
    for (let from = 0; from < 8; from++) {
      for (let k = 0; k < 3; k++) {
        if (from & (1 << k) || high[k] - low[k] < edge / 100) continue;
        const corner = (bits) => new THREE.Vector3(...low.map((v, n) => (bits & (1 << n) ? high[n] : v)));
        addRod(corner(from), corner(from | (1 << k)), tone);
      }
    }
  }

  /* The edges of blocks that no step places. */
  function addUnbuilt() {
    const ends = [];
    for (const { placed, shape, at } of blocks) {
      if (placed <= data.steps) continue;
      shapes[shape].edges.forEach((v, k) => ends.push(v + at[k % 3]));
    }
    view.scene.add(bundle(ends, "unbuilt"));
  }

  /* Cells to blame: a film over all of them, with their edges. */
  function addMark({ boxes }) {
    const sides = [], edges = [], grow = edge / 40;
    for (const box of boxes) {
      const corner = (bits) => [0, 1, 2].map((k) => (bits & (1 << k) ? box[k + 3] + grow : box[k] - grow));
      for (let axis = 0; axis < 3; axis++) {
        const [u, v, w] = [1 << axis, 1 << (axis + 1) % 3, 1 << (axis + 2) % 3];
        for (const at of [0, w]) {
          const [a, b, c, d] = [at, at | u, at | u | v, at | v].map(corner);
          sides.push(...a, ...b, ...c, ...a, ...c, ...d);
        }
        for (const at of [0, v, w, v | w]) edges.push(...corner(at), ...corner(at | u));
      }
    }
    const film = new THREE.BufferGeometry();
    film.setAttribute("position", new THREE.Float32BufferAttribute(sides, 3));
    const made = new THREE.Mesh(film, view.coloured(new THREE.MeshBasicMaterial({
      transparent: true, opacity: 0.45, side: THREE.DoubleSide, depthWrite: false,
    }), "blamed"));
    made.renderOrder = 3;
    view.scene.add(made, bundle(edges, "blamed"));
  }

  /* A box, or the solid whose triangles have these corners. */
  function solid(half, corners) {
    const sides = corners ? new THREE.BufferGeometry() : new THREE.BoxGeometry(...half.map((v) => 2 * v));
    if (corners) {
      sides.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
      sides.computeVertexNormals();
    }
    const material = new THREE.MeshLambertMaterial({
      polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2,
    });
    const piece = new THREE.Mesh(sides, material);
    piece.castShadow = piece.receiveShadow = true;
    const group = new THREE.Group().add(piece, new THREE.LineSegments(new THREE.EdgesGeometry(sides), rim));
    return { group, material, sides };
  }

  /* How far above its place a block is, and its colour; null where it is not there. */
  function atTime({ placed, removed, holds, colour }, now) {
    const there = placed ? now - placed + 1 : 1, gone = removed ? now - removed + 1 : 0;
    if (there <= 0 || gone >= 1) return { lift: 0, colour: null };
    const share = gone > 0 ? gone : 1 - Math.min(there, 1);
    const step = Math.ceil(now), current = step > 0 && (step === placed || step === removed || isLetGo(holds, step));
    const shown = current ? "current" : isHeld(holds, step) ? "held" : colour;
    return { lift: Math.round(1000 * share * share) / 1000, colour: shown };
  }

  function inLayer({ layer, colour, placed, removed }) {
    return { lift: 0, colour: layer > cut || isOld(placed, removed) ? null : layer < cut ? `faded ${colour}` : colour };
  }

  function shade(name, colours) {
    const faded = name.startsWith("faded ");
    const own = faded ? name.slice(6) : name;
    const colour = new THREE.Color(colours[own] ?? own);
    return faded ? colour.lerp(new THREE.Color(colours.table), 0.6) : colour;
  }

  /* The knobs of all blocks; null where there are none. */
  function addKnobs() {
    const first = blocks[0]?.at, over = new Map(), all = [];
    const key = (...at) => at.map((v, k) => Math.round(1e4 * (v - first[k]))).join();
    for (const block of blocks) {
      const [x, y, z] = block.at;
      for (const [u, v] of data.knobs[block.shape]) over.set(key(x + u, y + v, z), block);
    }
    for (const block of blocks) {
      const [x, y, z] = block.at, top = z + shapes[block.shape].high[2];
      for (const [u, v] of data.knobs[block.shape]) {
        all.push({ block, x: x + u, y: y + v, z: top, under: over.get(key(x + u, y + v, top)) });
      }
    }
    if (!all.length) return null;
    const [radius, height] = data.knob;
    const made = new THREE.CylinderGeometry(radius, radius, height, 12, 1).rotateX(Math.PI / 2).translate(0, 0, height / 2);
    const normal = made.attributes.normal.array, light = normal.map((_, k) => lightOn(normal, k - k % 3, sun));
    made.setAttribute("color", new THREE.Float32BufferAttribute(light, 3));
    const cylinders = new THREE.InstancedMesh(made, new THREE.MeshBasicMaterial({ vertexColors: true }), all.length);
    cylinders.setColorAt(0, new THREE.Color());
    cylinders.frustumCulled = false;
    view.scene.add(cylinders);
    const at = cylinders.instanceMatrix.array, paint = cylinders.instanceColor.array;
    const stands = (block) => block && block.state.endsWith(" 0");
    function place() {
      let n = 0;
      for (const { block, x, y, z, under } of all) {
        if (!block.state || (stands(block) && stands(under))) continue;
        at[16 * n] = at[16 * n + 5] = at[16 * n + 10] = at[16 * n + 15] = 1;
        at[16 * n + 12] = x; at[16 * n + 13] = y; at[16 * n + 14] = z + block.up;
        block.paint.toArray(paint, 3 * n);
        n += 1;
      }
      cylinders.count = n;
      cylinders.instanceMatrix.needsUpdate = cylinders.instanceColor.needsUpdate = true;
    }
    return { mesh: cylinders, place };
  }

  function write(block, lift, colour) {
    const shape = shapes[block.shape], [x, y, z] = block.at;
    const up = lift === null ? 0 : lift * Math.max(2.5 * edge, 0.35 * (roof - data.floor));
    Object.assign(block, { up, paint: colour });
    for (const [target, from, source] of [
      [skin.attributes.position.array, block.corner, shape.corners],
      [lines.attributes.position.array, block.end, shape.edges],
    ]) {
      if (lift === null) { target.fill(0, from, from + source.length); continue; }
      for (let k = 0; k < source.length; k += 3) {
        target[from + k] = source[k] + x;
        target[from + k + 1] = source[k + 1] + y;
        target[from + k + 2] = source[k + 2] + z + up;
      }
    }
    if (lift === null) return;
    const paint = skin.attributes.color.array;
    for (let k = 0; k < shape.corners.length; k += 3) {
      const light = shape.light[k / 3], to = block.corner + k;
      paint[to] = light * colour.r; paint[to + 1] = light * colour.g; paint[to + 2] = light * colour.b;
    }
  }

  /* Index what is seen: of every block that is there the sides that no standing blocks cover. */
  function leaveOutCovered() {
    const faces = skin.index.array, rims = lines.index.array, shown = [];
    let filled = 0, drawn = 0;
    const stands = (number) => blocks[number].state.endsWith(" 0");
    for (const block of blocks) {
      if (!block.state) continue;
      const shape = shapes[block.shape], covers = stands(block.number) ? data.covers[block.number] : null;
      for (let side = 0; side < 6; side++) {
        const by = covers ? covers[side] : [];
        shown[side] = !by.length || !by.every(stands);
      }
      const whole = !covers || shown.every(Boolean), first = block.corner / 3, start = block.end / 3;
      for (let k = 0; k < shape.sides.length; k++) {
        if (!whole && !shown[shape.sides[k]]) continue;
        for (let c = 0; c < 3; c++) faces[filled++] = first + 3 * k + c;
      }
      for (let k = 0; k < shape.between.length; k++) {
        if (!whole && !shape.between[k].some((side) => shown[side])) continue;
        for (let c = 0; c < 2; c++) rims[drawn++] = start + 2 * k + c;
      }
    }
    skin.setDrawRange(0, filled);
    lines.setDrawRange(0, drawn);
    skin.index.needsUpdate = lines.index.needsUpdate = true;
  }

  /* Send what has changed, and only that where it is little. */
  function refresh(moved) {
    if (!moved.length) return;
    const few = moved.length <= 24;
    for (const [name, attribute] of [...Object.entries(skin.attributes), ["line", lines.attributes.position]]) {
      attribute.clearUpdateRanges();
      if (few) {
        for (const block of moved) {
          const shape = shapes[block.shape];
          if (name === "line") attribute.addUpdateRange(block.end, shape.edges.length);
          else attribute.addUpdateRange(block.corner, shape.corners.length);
        }
      }
      attribute.needsUpdate = true;
    }
  }

  function geometry(size, names) {
    const made = new THREE.BufferGeometry();
    for (const name of names) {
      made.setAttribute(name, new THREE.Float32BufferAttribute(new Float32Array(size), 3));
    }
    return made;
  }

  function addJoints() {
    const group = new THREE.Group();
    if (data.joints) {
      const { points: packed, start } = data.joints, at = unpack(packed), ends = [];
      start.slice(0, -1).forEach((first, patch) => {
        for (let k = first; k < start[patch + 1]; k++) {
          const next = k + 1 < start[patch + 1] ? k + 1 : first;
          ends.push(...at.slice(3 * k, 3 * k + 3), ...at.slice(3 * next, 3 * next + 3));
        }
      });
      group.add(bundle(ends, "soft"));
    }
    view.scene.add(group);
    return group;
  }

  /* Arrows at the corners of the joints, the largest two blocks long. */
  function addForces() {
    const group = new THREE.Group();
    if (data.joints?.forces) {
      const at = unpack(data.joints.points), force = unpack(data.joints.forces), ends = [];
      const from = new THREE.Vector3(), along = new THREE.Vector3(), side = new THREE.Vector3();
      const scale = 2 * edge / data.joints.largest;
      for (let k = 0; k < at.length; k += 3) {
        along.set(force[k], force[k + 1], force[k + 2]).multiplyScalar(scale);
        if (along.length() < 0.01 * edge) continue;
        from.set(at[k], at[k + 1], at[k + 2]);
        const tip = from.clone().add(along);
        side.crossVectors(along, Math.abs(along.z) < 0.9 * along.length() ? new THREE.Vector3(0, 0, 1) : new THREE.Vector3(1, 0, 0));
        side.setLength(0.08 * along.length());
        ends.push(...from, ...tip);
        for (const sign of [1, -1]) {
          const barb = tip.clone().addScaledVector(along, -0.18).addScaledVector(side, sign);
          ends.push(...tip, ...barb);
        }
      }
      group.add(bundle(ends, "accent"));
    }
    view.scene.add(group);
    return group;
  }

  function bundle(ends, colour) {
    const made = new THREE.BufferGeometry();
    made.setAttribute("position", new THREE.Float32BufferAttribute(ends, 3));
    return new THREE.LineSegments(made, view.coloured(new THREE.LineBasicMaterial(), colour));
  }

  /* The nearest standing block whose bounding box is under the pointer. */
  function tellPicked(event) {
    const frame = canvas.getBoundingClientRect();
    const x = 2 * (event.clientX - frame.left) / frame.width - 1, y = 1 - 2 * (event.clientY - frame.top) / frame.height;
    const from = view.camera.position.toArray();
    const ray = new THREE.Vector3(x, y, 0.5).unproject(view.camera).sub(view.camera.position).toArray();
    let nearest = Infinity, picked = null;
    for (const block of blocks) {
      if (!block.state) continue;
      const { low, high } = shapes[block.shape];
      let enter = 0, leave = Infinity;
      for (let k = 0; k < 3; k++) {
        const ends = [low[k], high[k]].map((v) => (v + block.at[k] - from[k]) / ray[k]);
        enter = Math.max(enter, Math.min(...ends));
        leave = Math.min(leave, Math.max(...ends));
      }
      if (enter < leave && enter < nearest) { nearest = enter; picked = block; }
    }
    document.getElementById("picked").textContent = picked ? picked.words : "";
  }
}

/* Whether a hand holds a block after a step, or lets it go in this step. */
function isHeld(holds, step) { return holds.some(([from, to]) => from <= step && step < to); }
function isLetGo(holds, step) { return holds.some(([, to]) => to === step); }

/* Blocks of the page with names for their fields. */
function readBlocks(data) {
  return data.blocks.map(([shape, x, y, z, kind, colour, layer, placed, removed, name], number) => {
    const holds = data.holds.flatMap(([block, ...ends]) => (block === number ? [ends] : []));
    const history = [placed && `placed in step ${placed}`, removed && `removed in step ${removed}`,
      ...holds.map(([from, to]) => `held from step ${from}` + (to <= data.steps ? ` to step ${to}` : ""))];
    return {
      number, shape, at: [x, y, z], colour: data.colours[colour], layer, placed, removed, holds, kind, name,
      words: [name, data.kinds[kind], `layer ${layer + 1}`, ...history].filter(Boolean).join(", "),
    };
  });
}

/* Whence the light comes: as one looks at it from first, over the other shoulder. */
function sunOf([turn, aside]) {
  const x = aside > 0 ? -0.27 : 0.27, y = -0.57, [c, s] = [Math.cos(turn), Math.sin(turn)];
  return [c * x - s * y, s * x + c * y, 0.76];
}

/* How light a surface is whose normal begins at a place of an array. */
function lightOn(normal, from, sun) {
  const facing = sun.reduce((sum, v, axis) => sum + v * normal[from + axis], 0);
  return Math.min(0.62 + 0.1 * normal[from + 2] + 0.36 * Math.max(facing, 0), 1);
}

/* Of every shape: triangles with their normals, edges, and the bounding box. */
function readShapes({ vertices, triangles, wide, first, faces }, sun) {
  const all = unpack(vertices), raw = bytes(triangles).buffer;
  const index = wide ? new Uint32Array(raw) : new Uint16Array(raw);
  return first.slice(0, -1).map((start, shape) => {
    const own = all.subarray(3 * start, 3 * first[shape + 1]);
    const picks = index.subarray(3 * faces[shape], 3 * faces[shape + 1]);
    const corners = new Float32Array(3 * picks.length);
    picks.forEach((vertex, k) => corners.set(own.subarray(3 * vertex, 3 * vertex + 3), 3 * k));
    const made = new THREE.BufferGeometry();
    made.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
    made.computeVertexNormals(); // Corners are not shared, so every face is flat.
    const normal = made.attributes.normal.array;
    const light = Float32Array.from({ length: picks.length }, (_, k) => lightOn(normal, 3 * k, sun));
    const extent = (pick, begin) => [0, 1, 2].map((k) =>
      own.reduce((value, v, place) => (place % 3 === k ? pick(value, v) : value), begin));
    const low = extent(Math.min, Infinity), high = extent(Math.max, -Infinity);
    const edges = new THREE.EdgesGeometry(made, 20).attributes.position.array;
    // Which side of a box each triangle is, and between which each edge is: 2 axis + (upper end).
    const sides = Array.from({ length: picks.length / 3 }, (_, k) => {
      const axis = [0, 1, 2].reduce((a, b) => (Math.abs(normal[9 * k + b]) > Math.abs(normal[9 * k + a]) ? b : a));
      return 2 * axis + (normal[9 * k + axis] > 0 ? 1 : 0);
    });
    const between = Array.from({ length: edges.length / 6 }, (_, k) => [0, 1, 2].flatMap((axis) => {
      const [from, to] = [edges[6 * k + axis], edges[6 * k + 3 + axis]], middle = (low[axis] + high[axis]) / 2;
      return (from > middle) === (to > middle) ? [2 * axis + (from > middle ? 1 : 0)] : [];
    }));
    return { corners, light, edges, low, high, sides, between };
  });
}

/* Whether a block stood before the first step and is gone at the end: no part of what is built. */
function isOld(placed, removed) {
  return !placed && removed > 0;
}

/* The plan of one layer seen from above: the blocks that begin in it, those from below that reach
   into it, and the layer below as dashed outlines. */
function createLayers(data, stage) {
  const blocks = readBlocks(data), find = (id) => document.getElementById(id);
  const slider = find("layer"), plan = find("layer-plan");
  const byLayer = data.layers.map(() => []);
  const built = blocks.filter(({ placed, removed }) => !isOld(placed, removed));
  for (const block of built.length ? built : blocks) {
    data.shapes.sections[block.shape].forEach(([low, high, rings, middle], number) => {
      const [bottom, top] = [low + block.at[2], high + block.at[2]];
      data.heights.forEach((height, layer) => {
        const begins = layer === block.layer && number === 0;
        const shared = Math.min(top, data.heights[layer + 1] ?? Infinity) - Math.max(bottom, height);
        if (begins || shared > 0.02 * data.edge) byLayer[layer].push({ block, rings, middle, begins, above: layer > block.layer });
      });
    });
  }
  const order = [];
  for (const block of blocks) {
    if (block.placed) order[block.placed] = block;
    if (block.removed) order[block.removed] = block;
    for (const number of block.holds.flat()) order[number] = block;
  }
  let shown = -1, step = data.steps;
  slider.addEventListener("input", () => {
    show(Number(slider.value) - 1, Infinity);
    stage.showLayer?.(Number(slider.value) - 1);
  });
  return { showStep(now) { show(order[now]?.layer ?? (now ? data.layers.length - 1 : 0), now); } };

  function show(layer, now) {
    slider.value = String(layer + 1);
    find("layer-words").textContent = data.layers[layer];
    if (layer !== shown) draw(layer);
    shown = layer;
    step = now;
    for (const item of plan.querySelectorAll("[data-step]")) {
      const placed = Number(item.dataset.step), removed = Number(item.dataset.removed) || Infinity;
      const { holds } = blocks[Number(item.dataset.block)];
      item.classList.toggle("current", step > 0 && (placed === step || removed === step || isLetGo(holds, step)));
      item.classList.toggle("held", isHeld(holds, step));
      item.classList.toggle("future", placed > step || removed < step);
    }
  }

  function draw(layer) {
    const made = (name, attributes, text) => {
      const item = document.createElementNS("http://www.w3.org/2000/svg", name);
      for (const [key, value] of Object.entries(attributes)) item.setAttribute(key, value);
      if (text !== undefined) item.textContent = text;
      return item;
    };
    const path = ({ block: { at }, rings }) => rings.map((ring) => "M" + ring
      .map(([x, y]) => `${(1000 * (x + at[0])).toFixed(1)},${(-1000 * (y + at[1])).toFixed(1)}`).join("L") + "Z").join("");
    const items = [...ruler(made), ...(byLayer[layer - 1] ?? []).map((part) => made("path", { class: "below", d: path(part) }))];
    const sections = byLayer[layer].toSorted((a, b) => b.above - a.above);
    for (const part of sections) {
      const { block, middle: [x, y] } = part;
      const steps = { "data-step": block.placed, "data-block": block.number, ...(block.removed ? { "data-removed": block.removed } : {}) };
      const named = block.colour.startsWith("#") ? "" : ` ${block.colour}`;
      const item = made("path", { class: "block" + (part.above ? " reaching" : "") + named, d: path(part), ...steps });
      if (!named) item.setAttribute("fill", block.colour);
      item.append(made("title", {}, block.words));
      const size = Math.min(420 * data.edge, data.shapes.widths[block.shape] * 450);
      items.push(item);
      if (block.placed && part.begins) {
        items.push(made("text", {
          class: "label", x: (1000 * (x + block.at[0])).toFixed(1), "font-size": size.toFixed(1), ...steps,
          y: (-1000 * (y + block.at[1]) + 0.36 * size).toFixed(1),
        }, block.placed));
      }
    }
    for (const { words, boxes } of data.marks) {
      const [from, to] = [data.heights[layer], data.heights[layer + 1] ?? Infinity];
      for (const [x, y, low, right, back, high] of boxes) {
        if (Math.min(high, to) - Math.max(low, from) < 0.02 * data.edge) continue;
        const item = made("rect", { class: "blamed", x: 1000 * x, y: -1000 * back,
          width: 1000 * (right - x), height: 1000 * (back - y) });
        item.append(made("title", {}, words));
        items.push(item);
      }
    }
    plan.replaceChildren(...items);
  }

  /* Lines at whole distances from O, with the distances in front and at the left. */
  function ruler(made) {
    const { origin, step, count } = data.scale, [x0, y0] = origin;
    const [, , width, height] = plan.getAttribute("viewBox").split(" ").map(Number);
    const size = 0.03 * Math.max(width, height), mm = (v) => (1000 * v).toFixed(1);
    const [x1, y1] = [x0 + count[0] * step, y0 + count[1] * step];
    const told = (k, last, axis) => (k === 0 ? "O" : `${k === last ? axis + " " : ""}${+(1000 * k * step).toFixed(1)}`);
    const items = [];
    for (let k = 0; k <= count[0]; k++) {
      const x = x0 + k * step;
      items.push(made("path", { class: "grid", d: `M${mm(x)},${mm(-y0)}V${mm(-y1)}` }),
        made("text", { class: "scale", x: mm(x), y: (-1000 * y0 + 1.3 * size).toFixed(1), "font-size": size.toFixed(1) }, told(k, count[0], "x")));
    }
    for (let k = 0; k <= count[1]; k++) {
      const y = y0 + k * step;
      items.push(made("path", { class: "grid", d: `M${mm(x0)},${mm(-y)}H${mm(x1)}` }));
      if (k) items.push(made("text", { class: "scale left", x: (1000 * x0 - 0.4 * size).toFixed(1), y: (-1000 * y + 0.35 * size).toFixed(1), "font-size": size.toFixed(1) }, told(k, count[1], "y")));
    }
    return items;
  }
}
