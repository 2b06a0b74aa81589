"use strict";
/* The 3-D view of a plan of cubes: time is counted in steps, at time k step k is done, between k - 1
   and k its block is on the way. With an arm it is counted in seconds (arm.js).

   Whatever moves is an actor: {group, update(time)}. */
function createStage(canvas, data) {
  const edge = data.edge, actors = [];
  // Near: without the arm.
  const near = [
    ...(data.arm ? data.arm.cells.map((cell) => cell.position)
      : [...data.blocks.map((b) => b.position), ...data.waiting.filter(Boolean)]),
    ...data.faces.flat(),
  ];
  const points = data.arm ? [...near, ...data.arm.extent] : near;
  const view = createView(canvas, { points, edge, fromRight: Boolean(data.arm), turn: data.arm?.turn });
  const { scene, coloured, colours } = view;
  const built = [...data.blocks.map((b) => b.position[2]), ...data.faces.flat().map((p) => p[2])];
  const roof = Math.max(edge, ...built) + edge / 2;

  for (const face of data.faces) addTarget(face);
  if (data.arm) {
    actors.push(createArm(data, { edge, cube, coloured, addPlace, colours }));
  } else {
    addBlocks();
  }
  for (const actor of actors) scene.add(actor.group);
  let time = data.arm ? data.arm.duration : data.steps;
  view.whenRepainted(() => update(time));
  view.start();

  return { update, resetView: () => view.look(), nearView: () => view.look(near) };

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
    view.castShadows();
    view.draw();
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
        material.color.set(colours()[current ? "current" : share > 0 ? block.kind : "waiting"]);
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
