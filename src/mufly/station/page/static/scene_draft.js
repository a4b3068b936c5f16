// Drawing a mission in the 3-D view: points to drag, their heights, and points between, over the lines of the way.
//
// Marks are elements of the page above the picture: they keep their size, take fingers and keys, and hide from nobody.
import { THREE } from "nicegui-scene";
import { draft } from "./draft.js";
import { colours, el, number } from "./draw.js";
import { dispose, lines } from "./scene_world.js";

const SNAP_M = 0.05, SAY_MS = 80, FAR_M = 200, LEAST_PX = 56;

// stage: { element, scene, camera, paint, world(w) }: `world` is told whose walls and boxes to draw, null for the vehicle's.
export function layer({ element, scene, camera, controls, paint, world }) {
  const holder = el("div", { class: "mf-draft", hidden: true, "aria-label": "mission in the editor", role: "group" });
  const hint = el("div", { class: "mf-draft-hint" });
  holder.append(hint);
  element.append(holder);
  let drawn = new THREE.Group(), marks = [], dragged = null, shape = "", gesture = 0, ground = "", framed = false;
  scene.add(drawn);
  const at = new THREE.Vector3(), ray = new THREE.Raycaster(), plane = new THREE.Plane(), hit = new THREE.Vector3();
  const point = (row) => (dragged?.row === row ? dragged.at : row ? draft.state.rows[row - 1].at : draft.state.start);
  const snap = (x) => Math.round(Math.round(x / SNAP_M) * SNAP_M * 1000) / 1000;

  function onScreen([n, e, h]) {
    at.set(e, h, -n).project(camera);
    return at.z < 1 ? [((at.x + 1) / 2) * element.clientWidth, ((1 - at.y) / 2) * element.clientHeight] : null;
  }

  // ---- marks
  function mark(row) {
    const node = el("button", { type: "button", class: "mf-point", text: row ? String(row) : "T", "data-testid": `point-${row}`, onclick: () => draft.select(row), onkeydown: (event) => nudge(event, row) });
    node.addEventListener("pointerdown", (event) => grab(event, node, row, event.shiftKey));
    return { row, node };
  }
  function build() {
    const n = draft.state.rows.length;
    marks = [...Array(n + 1).keys()].map(mark);
    const between = [...Array(n).keys()].map((k) => ({ leg: k + 1, node: el("button", { type: "button", class: "mf-point mf-between", text: "+", title: `insert a waypoint before ${k + 1}`, "aria-label": `insert a waypoint before ${k + 1}`, tabindex: -1, onclick: () => {
      draft.select(k + 1);
      draft.edit({ op: "insert", row: k + 1 });
    } }) }));
    const lift = el("button", { type: "button", class: "mf-point mf-lift", text: "↕", tabindex: -1, title: "drag to change the height", "aria-label": "drag to change the height of the selected waypoint", "data-testid": "point-lift" });
    lift.addEventListener("pointerdown", (event) => draft.selected !== null && grab(event, lift, draft.selected, true));
    marks.push(...between, { lift: true, node: lift });
    holder.replaceChildren(hint, ...between.map((m) => m.node), ...marks.filter((m) => !m.leg).map((m) => m.node)); // points lie on top
  }
  function nudge(event, row) {
    const step = event.shiftKey ? 0.5 : 0.1, [n, e, h] = point(row);
    const moves = { ArrowUp: [step, 0, 0], ArrowDown: [-step, 0, 0], ArrowRight: [0, step, 0], ArrowLeft: [0, -step, 0], PageUp: [0, 0, step], PageDown: [0, 0, -step] };
    const by = moves[event.key];
    if (!by || event.ctrlKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    draft.select(row);
    say(row, [n + by[0], e + by[1], h + by[2]].map((x) => Math.round(x * 1000) / 1000), "");
  }
  const say = (row, [n, e, h], of) => draft.edit({ op: "move", row, at: [n, e, -h], gesture: of });

  // ---- dragging: on the level of the point, or straight up and down
  function grab(event, node, row, upright) {
    if (event.button > 0 || draft.may || dragged) return;
    event.preventDefault();
    event.stopPropagation();
    node.focus({ preventScroll: true });
    draft.select(row);
    const from = [...point(row)], spot = onScreen(from), box = element.getBoundingClientRect();
    if (!spot) return;
    const off = upright ? [0, 0] : [event.clientX - box.left - spot[0], event.clientY - box.top - spot[1]], y0 = event.clientY;
    const perPixel = (2 * Math.tan((camera.fov * Math.PI) / 360) * camera.position.distanceTo(new THREE.Vector3(from[1], from[2], -from[0]))) / box.height;
    dragged = { row, at: from, name: `${performance.timeOrigin}/${++gesture}`, said: 0, moved: false };
    node.setPointerCapture(event.pointerId);
    const move = (e) => {
      if (upright) dragged.at = [from[0], from[1], Math.max(0.05, snap(from[2] - (e.clientY - y0) * perPixel))];
      else {
        const x = e.clientX - box.left - off[0], y = e.clientY - box.top - off[1];
        const there = level(x, y, box, from[2]);
        if (there) dragged.at = [snap(there[0]), snap(there[1]), from[2]];
      }
      dragged.moved ||= dragged.at.some((v, k) => v !== from[k]);
      const now = performance.now();
      if (dragged.moved && now - dragged.said > SAY_MS) {
        dragged.said = now;
        say(row, dragged.at, dragged.name);
      }
      redraw();
    };
    const end = (e) => {
      node.removeEventListener("pointermove", move);
      for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) node.removeEventListener(name, end);
      if (!dragged) return;
      const last = dragged;
      if (last.moved) {
        if (e.type === "pointercancel") say(row, from, last.name);
        else say(row, last.at, last.name);
        if (draft.state) (row ? draft.state.rows[row - 1] : { at: draft.state.start }).at.splice(0, 3, ...(e.type === "pointercancel" ? from : last.at));
      }
      dragged = null;
      redraw();
    };
    node.addEventListener("pointermove", move);
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) node.addEventListener(name, end);
  }
  // Where the sight through a pixel meets a height: N, E (m); null where it looks along it or too far.
  function level(x, y, box, h) {
    ray.setFromCamera(new THREE.Vector2((2 * x) / box.width - 1, 1 - (2 * y) / box.height), camera);
    plane.set(new THREE.Vector3(0, 1, 0), -h);
    return ray.ray.intersectPlane(plane, hit) && hit.distanceTo(camera.position) < FAR_M ? [-hit.z, hit.x] : null;
  }

  // ---- what is drawn
  function redraw() {
    dispose(drawn);
    drawn = new THREE.Group();
    scene.add(drawn);
    if (draft.on && draft.state) {
      const s = draft.state, [n0, e0] = point(0), points = [[n0, e0, 0], ...marks.filter((m) => m.row !== undefined).map((m) => {
        const [n, e, h] = point(m.row);
        return [n, e, -h];
      })];
      const bad = s.bad > s.rows.length ? s.rows.length : s.bad;
      points.forEach((p, k) => {
        if (!k) return;
        const colour = bad === k - 1 && s.fault ? colours.bad : colours.accent;
        drawn.add(lines([points[k - 1], p], colour, { dashed: s.spline && k > 1 }));
        if (k > 1) drawn.add(lines([p, [p[0], p[1], 0]], colours.dim, { opacity: 0.6 }));
      });
      const last = points[points.length - 1];
      if (s.at_end === "land" && s.rows.length) drawn.add(lines([last, [last[0], last[1], 0]], colours.accent));
      if (s.at_end === "return" && s.rows.length) drawn.add(lines([last, [n0, e0, last[2]], [n0, e0, 0]], colours.accent, { dashed: true }));
      if (draft.selected !== null && draft.selected <= s.rows.length) {
        const [n, e] = point(draft.selected), ring = new THREE.Mesh(new THREE.RingGeometry(0.09, 0.12, 32), new THREE.MeshBasicMaterial({ color: colours.reference, side: THREE.DoubleSide }));
        ring.rotation.x = -Math.PI / 2;
        ring.position.set(e, 0.006, -n);
        drawn.add(ring);
      }
    }
    paint();
  }
  function update() {
    const on = draft.on && draft.state !== null;
    holder.hidden = !on;
    if (!on) framed = false;
    else if (!framed) framed = frame();
    const walls = on ? JSON.stringify(draft.state.world) : "";
    if (walls !== ground) {
      ground = walls;
      world(on ? draft.state.world : null);
    }
    if (on && shape !== String(draft.state.rows.length)) {
      shape = String(draft.state.rows.length);
      build();
    }
    redraw();
    made.place(); // not a picture later: what has just been made must not be met where it is not
  }
  // Look at all of it, from behind and above.
  function frame() {
    const all = [point(0), ...draft.state.rows.map((r) => r.at)], low = [0, 1, 2].map((k) => Math.min(...all.map((p) => p[k]))), high = [0, 1, 2].map((k) => Math.max(...all.map((p) => p[k])));
    const [n, e, h] = [0, 1, 2].map((k) => 0.5 * (low[k] + high[k])), far = Math.max(3.5, 1.5 * Math.hypot(...[0, 1].map((k) => high[k] - low[k])) + 1.5);
    controls.target.set(e, 0.5 * h, -n);
    camera.position.set(e + 0.35 * far, 0.5 * h + 0.7 * far, -n + 0.85 * far);
    controls.update();
    return true;
  }
  function put(node, spot, dx = 0, dy = 0) {
    node.style.display = spot ? "" : "none";
    if (spot) node.style.transform = `translate(${spot[0] + dx}px, ${spot[1] + dy}px) translate(-50%, -50%)`;
  }
  const off = draft.watch(update);
  const made = {
    get on() {
      return draft.on && draft.state !== null;
    },
    // A click that hit no mark.
    click(n, e) {
      if (!draft.may) draft.add(snap(n), snap(e));
    },
    place() {
      if (!draft.on || !draft.state) return;
      const s = draft.state;
      hint.textContent = draft.may || (dragged ? (([n, e, h]) => `N ${number(n)}  E ${number(e)}  height ${number(h)} m`)(dragged.at) : "Plan: click adds, drag moves, ↕ changes the height, + inserts");
      const taken = [];
      for (const m of marks) {
        if (m.row !== undefined) {
          const bad = s.fault && (s.bad === m.row || (s.bad > s.rows.length && m.row === s.rows.length));
          m.node.className = `mf-point${m.row === draft.selected ? " mf-point-selected" : ""}${bad ? " mf-point-bad" : ""}`;
          m.node.title = bad ? s.fault : m.row ? `waypoint ${m.row}` : "take-off";
          m.node.setAttribute("aria-label", m.node.title);
          const spot = onScreen(point(m.row)), over = spot ? taken.filter((t) => Math.hypot(t[0] - spot[0], t[1] - spot[1]) < 10).length : 0;
          if (spot) taken.push(spot);
          put(m.node, spot, 19 * over); // side by side where one hides the other
        } else if (m.leg) {
          const a = point(m.leg - 1), b = point(m.leg), from = onScreen(a), to = onScreen(b);
          const long = from && to && Math.hypot(from[0] - to[0], from[1] - to[1]) > LEAST_PX;
          put(m.node, long && !dragged && !draft.may ? onScreen([0, 1, 2].map((k) => 0.5 * (a[k] + b[k]))) : null);
        } else put(m.node, draft.selected !== null && draft.selected <= s.rows.length && !draft.may ? onScreen(point(draft.selected)) : null, 0, -34);
      }
    },
    close() {
      off();
      dispose(drawn);
      holder.remove();
    },
  };
  update();
  return made;
}
