// The ring of range beams seen from above; the nose points up.
import { live } from "./live.js";
import { FONT, canvas, colours, drawn, niceStep, number, ticks } from "./draw.js";

export function mount(element) {
  let s = null;
  const view = canvas(element, "Ranges around the vehicle", draw);
  const panel = live.panel({}, (f) => {
    if (!f.s) return;
    s = f.s;
    view.repaint();
  });

  function draw(ctx, w, h) {
    const cx = w / 2, cy = h / 2, radius = Math.min(w, h) / 2 - 17;
    ctx.font = `10px ${FONT}`;
    ctx.textAlign = "center";
    ctx.textBaseline = "middle";
    const known = s?.ranges?.length, most = drawn(s?.range_max_m);
    const far = known && most > 1e-3 ? most : known ? Math.max(1, ...s.ranges.map((r) => drawn(r)).filter(Number.isFinite)) : 1.5;
    const scale = radius / far;
    ctx.strokeStyle = colours.grid;
    ctx.fillStyle = colours.dim;
    ctx.lineWidth = 1;
    const step = niceStep(far, 3);
    for (const [, r] of ticks(step, far * 1.001, step)) circle(ctx, cx, cy, r * scale);
    ctx.beginPath();
    ctx.moveTo(cx, cy - radius);
    ctx.lineTo(cx, cy + radius);
    ctx.moveTo(cx - radius, cy);
    ctx.lineTo(cx + radius, cy);
    ctx.stroke();
    if (!known) {
      ctx.fillText("no range beams", cx, cy + 14);
      return;
    }
    const n = s.ranges.length, half = Math.min(Math.PI / n, 0.35) * 0.8;
    ctx.textAlign = "center";
    for (let k = 0; k < n; k++) {
      const value = Math.max(0, drawn(s.ranges[k], Infinity)), a = drawn(s.range_angles?.[k]) - Math.PI / 2;
      if (!Number.isFinite(value + a)) continue;
      const free = value >= far * 0.999, r = Math.min(value, far) * scale;
      ctx.beginPath();
      ctx.moveTo(cx, cy);
      ctx.arc(cx, cy, r, a - half, a + half);
      ctx.closePath();
      ctx.globalAlpha = free ? 0.1 : 0.3;
      ctx.fillStyle = free ? colours.dim : value < 0.45 ? colours.bad : colours.accent;
      ctx.fill();
      ctx.globalAlpha = 1;
      if (!free) {
        ctx.strokeStyle = value < 0.45 ? colours.bad : colours.accent;
        ctx.lineWidth = 3;
        ctx.beginPath();
        ctx.arc(cx, cy, r, a - half, a + half);
        ctx.stroke();
      }
      if (n <= 16) {
        ctx.fillStyle = free ? colours.dim : colours.text;
        ctx.font = `${free ? "" : "600 "}10px ${FONT}`;
        ctx.fillText(free ? "free" : number(value, 2), cx + (radius + 9) * Math.cos(a) * 1.06, cy + (radius + 8) * Math.sin(a));
      }
    }
    ctx.fillStyle = colours.text;
    ctx.beginPath();
    ctx.moveTo(cx, cy - 9);
    ctx.lineTo(cx - 6, cy + 7);
    ctx.lineTo(cx + 6, cy + 7);
    ctx.closePath();
    ctx.fill();
    ctx.fillStyle = colours.dim;
    ctx.font = `10px ${FONT}`;
    ctx.textAlign = "left";
    ctx.fillText(`ring ${number(step, step < 1 ? 1 : 0)} m`, 4, h - 8);
  }

  return {
    close() {
      panel.close();
      view.close();
    },
  };
}

function circle(ctx, x, y, r) {
  ctx.beginPath();
  ctx.arc(x, y, r, 0, 2 * Math.PI);
  ctx.stroke();
}
