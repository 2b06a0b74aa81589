"use strict";
/* The arms of a build. Their clock runs in seconds; segments are the attempts of all arms in the
   order in which they end. What happens when is decided where the page is written; here it is only
   played. */

/* The clock of a build by an arm, for the timeline. */
function armClock(data) {
  const { segments, duration, robots } = data.arm;
  const minutes = (t) => `${Math.floor(t / 60)}:${String(Math.floor(t % 60)).padStart(2, "0")}`;
  const index = (t) => {
    const found = segments.findIndex((segment) => t <= segment.end + 1e-6);
    return found < 0 ? segments.length - 1 : found;
  };
  // The segments at a time, the one that ends next first.
  const active = (t) => {
    const first = index(t);
    return [first, ...segments.map((_, k) => k).filter((k) => k > first && segments[k].start < t)];
  };
  const does = (segment, t) => {
    const stage = segment.stages.find(([from, to]) => t >= from - 1e-6 && t <= to + 1e-6);
    return stage ? stage[2] : segment.moves ? "stands still" : segment.still;
  };
  const words = (t) => {
    const now = active(t).map((k) => segments[k]);
    if (robots.length === 1) return `The arm ${does(now[0], t)}.`;
    const own = robots.map((robot, n) => now.find((segment) => segment.robot === n && segment.start < t));
    return `${robots.map(({ name }, n) => `${name} ${own[n] ? does(own[n], t) : "waits"}`).join("; ")}.`;
  };
  // Steps of the plan that are done before each segment.
  let done = 0;
  const before = segments.map((segment) => {
    const now = done;
    if (segment.reached && segment.step !== null) done = segment.step;
    return now;
  });
  return {
    last: duration,
    speed: 1,
    marks: [0, ...segments.map((segment) => segment.end)],
    exact: true,
    index,
    active,
    timeOf(step) {
      if (step <= 0) return 0;
      const found = segments.find((segment) => segment.reached && segment.step === step);
      return found ? found.end : duration;
    },
    at(t) {
      const k = index(t), segment = segments[k];
      const count = `${minutes(t)} / ${minutes(duration)}`;
      if (t <= 0) {
        return { step: 0, current: -1, segment: -1, count, caption: data.arm.start,
          doing: robots.length > 1 ? "The arms wait." : "The arm waits.", outcome: "start", good: true, text: `${minutes(0)}, start` };
      }
      const counts = segment.reached && segment.step !== null;
      const doing = t >= duration ? "The build is over." : words(t);
      return {
        step: counts ? segment.step : before[k], current: counts ? segment.step : -1, segment: k,
        count, caption: segment.caption, doing, good: segment.reached,
        outcome: `attempt ${k + 1} of ${segments.length}: ${segment.outcome}`,
        text: `${minutes(t)}, attempt ${k + 1} of ${segments.length}: ${doing}`,
      };
    },
  };
}

/* The arms and the blocks as one actor of the stage. */
function createArm(data, tools) {
  const { coloured, colours } = tools;
  const arm = data.arm, group = new THREE.Group();
  const clock = armClock(data);
  const robots = arm.robots.map((robot) => makeRobot(robot, group));
  const cells = arm.cells.map(makeCell);
  const owner = new Map(); // cell -> the segment that puts it into the structure
  arm.segments.forEach((segment, k) => {
    if (segment.reached) for (const cell of segment.cells) owner.set(cell, k);
  });
  // Where everything is before each segment.
  const states = [];
  let poses = arm.cells.map(({ position, quaternion }) => [new THREE.Vector3(...position), turned(quaternion)]);
  const put = (changes) => {
    poses = poses.slice();
    for (const [cell, [position, quaternion]] of Object.entries(changes)) {
      poses[cell] = [new THREE.Vector3(...position), turned(quaternion)];
    }
  };
  for (const segment of arm.segments) {
    put(segment.before); // Magazines present and take back between two segments.
    states.push(poses);
    put(segment.after);
  }
  const outlines = new Map();
  const ghostLine = coloured(new THREE.LineBasicMaterial({ transparent: true, opacity: 0.9 }), "current");
  const ghosts = robots.map(() => {
    const ghost = new THREE.LineSegments(new THREE.EdgesGeometry(cells[0].sides), ghostLine);
    group.add(ghost);
    return ghost;
  });
  // Where blocks really are, as far off as can be seen; of each cell that was told of.
  const truthLine = coloured(new THREE.LineBasicMaterial(), "bad"), truths = new Map();
  const toolPlace = new THREE.Vector3(), toolTurn = new THREE.Quaternion();

  return { group, update };

  function update(now) {
    const active = clock.active(now), k = active[0], segment = arm.segments[k];
    const time = segment.moves ? now - segment.delay : segment.start - segment.delay;
    for (const robot of robots) poseRobot(robot, time * arm.rate);
    const moved = new Set(active.flatMap((n) => arm.segments[n].cells));
    cells.forEach(({ group: cube, material }, cell) => {
      const [position, quaternion] = states[k][cell];
      cube.position.copy(position);
      cube.quaternion.copy(quaternion);
      const name = colourOf(cell, k, moved, now);
      material.color.set(colours()[name] ?? name);
    });
    for (const n of active) {
      const one = arm.segments[n];
      for (const cell of n === k ? [] : one.cells) {
        const [position, quaternion] = states[n][cell];
        cells[cell].group.position.copy(position);
        cells[cell].group.quaternion.copy(quaternion);
      }
      for (const glide of one.glides) follow(glide, one, now, cells[glide.cell].group);
    }
    // What waits in a magazine is below the table.
    for (const { group: cube } of cells) cube.visible = cube.position.z > 0;
    for (const ghost of ghosts) ghost.visible = false;
    for (const n of active) showGoal(arm.segments[n], now);
    const moving = now > segment.start && now < segment.end;
    showTruth(moving ? k - 1 : now > 0 ? k : -1, moving ? [...moved] : []);
  }

  /* Where a segment puts its block, until it is let go there. */
  function showGoal(segment, now) {
    const ghost = ghosts[segment.robot], held = segment.glides.find((glide) => glide.grip !== null);
    if (ghost.visible || (robots.length > 1 && now < segment.start)) return;
    ghost.visible = now > 0 && now < arm.duration && !(held && now > held.release);
    const [x, y, z, ...quaternion] = segment.target;
    ghost.position.set(x, y, z);
    ghost.quaternion.copy(turned(quaternion));
    ghost.geometry = outline(segment.cells[0]);
  }

  function showTruth(k, except) {
    for (const line of truths.values()) line.visible = false;
    for (const [cell, position, quaternion] of arm.truth?.after[k] ?? []) {
      if (except.includes(cell)) continue;
      if (!truths.has(cell)) {
        truths.set(cell, new THREE.LineSegments(outline(cell), truthLine));
        group.add(truths.get(cell));
      }
      const line = truths.get(cell);
      line.visible = true;
      line.position.set(...position);
      line.quaternion.copy(turned(quaternion));
    }
  }

  /* A cell that moves in this segment: held, or gliding to where it comes to rest. */
  function follow(glide, segment, now, cube) {
    if (glide.grip !== null && now < glide.release) {
      if (now < glide.grip) return;
      const { tool } = robots[segment.robot];
      tool.updateWorldMatrix(true, false);
      tool.getWorldPosition(toolPlace);
      tool.getWorldQuaternion(toolTurn);
      cube.position.set(...glide.offset).applyQuaternion(toolTurn).add(toolPlace);
      cube.quaternion.copy(toolTurn).multiply(turned(glide.turn));
      return;
    }
    const share = Math.min(Math.max((now - glide.release) / Math.max(glide.end - glide.release, 1e-9), 0), 1);
    const eased = glide.falls ? share * share : share * share * (3 - 2 * share);
    const [position, quaternion] = segment.after[glide.cell];
    cube.position.set(...glide.position).lerp(new THREE.Vector3(...position), eased);
    cube.quaternion.copy(turned(glide.quaternion)).slerp(turned(quaternion), eased);
  }

  function colourOf(cell, k, moved, now) {
    const { fixed, kind } = arm.cells[cell];
    if (fixed) return kind;
    if (moved.has(cell) && now > 0) return "current";
    // A prop stands without a last place of its own: it has its colour all the time.
    return kind === "prop" || owner.has(cell) && owner.get(cell) < k ? kind : "waiting";
  }

  function outline(cell) {
    if (!outlines.has(cell)) {
      outlines.set(cell, new THREE.EdgesGeometry(cells[cell].sides));
    }
    return outlines.get(cell);
  }

  function makeCell({ half, corners }) {
    const cube = tools.cube(half, corners);
    group.add(cube.group);
    return cube;
  }
}

/* Arms that stand at home, and what each reaches on the table. */
function createStanding({ robots, areas }, floor, coloured) {
  const group = new THREE.Group();
  for (const robot of robots) poseRobot(makeRobot(robot, group), 0);
  for (const area of areas) {
    const [outer, ...inner] = area.map((line) => {
      const shape = new THREE.Shape();
      line.forEach(([x, y], k) => (k ? shape.lineTo(x, y) : shape.moveTo(x, y)));
      return shape;
    });
    outer.holes = inner;
    const ends = area.flatMap((line) => line.flatMap((at, k) => [...at, 0, ...line[(k + 1) % line.length], 0]));
    const rim = new THREE.BufferGeometry();
    rim.setAttribute("position", new THREE.Float32BufferAttribute(ends, 3));
    const film = new THREE.Mesh(new THREE.ShapeGeometry(outer), coloured(
      new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.16, depthWrite: false }), "accent"));
    for (const made of [film, new THREE.LineSegments(rim, coloured(new THREE.LineBasicMaterial(), "accent"))]) {
      made.position.z = floor + 0.001;
      group.add(made);
    }
  }
  return group;
}

function turned([w, x, y, z]) { return new THREE.Quaternion(x, y, z, w); }

/* An arm: every joint of its chain turns about the z axis of its own frame. */
function makeRobot(robot, group) {
  const placed = (parent, { offset, turn }) => {
    const node = new THREE.Group();
    node.position.set(...offset);
    node.quaternion.copy(turned(turn));
    parent.add(node);
    return node;
  };
  const joints = [];
  let end = group;
  for (const joint of robot.joints) {
    const turning = new THREE.Group();
    placed(end, joint).add(turning);
    joints.push(turning);
    end = turning;
  }
  const tool = placed(end, robot.tool);
  const fingers = robot.fingers.map((finger) => placed(end, finger));
  const frames = [...joints, ...fingers];
  for (const part of robot.parts) (part.frame < 0 ? group : frames[part.frame]).add(linkMesh(part));
  const samples = unpack(robot.samples), wide = joints.length + 1;
  return { joints, tool, fingers, travels: robot.fingers, samples, wide, count: samples.length / wide };
}

/* An arm as it is at a sample, or between two. */
function poseRobot({ joints, fingers, travels, samples, wide, count }, sample) {
  const at = Math.min(Math.max(sample, 0), count - 1);
  const low = Math.min(Math.floor(at), Math.max(count - 2, 0)), share = at - low;
  const high = Math.min(low + 1, count - 1);
  const value = (j) => samples[low * wide + j] + share * (samples[high * wide + j] - samples[low * wide + j]);
  joints.forEach((joint, j) => { joint.rotation.z = value(j); });
  const width = value(wide - 1);
  fingers.forEach((finger, j) => {
    const { offset, travel } = travels[j];
    finger.position.set(...offset.map((v, axis) => v + width * travel[axis]));
  });
}

function linkMesh(part) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(unpack(part.vertices), 3));
  geometry.setAttribute("normal", new THREE.Float32BufferAttribute(unpack(part.normals), 3));
  const raw = bytes(part.faces).buffer;
  geometry.setIndex([...(part.wide ? new Uint32Array(raw) : new Uint16Array(raw))]);
  const [red, green, blue] = part.colour;
  const material = new THREE.MeshStandardMaterial({ roughness: 0.55, metalness: 0.05 });
  material.color.setRGB(red, green, blue, THREE.SRGBColorSpace);
  const made = new THREE.Mesh(geometry, material);
  made.castShadow = made.receiveShadow = true;
  return made;
}
