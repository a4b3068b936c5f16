// The camera that looks down: the picture with its features, the map of the floor from above, what SLAM says of itself.
import { live } from "./live.js";
import { DEG, FONT, canvas, colours, drawn, el, niceStep, number, put } from "./draw.js";

const INSIDE_95 = Math.sqrt(5.991); // of two numbers, in standard deviations
const LATE_S = 0.7; // without a picture for so long, that is said

export function mount(element) {
  const picture = el("img", { alt: "camera image", hidden: true });
  const frame = el("div", { class: "mf-camera-picture" }, picture);
  const above = el("div", { class: "mf-camera-map" });
  const head = el("p", { class: "mf-checks-head", role: "status", "data-testid": "camera-said" });
  const facts = el("dl", { class: "mf-camera-facts mf-num" });
  element.append(frame, above, el("div", { class: "mf-camera-told" }, head, facts));
  let now = null, map = { keyframes: [], ties: [], path: [] }, s = null, size = null, shown = 0;
  const rows = new Map();
  const marks = canvas(frame, "matched features", drawMarks);
  const chart = canvas(above, "floor map: keyframes, loop closures, path, and position with its 95 % ellipse", drawMap);

  picture.onload = () => {
    size = [picture.naturalWidth, picture.naturalHeight];
    picture.hidden = false;
    marks.repaint();
  };

  function fact(name, value) {
    if (!rows.has(name)) {
      rows.set(name, el("dd"));
      facts.append(el("dt", { text: name }), rows.get(name));
    }
    put(rows.get(name), value);
  }

  function tell() {
    const late = now && s ? s.time_s - now.t : 0;
    let said = "No image received", state = "open";
    if (now && late > LATE_S + (now.latency_s || 0)) [said, state] = [`No image for ${number(late, 1)} s`, "bad"];
    else if (now?.stands) said = now.features === undefined ? "On the floor: SLAM not started" : "Landed: SLAM paused";
    else if (now?.said) [said, state] = [`No position: ${now.said}`, "bad"];
    else if (now && !now.trusted_now) [said, state] = [`No position: ${now.reason}`, "bad"];
    else if (now) [said, state] = ["Tracking: position valid", "good"];
    put(head, said);
    head.dataset.state = state;
    if (!now) return;
    const known = now.features !== undefined && now.trusted_now, c = now.covariance;
    const sigma = (k) => Math.sqrt(Math.max(c[k][k], 0));
    fact("north", known ? `${number(now.position[0])} ± ${number(sigma(0), 3)} m` : "–");
    fact("east", known ? `${number(now.position[1])} ± ${number(sigma(1), 3)} m` : "–");
    fact("heading", known ? `${number(now.heading * DEG, 1)} ± ${number(sigma(3) * DEG, 1)}°` : "–");
    fact("features", now.tracked ? `${now.agreed} of ${now.tracked} matched` : "–");
    fact("latency", now.latency_s ? `${number(1e3 * now.latency_s, 0)} ms, SLAM ${number(1e3 * now.work_s, 0)}` : "–");
    fact("images lost (radio)", share(now.lost, now.taken));
    fact("images without position", share(now.answered - now.trusted, now.answered));
    fact("map", `${now.keyframes} keyframes, ${now.closures} ${now.closures === 1 ? "loop" : "loops"}`);
  }

  function drawMarks(ctx, w, h) {
    if (!size || !now?.features) return;
    const scale = Math.min(w / size[0], h / size[1]), x0 = (w - scale * size[0]) / 2, y0 = (h - scale * size[1]) / 2;
    ctx.lineWidth = 1.5;
    ctx.strokeStyle = now.trusted_now ? "#39e08a" : "#ffb02e"; // on a picture, whatever the theme
    for (const [u, v] of now.features) {
      ctx.beginPath();
      ctx.arc(x0 + scale * (u + 0.5), y0 + scale * (v + 0.5), 3, 0, 2 * Math.PI);
      ctx.stroke();
    }
  }

  function drawMap(ctx, w, h) {
    const here = now?.features !== undefined && now.trusted_now ? now.position : null;
    const points = [...map.keyframes, ...map.path, ...(here ? [here] : []), ...(s ? [s.position] : [])].filter((p) => Number.isFinite(drawn(p[0]) + drawn(p[1])));
    ctx.font = `10px ${FONT}`;
    ctx.fillStyle = colours.dim;
    ctx.textAlign = "center";
    if (!points.length) return ctx.fillText("no map yet", w / 2, h / 2);
    let [low, high] = [[Infinity, Infinity], [-Infinity, -Infinity]];
    for (const p of points) for (const k of [0, 1]) [low[k], high[k]] = [Math.min(low[k], p[k]), Math.max(high[k], p[k])];
    const scale = Math.min((w - 24) / Math.max(high[1] - low[1], 0.6), (h - 34) / Math.max(high[0] - low[0], 0.6));
    const middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    const at = (n, e) => [w / 2 + scale * (e - middle[1]), (h - 12) / 2 - scale * (n - middle[0])];
    const line = (ps, colour, width) => {
      ctx.strokeStyle = colour;
      ctx.lineWidth = width;
      ctx.beginPath();
      ps.forEach((p, k) => (k ? ctx.lineTo(...at(p[0], p[1])) : ctx.moveTo(...at(p[0], p[1]))));
      ctx.stroke();
    };
    for (const [a, b, closes] of map.ties) {
      if (map.keyframes[a] && map.keyframes[b]) line([map.keyframes[a], map.keyframes[b]], closes ? colours.reference : colours.line, closes ? 2 : 1);
    }
    line(map.path, colours.accent, 1.5);
    ctx.fillStyle = colours.dim;
    for (const k of map.keyframes) ctx.fillRect(...at(k[0], k[1]).map((x) => x - 2.5), 5, 5);
    if (s) arrow(ctx, at(s.position[0], s.position[1]), s.attitude[2], colours.text, false);
    if (here) {
      const c = now.covariance, [x, y] = at(here[0], here[1]);
      const mean = (c[0][0] + c[1][1]) / 2, half = (c[0][0] - c[1][1]) / 2, r = Math.hypot(half, c[0][1]);
      const [long, short] = [mean + r, Math.max(mean - r, 0)].map((v) => Math.max(INSIDE_95 * Math.sqrt(v) * scale, 1));
      ctx.beginPath(); // the longer axis lies at this angle from north towards east; the canvas counts from east, down
      ctx.ellipse(x, y, long, short, 0.5 * Math.atan2(2 * c[0][1], 2 * half) - Math.PI / 2, 0, 2 * Math.PI);
      ctx.globalAlpha = 0.25;
      ctx.fillStyle = colours.accent;
      ctx.fill();
      ctx.globalAlpha = 1;
      ctx.strokeStyle = colours.accent;
      ctx.lineWidth = 1.2;
      ctx.stroke();
      arrow(ctx, [x, y], now.heading, colours.accent, true);
    }
    const step = niceStep(w / scale, 6);
    ctx.strokeStyle = colours.dim;
    ctx.lineWidth = 1;
    ctx.beginPath();
    ctx.moveTo(6, h - 6);
    ctx.lineTo(6 + step * scale, h - 6);
    ctx.stroke();
    ctx.fillStyle = colours.dim;
    ctx.textAlign = "left";
    ctx.fillText(`${number(step, step < 1 ? 1 : 0)} m`, 6, h - 10);
    ctx.textAlign = "right";
    ctx.fillText("north up; ■ keyframe", w - 4, 12);
    ctx.fillStyle = colours.reference;
    if (map.ties.some((t) => t[2])) ctx.fillText("— loop closure", w - 4, 24);
  }

  const panel = live.panel({ sections: ["camera"] }, (f) => {
    if (f.new) [now, map] = [null, { keyframes: [], ties: [], path: [] }];
    if (f.floor_map) map = f.floor_map;
    if (f.camera) {
      now = f.camera;
      picture.src = `data:image/jpeg;base64,${now.jpeg}`;
    }
    if (f.s) s = f.s;
    const at = performance.now();
    if (f.camera || f.floor_map || at - shown > 200) {
      shown = at;
      tell();
      chart.repaint();
      marks.repaint();
    }
  });
  tell();
  return {
    close() {
      panel.close();
      marks.close();
      chart.close();
    },
  };
}

const share = (part, all) => (all ? `${part} of ${all} (${number((100 * part) / all, 1)} %)` : "–");

function arrow(ctx, [x, y], heading, colour, filled) {
  ctx.save();
  ctx.translate(x, y);
  ctx.rotate(heading);
  ctx.beginPath();
  ctx.moveTo(0, -8);
  ctx.lineTo(5, 6);
  ctx.lineTo(-5, 6);
  ctx.closePath();
  [ctx.fillStyle, ctx.strokeStyle, ctx.lineWidth] = [colour, colour, 1.2];
  filled ? ctx.fill() : ctx.stroke();
  ctx.restore();
}
