// What stands still in the scene: floor with metres, room, obstacles, and the mission's waypoints.
import { THREE } from "nicegui-scene";
import { FONT, colours, niceStep, place3, ticks } from "./draw.js";

const { Group, Mesh } = THREE;
const FULL_M = 3.2, seen = new THREE.Vector3(); // farther away marks shrink as all does
const MOST_MARKS = 120; // of a longer mission those about the one that is flown to
const LIFT = 0.42; // marks of waypoints stand above them, so that they do not hide who flies there

export function sprite(text, { colour, size = 0.22, back = "", bold = false }) {
  const pixels = 56, canvas = document.createElement("canvas"), ctx = canvas.getContext("2d");
  ctx.font = `${bold ? "700" : "500"} ${pixels}px ${FONT}`;
  const wide = Math.ceil(ctx.measureText(text).width) + 28;
  canvas.width = back ? Math.max(wide, pixels + 28) : wide;
  canvas.height = pixels + 28;
  ctx.font = `${bold ? "700" : "500"} ${pixels}px ${FONT}`;
  if (back) {
    ctx.fillStyle = back;
    ctx.beginPath();
    ctx.roundRect(2, 2, canvas.width - 4, canvas.height - 4, 40);
    ctx.fill();
  }
  ctx.fillStyle = colour;
  ctx.textAlign = "center";
  ctx.textBaseline = "middle";
  ctx.fillText(text, canvas.width / 2, canvas.height / 2 + 4);
  const texture = new THREE.CanvasTexture(canvas);
  texture.colorSpace = THREE.SRGBColorSpace;
  const node = new THREE.Sprite(new THREE.SpriteMaterial({ map: texture, depthTest: !back, depthWrite: false }));
  const across = (size * canvas.width) / canvas.height;
  node.scale.set(across, size, 1);
  // Near the camera it grows no more: it would hide what it names.
  node.onBeforeRender = (renderer, scene, camera) => {
    const share = Math.min(1, seen.setFromMatrixPosition(node.matrixWorld).distanceTo(camera.position) / FULL_M);
    node.scale.set(across * share, size * share, 1);
    node.updateMatrixWorld();
  };
  return node;
}

export function lines(points, colour, { dashed = false, opacity = 1, pairs = false } = {}) {
  const geometry = new THREE.BufferGeometry().setFromPoints(points.map(([n, e, d]) => new THREE.Vector3(e, -d, -n)));
  const options = { color: colour, transparent: opacity < 1, opacity };
  const material = dashed
    ? new THREE.LineDashedMaterial({ ...options, dashSize: 0.12, gapSize: 0.08 })
    : new THREE.LineBasicMaterial(options);
  const node = pairs ? new THREE.LineSegments(geometry, material) : new THREE.Line(geometry, material);
  if (dashed) node.computeLineDistances();
  return node;
}

export function dispose(group) {
  group.traverse((o) => {
    o.geometry?.dispose();
    if (o.material) {
      o.material.map?.dispose();
      o.material.dispose();
    }
  });
  group.removeFromParent();
}

export function floor(world, reach) {
  const group = new Group(), room = world.room;
  const n = room ? room.n : [-reach, reach], e = room ? room.e : [-reach, reach];
  const fine = [], axes = [];
  const wide = Math.max(n[1] - n[0], e[1] - e[0]), step = wide > 200 ? niceStep(wide, 40) : wide > 40 ? 5 : 1;
  for (const [, k] of ticks(n[0], n[1], step)) fine.push([k, e[0], 0], [k, e[1], 0]);
  for (const [, k] of ticks(e[0], e[1], step)) fine.push([n[0], k, 0], [n[1], k, 0]);
  const ground = new Mesh(
    new THREE.PlaneGeometry(e[1] - e[0], n[1] - n[0]),
    new THREE.MeshBasicMaterial({ color: colours.panel, polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 2 }),
  );
  ground.rotation.x = -Math.PI / 2;
  ground.position.set((e[0] + e[1]) / 2, -0.001, -(n[0] + n[1]) / 2);
  group.add(ground, lines(fine, colours.grid, { pairs: true }));
  axes.push([0, 0, 0], [Math.min(1, n[1]), 0, 0]);
  group.add(lines(axes, colours.text, { pairs: true }));
  label(group, "N", Math.min(1, n[1]) + 0.12, 0);
  const from = (side) => ticks(0, side[1] - Math.ceil(side[0]), 2 * step).map(([, k]) => Math.ceil(side[0]) + k);
  for (const k of from(n)) label(group, `${k}`, k, e[0] - 0.22);
  for (const k of from(e)) label(group, `${k}`, n[0] - 0.22, k);
  label(group, "N (m)", n[1] - 0.5, e[0] - 0.5, 0.24);
  label(group, "E (m)", n[0] - 0.45, e[1] - 0.5, 0.24);
  if (room) walls(group, room);
  return group;
}

function label(group, text, n, e, size = 0.2) {
  const s = sprite(text.replace("-", "−"), { colour: colours.dim, size });
  s.position.set(e, 0.05, -n);
  group.add(s);
}

function walls(group, room) {
  const h = room.h ?? 2.5, [n0, n1] = room.n, [e0, e1] = room.e, at = [];
  const corners = [[n0, e0], [n0, e1], [n1, e1], [n1, e0]];
  corners.forEach(([n, e], k) => {
    const [nn, ee] = corners[(k + 1) % 4];
    at.push([n, e, 0], [nn, ee, 0], [n, e, 0], [n, e, -h]);
    if (room.h) at.push([n, e, -h], [nn, ee, -h]);
  });
  group.add(lines(at, colours.dim, { pairs: true, opacity: 0.55 }));
  const material = new THREE.MeshBasicMaterial({ color: colours.dim, transparent: true, opacity: 0.07, side: THREE.BackSide, depthWrite: false });
  const box = new Mesh(new THREE.BoxGeometry(e1 - e0, h, n1 - n0), material);
  box.position.set((e0 + e1) / 2, h / 2, -(n0 + n1) / 2);
  group.add(box);
}

export function obstacles(world) {
  const group = new Group();
  const solid = () => new THREE.MeshStandardMaterial({ color: colours.c1, roughness: 0.85, transparent: true, opacity: 0.82 });
  const add = (geometry, place, name, top) => {
    const mesh = new Mesh(geometry, solid());
    const edges = new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 30), new THREE.LineBasicMaterial({ color: colours.text, transparent: true, opacity: 0.5 }));
    place(mesh);
    place(edges);
    const s = sprite(name, { colour: colours.text, size: 0.13 });
    s.position.set(mesh.position.x, top + 0.11, mesh.position.z);
    group.add(mesh, edges, s);
  };
  for (const b of world.boxes) {
    // Edges x, y, z of the box are north, east, down before it is turned.
    add(new THREE.BoxGeometry(b.s[1], b.s[2], b.s[0]), (o) => {
      o.position.set(b.c[1], -b.c[2], -b.c[0]);
      o.rotation.y = -b.yaw;
    }, b.name, -b.c[2] + b.s[2] / 2);
  }
  for (const c of world.cylinders) {
    add(new THREE.CylinderGeometry(c.r, c.r, c.h, 40), (o) => o.position.set(c.c[1], c.foot + c.h / 2, -c.c[0]), c.name, c.foot + c.h);
  }
  return group;
}

export function waypoints(rows, current) {
  const group = new Group(), points = [];
  const first = Math.max(0, Math.min((current ?? 0) - MOST_MARKS / 2, rows.length - MOST_MARKS));
  rows.slice(first, first + MOST_MARKS).forEach((row, j) => {
    const k = first + j;
    if (row.action === "land" || !place3(row.p).every(Number.isFinite)) return;
    const same = points.filter((p) => Math.hypot(p[0] - row.p[0], p[1] - row.p[1], p[2] - row.p[2]) < 0.15).length;
    points.push(row.p);
    const now = k === current, back = now ? colours.reference : row.reached ? colours.good : colours.panel;
    const text = row.action === "take off" ? "T" : `${rows.slice(0, k + 1).filter((r) => r.action === "waypoint").length || k + 1}`;
    const s = sprite(row.reached && !now ? `${text} ✓` : text, { colour: now || row.reached ? "#fff" : colours.text, back, size: 0.17, bold: true });
    s.position.set(row.p[1], -row.p[2] + LIFT + 0.2 * same, -row.p[0]); // one above the other
    s.renderOrder = 5;
    group.add(s, lines([[row.p[0], row.p[1], row.p[2] - LIFT + 0.08], [row.p[0], row.p[1], 0]], colours.dim, { opacity: 0.5 }));
  });
  if (points.length > 1) group.add(lines(points, colours.dim, { dashed: true, opacity: 0.8 }));
  return group;
}
