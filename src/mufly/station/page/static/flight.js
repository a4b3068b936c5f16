// The flight display: horizon with pitch ladder and roll scale, speed on the left, height and climb on the right,
// heading below. Magenta marks are what the controllers follow.
import { live } from "./live.js";
import { DEG, FONT, canvas, colours, niceStep, number, place3, ticks } from "./draw.js";

const TAPE = 46, HEADING = 34;

export function mount(element) {
  let s = null;
  const view = canvas(element, "Flight display: attitude, speed, height, heading", draw);
  const panel = live.panel({}, (f) => {
    if (!f.s) return;
    s = f.s;
    view.repaint();
  });

  function draw(ctx, w, h) {
    if (!s) return;
    const [roll, pitch, yaw] = place3(s.attitude), known = Number.isFinite(roll + pitch), follows = place3(s.reference_attitude);
    const left = TAPE, right = w - TAPE, bottom = h - HEADING;
    horizon(ctx, left, 0, right - left, bottom, known ? roll : 0, known ? pitch : 0, known, follows);
    const level = (v) => Math.hypot(...place3(v).slice(0, 2)), up = (v) => -place3(v)[2];
    const speed = level(s.velocity), height = up(s.position), wanted = up(s.reference_position), climb = up(s.velocity), fast = level(s.reference_velocity);
    tape(ctx, 0, 0, TAPE, bottom, speed, fast, speed > 8 ? 20 : speed > 1.5 ? 4 : 1, "m/s", false, "SPEED");
    tape(ctx, right, 0, TAPE, bottom, height, wanted, Math.abs(height) > 20 ? 40 : Math.abs(height) > 5 ? 8 : 2, "m", true, "HEIGHT");
    variometer(ctx, right, 0, bottom, climb);
    heading(ctx, 0, bottom, w, HEADING, yaw, follows[2]);
  }

  function horizon(ctx, x, y, w, h, roll, pitch, known, [rr, rp]) {
    const cx = x + w / 2, cy = y + h / 2, scale = h / (50 / DEG); // 50 degrees from top to bottom
    ctx.save();
    ctx.beginPath();
    ctx.rect(x, y, w, h);
    ctx.clip();
    ctx.translate(cx, cy);
    ctx.rotate(-roll);
    ctx.translate(0, pitch * scale);
    ctx.fillStyle = colours.sky;
    ctx.fillRect(-2 * w, -6 * h, 4 * w, 6 * h);
    ctx.fillStyle = colours.ground;
    ctx.fillRect(-2 * w, 0, 4 * w, 6 * h);
    ctx.strokeStyle = "#fff";
    ctx.lineWidth = 1.5;
    line(ctx, -2 * w, 0, 2 * w, 0);
    ctx.fillStyle = "#fff";
    ctx.font = `10px ${FONT}`;
    ctx.textBaseline = "middle";
    ctx.lineWidth = 1;
    for (let d = -90; d <= 90; d += 5) {
      if (d === 0) continue;
      const at = (-d / DEG) * scale, half = d % 10 ? 12 : 26;
      if (Math.abs(at + pitch * scale) > h * 0.42) continue;
      line(ctx, -half, at, half, at);
      if (d % 10 === 0) {
        ctx.textAlign = "right";
        ctx.fillText(`${Math.abs(d)}`, -half - 4, at);
        ctx.textAlign = "left";
        ctx.fillText(`${Math.abs(d)}`, half + 4, at);
      }
    }
    ctx.restore();
    ctx.save();
    ctx.translate(cx, cy);
    const radius = Math.min(w, h) / 2 - 8;
    ctx.strokeStyle = ctx.fillStyle = "#fff";
    ctx.lineWidth = 1.5;
    ctx.beginPath();
    ctx.arc(0, 0, radius, -Math.PI / 2 - 60 / DEG, -Math.PI / 2 + 60 / DEG);
    ctx.stroke();
    for (const d of [-60, -45, -30, -20, -10, 0, 10, 20, 30, 45, 60]) {
      const a = d / DEG - Math.PI / 2, long = d % 30 ? 5 : 8;
      line(ctx, radius * Math.cos(a), radius * Math.sin(a), (radius - long) * Math.cos(a), (radius - long) * Math.sin(a));
    }
    ctx.save();
    ctx.rotate(-roll);
    triangle(ctx, 0, -radius + 9, 6, 9);
    ctx.restore();
    // What is commanded: where the symbol should come to lie.
    if (Number.isFinite(rr + rp) && known) {
      ctx.save();
      ctx.rotate(-(roll - rr));
      ctx.translate(0, (pitch - rp) * scale);
      ctx.strokeStyle = colours.reference;
      ctx.lineWidth = 2;
      line(ctx, -22, 0, 22, 0);
      line(ctx, 0, -7, 0, 7);
      ctx.restore();
    }
    ctx.strokeStyle = "#101418";
    ctx.lineWidth = 5;
    symbol(ctx);
    ctx.strokeStyle = "#ffc53d";
    ctx.lineWidth = 2.5;
    symbol(ctx);
    ctx.font = `600 11px ${FONT}`;
    ctx.textAlign = "center";
    ctx.textBaseline = "alphabetic";
    const words = known ? `roll ${number(roll * DEG, 1)}°  pitch ${number(pitch * DEG, 1)}°` : "attitude unknown";
    const wide = ctx.measureText(words).width + 12;
    ctx.fillStyle = "rgba(10,14,18,.62)";
    ctx.fillRect(-wide / 2, h / 2 - 20, wide, 16);
    ctx.fillStyle = "#fff";
    ctx.fillText(words, 0, h / 2 - 8);
    ctx.restore();
  }

  function symbol(ctx) {
    ctx.beginPath();
    ctx.moveTo(-44, 0);
    ctx.lineTo(-18, 0);
    ctx.lineTo(-18, 7);
    ctx.moveTo(44, 0);
    ctx.lineTo(18, 0);
    ctx.lineTo(18, 7);
    ctx.moveTo(-2, 0);
    ctx.lineTo(2, 0);
    ctx.stroke();
  }

  function tape(ctx, x, y, w, h, value, wanted, span, unit, rightSide, name) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(x, y, w, h);
    ctx.clip();
    ctx.fillStyle = colours.panel;
    ctx.fillRect(x, y, w, h);
    const mid = y + h / 2, scale = h / span;
    ctx.font = `10px ${FONT}`;
    ctx.textBaseline = "middle";
    const edge = rightSide ? x : x + w, out = rightSide ? 1 : -1;
    if (Number.isFinite(value)) {
      const step = niceStep(span, 5), digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      ctx.strokeStyle = colours.dim;
      ctx.fillStyle = colours.dim;
      ctx.textAlign = rightSide ? "left" : "right";
      for (const [, mark] of ticks(value - span / 2, value + span / 2, step)) {
        const at = mid - (mark - value) * scale;
        line(ctx, edge, at, edge + out * 5, at);
        if (at > y + 32 && Math.abs(at - mid) > 16 && (mark >= -1e-9 || rightSide)) ctx.fillText(number(mark, digits), edge + out * 8, at);
      }
      if (Number.isFinite(wanted)) {
        const at = mid - Math.max(-span / 2 + 0.02 * span, Math.min(span / 2 - 0.02 * span, wanted - value)) * scale;
        ctx.fillStyle = colours.reference;
        ctx.beginPath();
        ctx.moveTo(edge, at);
        ctx.lineTo(edge + out * 9, at - 6);
        ctx.lineTo(edge + out * 9, at + 6);
        ctx.fill();
      }
    }
    ctx.fillStyle = colours.panel;
    ctx.fillRect(x, y, w, 26);
    ctx.fillStyle = colours.dim;
    ctx.textAlign = "center";
    ctx.font = `600 9px ${FONT}`;
    ctx.fillText(name, x + w / 2, y + 8);
    ctx.font = `9px ${FONT}`;
    ctx.fillText(unit, x + w / 2, y + 19);
    ctx.fillStyle = colours.bg;
    ctx.strokeStyle = colours.text;
    ctx.lineWidth = 1;
    ctx.beginPath();
    ctx.rect(x + 1.5, mid - 10.5, w - 3, 21);
    ctx.fill();
    ctx.stroke();
    ctx.fillStyle = colours.text;
    ctx.font = `600 13px ${FONT}`;
    ctx.fillText(fitting(value), x + w / 2, mid + 0.5, w - 6);
    ctx.restore();
  }

  function variometer(ctx, x, y, h, climb) {
    // A bar beside the height: full scale 0.6 m/s, or 5 m/s for vehicles that climb faster.
    if (!Number.isFinite(climb)) return;
    const full = Math.abs(climb) > 0.6 ? 5 : 0.6, mid = y + h / 2;
    const long = (Math.max(-1, Math.min(1, climb / full)) * h) / 2;
    ctx.fillStyle = colours.accent;
    ctx.fillRect(x - 5, Math.min(mid, mid - long), 4, Math.abs(long));
    ctx.font = `600 10px ${FONT}`;
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    const words = `${climb > 0.005 ? "▲" : climb < -0.005 ? "▼" : ""} ${number(Math.abs(climb), 2)} m/s`;
    const wide = ctx.measureText(words).width + 8;
    ctx.fillStyle = "rgba(10,14,18,.62)";
    ctx.fillRect(x - 7 - wide, y + 4, wide, 16);
    ctx.fillStyle = "#fff";
    ctx.fillText(words, x - 11, y + 12);
  }

  function heading(ctx, x, y, w, h, yaw, wanted) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(x, y, w, h);
    ctx.clip();
    ctx.fillStyle = colours.panel;
    ctx.fillRect(x, y, w, h);
    if (Number.isFinite(yaw)) {
      const centre = x + w / 2, scale = w / 120, at = ((yaw * DEG) % 360 + 360) % 360;
      ctx.strokeStyle = ctx.fillStyle = colours.dim;
      ctx.lineWidth = 1;
      ctx.textAlign = "center";
      ctx.textBaseline = "middle";
      ctx.font = `10px ${FONT}`;
      for (const [, k] of ticks(at - 62, at + 62, 10)) {
        const px = centre + (k - at) * scale;
        line(ctx, px, y, px, y + (k % 30 ? 4 : 7));
        const d = ((k % 360) + 360) % 360;
        if (d % 30 === 0 && Math.abs(px - centre) > 38 && px > x + 12 && px < x + w - 12) ctx.fillText({ 0: "N", 90: "E", 180: "S", 270: "W" }[d] || `${d}`, px, y + 17);
      }
      if (Number.isFinite(wanted)) {
        const off = ((((wanted - yaw) * DEG + 180) % 360) + 360) % 360 - 180;
        const px = centre + Math.max(-58, Math.min(58, off)) * scale;
        ctx.fillStyle = colours.reference;
        triangle(ctx, px, y + 1, 6, 9);
      }
      ctx.fillStyle = colours.bg;
      ctx.strokeStyle = colours.text;
      ctx.beginPath();
      ctx.rect(centre - 26.5, y + 8.5, 53, 20);
      ctx.fill();
      ctx.stroke();
      ctx.fillStyle = colours.text;
      ctx.font = `600 13px ${FONT}`;
      ctx.fillText(`${String(Math.round(at) % 360).padStart(3, "0")}°`, centre, y + 19);
    }
    ctx.restore();
  }

  return {
    close() {
      panel.close();
      view.close();
    },
  };
}

// As many decimals as there is room for.
export function fitting(value) {
  const size = Math.abs(value);
  return size >= 1e5 ? value.toExponential(0).replace("e+", "e") : number(value, size >= 999.5 || value <= -99.5 ? 0 : size >= 99.5 ? 1 : 2);
}

function line(ctx, x0, y0, x1, y1) {
  ctx.beginPath();
  ctx.moveTo(x0, y0);
  ctx.lineTo(x1, y1);
  ctx.stroke();
}

function triangle(ctx, x, y, half, long) {
  ctx.beginPath();
  ctx.moveTo(x, y);
  ctx.lineTo(x - half, y + long);
  ctx.lineTo(x + half, y + long);
  ctx.closePath();
  ctx.fill();
}
