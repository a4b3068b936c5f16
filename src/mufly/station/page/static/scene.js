// The 3-D scene: vehicles in their world, trail, reference, range beams; a click on the floor makes a waypoint.
//
// It is drawn when something has changed, at most once a picture of the screen: twenty times a second in flight.
import { THREE, OrbitControls } from "nicegui-scene";
import { live } from "./live.js";
import { clamped, colours, drawn, el, number, onTheme, place3, software } from "./draw.js";
import { layer } from "./scene_draft.js";
import { fence } from "./scene_fence.js";
import { place, turn } from "./scene_helicopter.js";
import { vehicle } from "./scene_shapes.js";
import { dispose, floor, lines, obstacles, sprite, waypoints } from "./scene_world.js";

const TRAIL = 8000, ENLARGED = 2.5, FARTHEST = 200, MARKS_MS = 250, FASTEST = 1e4; // m; between two drawings of marks; rad/s

export function mount(element, options, emit) {
  element.classList.add("mf-scene");
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ antialias: !software, powerPreference: "low-power" });
  } catch (error) {
    element.append(el("p", { class: "mf-empty", text: "The 3-D view needs WebGL, which this browser does not support." }));
    return {};
  }
  renderer.domElement.setAttribute("role", "img");
  renderer.domElement.setAttribute("aria-label", "3-D view of the vehicle in its world; click the floor to set a destination");
  renderer.domElement.tabIndex = 0;
  element.append(renderer.domElement);
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(42, 1, 0.02, 2000);
  camera.position.set(2.1, 2.2, 3.5);
  const controls = new OrbitControls(camera, renderer.domElement);
  controls.maxPolarAngle = Math.PI / 2 - 0.02;
  controls.minDistance = 0.25;
  controls.maxDistance = 200;
  controls.target.set(0, 0.5, 0);
  scene.add(new THREE.HemisphereLight(0xffffff, 0x778088, 2.1));
  const sun = new THREE.DirectionalLight(0xffffff, 1.6);
  sun.position.set(3, 8, 4);
  scene.add(sun);

  let shape = "coaxial", radius = 0.0875, enlarged = true, follow = true, tint = 0; // a vehicle keeps its colour when another is selected
  let scenery = { boxes: [], cylinders: [], room: null }, rows = [], current = null, placed = [];
  let ship, ghost, still = new THREE.Group(), marks = new THREE.Group(), second = new THREE.Group();
  const others = new Map();
  const beams = lines(Array(64).fill([0, 0, 0]), "#fff", { pairs: true, opacity: 0.8 });
  const drop = lines([[0, 0, 0], [0, 0, 0]], "#fff", { opacity: 0.5 });
  const tie = lines([[0, 0, 0], [0, 0, 0]], "#fff", { opacity: 0.8 });
  const shadow = new THREE.Mesh(new THREE.CircleGeometry(1, 32), new THREE.MeshBasicMaterial({ color: 0x000000, transparent: true, opacity: 0.3, depthWrite: false }));
  shadow.rotation.x = -Math.PI / 2;
  const trailAt = new Float32Array(3 * TRAIL);
  const trail = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: "#fff" }));
  trail.geometry.setAttribute("position", new THREE.BufferAttribute(trailAt, 3));
  for (const o of [trail, beams, drop, tie]) o.frustumCulled = false;
  let trailN = 0;
  scene.add(trail, beams, drop, tie, shadow, still, marks);
  beams.geometry.setDrawRange(0, 0);

  let asked = null, plan = null, planned = null; // what draws a mission, and the world that it is drawn in
  const paint = () => {
    if (asked === null) asked = requestAnimationFrame(() => {
      asked = null;
      renderer.render(scene, camera);
      moveChip();
      plan?.place();
    });
  };
  controls.addEventListener("change", paint);

  function build() {
    scene.background = new THREE.Color(colours.bg);
    trail.material.color.set(colours[`c${tint % 8}`]);
    beams.material.color.set(colours.c1);
    drop.material.color.set(colours.dim);
    tie.material.color.set(colours.reference);
    dispose(still);
    still = new THREE.Group();
    still.add(floor(planned ?? scenery, reach()), obstacles(planned ?? scenery), fence(planned ?? scenery));
    scene.add(still);
    ship?.dispose();
    ghost?.dispose();
    ship = vehicle(shape, size(), colours[`c${tint % 8}`]);
    ghost = vehicle(shape, size(), colours.reference, { ghost: true });
    scene.add(ship.group, ghost.group);
    ghost.group.visible = ship.group.visible = shadow.visible = false; // until it is known where they are
    for (const o of others.values()) dispose(o.label), o.model.dispose();
    others.clear();
    mission();
    drawTarget();
    if (live.latest) show(live.latest, 0);
    paint();
  }
  const size = () => radius * (enlarged ? ENLARGED : 1);
  const reach = () => clamped(Math.max(4, ...rows.flatMap((r) => place3(r.p).slice(0, 2).map((x) => (Number.isFinite(x) ? Math.ceil(Math.abs(x) + 1) : 0)))), 4, FARTHEST);

  function mission() {
    dispose(marks);
    marks = waypoints(rows, current);
    marks.visible = planned === null;
    scene.add(marks);
  }

  function extend(...at) {
    const [n, e, d] = place3(at);
    if (!Number.isFinite(n + e + d)) return;
    const k = 3 * trailN;
    if (trailN && Math.hypot(trailAt[k - 3] - e, trailAt[k - 2] + d, trailAt[k - 1] + n) < 0.01) return;
    if (trailN === TRAIL) {
      trailAt.copyWithin(0, (3 * TRAIL) / 2);
      trailN = TRAIL / 2;
    }
    trailAt.set([e, -d, -n], 3 * trailN++);
    trail.geometry.setDrawRange(0, trailN);
    trail.geometry.attributes.position.needsUpdate = true;
  }

  let lastShown = performance.now(), marked = 0, bare = true;
  function show(f, seconds) {
    const s = f.s, [n, e, d] = place3(s.position), known = Number.isFinite(n + e + d);
    ship.group.visible = shadow.visible = drop.visible = known;
    if (known) {
      const lift = enlarged ? 0.8 * (size() - radius) : 0; // enlarged, it would stand in the floor
      place(ship.group, n, e, d - lift);
      turn(ship.group, ...angles(s.attitude));
      ship.spin(speed(s.rotor_speed, 0), speed(s.rotor_speed, 1), seconds, s.armed);
      ship.group.updateMatrixWorld();
      extend(n, e, d);
      shadow.position.set(e, 0.004, -n);
      shadow.scale.setScalar(size() * 0.9);
      shadow.material.opacity = 0.3 / (1 + Math.max(0, -d));
      segment(drop, n, e, d, n, e, 0);
      rangeBeams(s);
      if (follow && !plan?.on) {
        const to = new THREE.Vector3(e, Math.max(0.15, -d), -n);
        const move = to.sub(controls.target).multiplyScalar(bare ? 1 : 0.15);
        controls.target.add(move);
        camera.position.add(move);
        controls.update();
      }
      bare = false;
    } else beams.geometry.setDrawRange(0, 0);
    const [rn, re, rd] = place3(s.reference_position);
    const away = known && Math.hypot(rn - n, re - e, rd - d) > 0.02;
    ghost.group.visible = tie.visible = Boolean(away && s.armed);
    if (away) {
      place(ghost.group, rn, re, rd - (enlarged ? 0.8 * (size() - radius) : 0));
      const [roll, pitch] = angles(s.reference_attitude), yaw = drawn(s.reference_attitude[2]);
      turn(ghost.group, roll, pitch, Number.isFinite(yaw) ? yaw : angles(s.attitude)[2]);
      segment(tie, n, e, d, rn, re, rd);
    }
    paint();
  }

  const angles = (a) => place3(a).map((x) => x || 0);
  const speed = (w, k) => clamped(w?.[k], 0, FASTEST);
  function segment(line, n0, e0, d0, n1, e1, d1) {
    line.geometry.attributes.position.array.set([e0, -d0, -n0, e1, -d1, -n1]);
    line.geometry.attributes.position.needsUpdate = true;
  }

  const tip = new THREE.Vector3();
  function rangeBeams(s) {
    const at = beams.geometry.attributes.position.array, [n, e, d] = place3(s.position);
    let k = 0;
    s.ranges.forEach((length, b) => {
      const r = drawn(length), a = drawn(s.range_angles[b]);
      if (!Number.isFinite(r + a) || k + 6 > at.length || r >= s.range_max_m * 0.999) return;
      tip.set(Math.sin(a), 0, -Math.cos(a)).applyQuaternion(ship.group.quaternion).multiplyScalar(r);
      at.set([e, -d, -n, e + tip.x, -d + tip.y, -n + tip.z], k);
      k += 6;
    });
    beams.geometry.setDrawRange(0, k / 3);
    beams.geometry.attributes.position.needsUpdate = true;
  }

  function fleet(list, seconds) {
    const seen = new Set();
    for (const o of list) {
      if (!place3(o.p).every(Number.isFinite)) continue;
      seen.add(o.name);
      let known = others.get(o.name);
      if (known && known.shape !== o.shape) {
        known.model.dispose();
        dispose(known.label);
        known = undefined;
      }
      if (!known) {
        const tint = colours[`c${o.color % 8}`];
        known = { shape: o.shape, model: vehicle(o.shape, size(), tint), label: sprite(o.name, { colour: "#fff", back: tint, size: 0.16 }) };
        scene.add(known.model.group, known.label);
        others.set(o.name, known);
      }
      place(known.model.group, ...o.p);
      turn(known.model.group, ...angles(o.a));
      known.model.spin(speed(o.w, 0), speed(o.w, 1), seconds, o.armed);
      known.label.position.set(o.p[1], -o.p[2] + 0.35, -o.p[0]);
    }
    for (const [name, o] of others) {
      if (seen.has(name)) continue;
      o.model.dispose();
      dispose(o.label);
      others.delete(name);
    }
  }

  const panel = live.panel({ sections: ["scene", "mission"] }, (f) => {
    if (f.repeated && f.mission) rows = f.mission;
    const now = performance.now(), seconds = Math.min(0.2, (now - lastShown) / 1000);
    lastShown = now;
    if (f.new) bare = true;
    const colour = f.about?.color ?? 0;
    if (colour !== tint) {
      tint = colour;
      build();
    }
    if (f.scenery) {
      scenery = f.scenery.world;
      radius = clamped(f.scenery.rotor_radius || radius, 0.01, 10);
      shape = f.scenery.shape || "coaxial";
      build();
    }
    if (f.trail) {
      trailN = 0;
      trail.geometry.setDrawRange(0, 0);
      f.trail.forEach((p) => extend(...p.map((x) => (x === null ? NaN : x))));
    }
    if (f.compared_trail) {
      dispose(second);
      second = new THREE.Group();
      const known = f.compared_trail.filter((p) => p.every((x) => x !== null));
      if (known.length > 1) second.add(lines(known, colours.c1, { dashed: true }));
      scene.add(second);
    }
    if (f.mission) {
      rows = f.mission;
      current = f.s?.waypoint ?? null;
      build();
    } else if (f.s && f.s.waypoint !== current && now - marked > MARKS_MS) {
      [current, marked] = [f.s.waypoint, now];
      mission();
    }
    if (f.others) fleet(f.others, seconds);
    if (f.s) show(f, seconds);
  });

  // ---- choosing a waypoint
  const marker = new THREE.Group(), target = new THREE.Group();
  marker.visible = false;
  scene.add(marker, target);
  let sent = null; // north, east, height of the place that it was sent to
  let chosen = null, height = 1.0;
  const where = el("span", { class: "mf-num" });
  const high = el("input", { type: "number", step: "0.1", min: "0.2", max: "100", "aria-label": "height (m)", value: "1.0" });
  const send = el("button", { class: "mf-chip-send", text: "Send", type: "button", onclick: () => go() });
  const drop_it = el("button", { text: "✕", type: "button", "aria-label": "discard the destination", onclick: () => forget() });
  const chip = el("div", { class: "mf-chip", hidden: true, "data-testid": "goto-chip" }, where, el("label", {}, "height ", high, " m"), send, drop_it);
  element.append(chip);
  high.addEventListener("input", () => {
    const h = parseFloat(high.value);
    if (Number.isFinite(h) && h > 0) (height = h), drawMarker(), paint();
  });
  high.addEventListener("keydown", (event) => {
    if (event.key === "Enter") go();
    if (event.key === "Escape") forget();
  });

  function post(group, n, e, h) {
    for (const c of [...group.children]) dispose(c);
    group.add(lines([[n, e, 0], [n, e, -h]], colours.reference));
    const ball = new THREE.Mesh(new THREE.SphereGeometry(0.05, 16, 12), new THREE.MeshBasicMaterial({ color: colours.reference }));
    place(ball, n, e, -h);
    const ring = new THREE.Mesh(new THREE.RingGeometry(0.09, 0.12, 32), new THREE.MeshBasicMaterial({ color: colours.reference, side: THREE.DoubleSide }));
    ring.rotation.x = -Math.PI / 2;
    ring.position.set(e, 0.006, -n);
    group.add(ball, ring);
  }
  function drawMarker() {
    if (!chosen) return;
    post(marker, ...chosen, height);
    where.textContent = `N ${number(chosen[0])}  E ${number(chosen[1])} m`;
  }
  function drawTarget() {
    target.visible = sent !== null;
    if (!sent) return;
    post(target, ...sent);
    const words = sprite(`destination, ${number(sent[2])} m`, { colour: "#fff", back: colours.reference, size: 0.14 });
    words.position.set(sent[1], sent[2] + 0.2, -sent[0]);
    target.add(words);
  }
  function choose(n, e) {
    chosen = [Math.round(n * 100) / 100, Math.round(e * 100) / 100];
    marker.visible = true;
    chip.hidden = false;
    drawMarker();
    paint();
    emit("place", { north: chosen[0], east: chosen[1], height });
  }
  function forget() {
    chosen = null;
    marker.visible = false;
    chip.hidden = true;
    drawMarker();
    paint();
  }
  function go() {
    if (!chosen) return;
    emit("goto", { north: chosen[0], east: chosen[1], height });
    forget();
  }
  const projected = new THREE.Vector3();
  function onScreen(n, e, d) {
    projected.set(e, -d, -n).project(camera);
    return [((projected.x + 1) / 2) * element.clientWidth, ((1 - projected.y) / 2) * element.clientHeight];
  }
  function moveChip() {
    if (!chosen) return;
    const [x, y] = onScreen(chosen[0], chosen[1], 0);
    const w = chip.offsetWidth, h = chip.offsetHeight;
    chip.style.left = `${Math.max(4, Math.min(element.clientWidth - w - 4, x - w / 2))}px`;
    chip.style.top = `${Math.max(4, Math.min(element.clientHeight - h - 4, y + 16))}px`;
  }
  let down = null;
  const ray = new THREE.Raycaster(), ground = new THREE.Plane(new THREE.Vector3(0, 1, 0), 0), hit = new THREE.Vector3();
  renderer.domElement.addEventListener("pointerdown", (event) => (down = [event.clientX, event.clientY]));
  renderer.domElement.addEventListener("pointerup", (event) => {
    if (!down || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 5 || options.watch) return;
    const box = element.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
    if (chosen) {
      const [mx, my] = onScreen(chosen[0], chosen[1], 0);
      if (Math.hypot(mx - x, my - y) < 16) return go();
    }
    ray.setFromCamera(new THREE.Vector2((2 * x) / box.width - 1, 1 - (2 * y) / box.height), camera);
    if (!ray.ray.intersectPlane(ground, hit) || hit.length() > 1000) return;
    if (plan.on) plan.click(-hit.z, hit.x);
    else choose(-hit.z, hit.x);
  });

  // ---- the camera
  const button = (text, title, press) => el("button", { type: "button", text, title, "aria-label": title, onclick: press });
  const following = button("Follow", "camera follows the vehicle", () => {
    follow = !follow;
    following.setAttribute("aria-pressed", follow);
  });
  following.setAttribute("aria-pressed", true);
  const sizing = button("Size ×2.5", "draw the vehicle enlarged or in true size", () => {
    enlarged = !enlarged;
    sizing.textContent = enlarged ? "Size ×2.5" : "True size";
    build();
  });
  const view = (dx, dy, dz) => () => {
    const [n, e, d] = place3(live.latest?.s.position).map((x) => x || 0);
    controls.target.set(e, -d, -n);
    camera.position.set(e + dx, -d + dy, -n + dz);
    controls.update();
    paint();
  };
  element.append(el("div", { class: "mf-scene-tools", role: "group", "aria-label": "camera" },
    following, button("3-D", "view from behind and above", view(2.1, 1.7, 3.5)), button("Top", "view from above, north up", view(0, 7, 0.01)),
    button("Side", "view from the south", view(0, 0.3, 4.5)), sizing));

  const sizes = new ResizeObserver(() => {
    const { clientWidth: w, clientHeight: h } = element;
    if (!w || !h) return;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    renderer.setSize(w, h);
    camera.aspect = w / h;
    camera.updateProjectionMatrix();
    paint();
  });
  sizes.observe(element);
  const off = onTheme(build);
  build();
  plan = layer({ element, scene, camera, controls, paint, world: (drawn) => ((planned = drawn), drawn && forget(), build()) });
  window.muflyScene = { onFloor: (n, e) => onScreen(n, e, 0), camera, controls, trail: () => trailN, sent: () => sent }; // for the tests of the page

  return {
    choose,
    setTarget(place) {
      sent = place;
      drawTarget();
      paint();
    },
    setHeight(h) {
      height = h;
      high.value = h.toFixed(1);
      drawMarker();
      paint();
    },
    close() {
      panel.close();
      plan.close();
      sizes.disconnect();
      off();
      controls.dispose();
      renderer.dispose();
    },
  };
}
