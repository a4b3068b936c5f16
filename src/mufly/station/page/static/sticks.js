// Flying by hand: two sticks on the screen, or a joystick of the browser. They spring to the middle when they are let go,
// and end when this window is hidden, loses its focus, its joystick or the station: the vehicle then hovers.
import { live } from "./live.js";
import { el, put } from "./draw.js";

export const DEAD = 0.08; // share of the way that is the middle
const SAY_MS = 50, KEY = "mufly-sticks";
// Which axis of a pad in standard mapping is what, [left x, left y, right x, right y]; up is negative on a pad.
const MODES = { 1: ["yaw", "pitch", "roll", "climb"], 2: ["yaw", "climb", "roll", "pitch"] };
const WORDS = { roll: "right", pitch: "forward", climb: "up", yaw: "turn right" };

export function shaped(v) {
  if (!Number.isFinite(v) || Math.abs(v) <= DEAD) return 0;
  return Math.sign(v) * Math.min(1, (Math.abs(v) - DEAD) / (1 - DEAD));
}
// [left x, left y, right x, right y], up negative, as [right, back, up, turn right].
export function deflection(axes, mode) {
  const at = { roll: 0, pitch: 0, climb: 0, yaw: 0 };
  MODES[mode].forEach((name, k) => (at[name] = shaped(axes[k] ?? 0)));
  return [at.roll, at.pitch, -at.climb, at.yaw].map((v) => (v === 0 ? 0 : v));
}

export function mount(element, options, emit) {
  let open = false, held = false, asked = false, reason = "no vehicle connected", ended = "", mode = localStorage.getItem(KEY) === "1" ? 1 : 2, source = "screen";
  const screen = [0, 0, 0, 0], knobs = [];
  const pads = () => [...(navigator.getGamepads?.() ?? [])].filter((p) => p && p.connected && p.axes.length >= 4);
  const pad = () => pads().find((p) => `${p.index}` === source);
  const axes = () => (source === "screen" ? screen : pad()?.axes.slice(0, 4));

  const toggle = el("button", { type: "button", class: "mf-sticks-toggle", text: "Sticks", title: "manual flight with sticks", "data-testid": "sticks-toggle", "aria-pressed": false, onclick: () => show(!open) });
  const from = el("select", { "aria-label": "stick input", onchange: () => (end("stick input changed"), (source = from.value), fill()) });
  const kind = el("select", { "aria-label": "stick for climb", title: "stick for climb", onchange: () => (end("stick mode changed"), (mode = Number(kind.value)), localStorage.setItem(KEY, mode), fill()) },
    el("option", { value: 2, text: "climb on the left stick (mode 2)" }), el("option", { value: 1, text: "climb on the right stick (mode 1)" }));
  const go = el("button", { type: "button", "data-testid": "by-hand", onclick: () => (asked || held ? end("") : begin()) });
  const words = el("span", { class: "mf-dim", role: "status", "data-testid": "sticks-said" });
  const bar = el("div", { class: "mf-sticks-bar", hidden: true }, go, from, kind, words);
  const both = el("div", { class: "mf-sticks-pads", hidden: true }, ...[0, 1].map(stick));
  element.append(toggle, bar, both);

  function stick(side) {
    const knob = el("div", { class: "mf-knob" }), up = el("span", { class: "mf-stick-up" }), across = el("span", { class: "mf-stick-across" });
    const area = el("div", { class: "mf-stick", "data-testid": `stick-${side}`, role: "img", "aria-label": side ? "right stick" : "left stick" }, up, across, knob);
    knobs.push({ knob, up, across });
    let finger = null;
    const at = (event) => {
      const box = area.getBoundingClientRect(), r = 0.5 * box.width - 16;
      let x = (event.clientX - box.left - box.width / 2) / r, y = (event.clientY - box.top - box.height / 2) / r;
      const far = Math.hypot(x, y);
      if (far > 1) (x /= far), (y /= far);
      screen[2 * side] = x;
      screen[2 * side + 1] = y;
      draw();
    };
    area.addEventListener("pointerdown", (event) => {
      if (finger !== null || source !== "screen") return;
      event.preventDefault();
      finger = event.pointerId;
      area.setPointerCapture(finger);
      at(event);
    });
    area.addEventListener("pointermove", (event) => event.pointerId === finger && at(event));
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) area.addEventListener(name, (event) => {
      if (event.pointerId !== finger) return;
      finger = null;
      screen[2 * side] = screen[2 * side + 1] = 0;
      draw();
      tick();
    });
    return area;
  }

  function draw() {
    const now = axes() ?? [0, 0, 0, 0];
    knobs.forEach(({ knob }, side) => (knob.style.transform = `translate(${42 * now[2 * side]}px, ${42 * now[2 * side + 1]}px)`));
  }
  function fill() {
    const list = pads(), names = [["screen", "on-screen sticks"], ...list.map((p) => [`${p.index}`, p.id.replace(/\(.*/, "").trim().slice(0, 28) || `joystick ${p.index + 1}`])];
    const key = JSON.stringify(names);
    if (from.dataset.key !== key) {
      from.dataset.key = key;
      from.replaceChildren(...names.map(([value, text]) => el("option", { value, text })));
    }
    from.value = source;
    kind.value = String(mode);
    knobs.forEach(({ up, across }, side) => (put(across, `${WORDS[MODES[mode][2 * side]]} →`), put(up, `↑ ${WORDS[MODES[mode][2 * side + 1]]}`)));
    const on = held || asked;
    put(go, on ? "End manual flight" : "Manual flight");
    go.disabled = !on && Boolean(reason);
    go.classList.toggle("mf-sticks-on", held);
    put(words, on ? (held ? "manual flight; centred sticks hold the position" : "requesting …") : reason || ended || (source === "screen" ? "centred sticks hold position and height" : "centre the joystick"));
    both.classList.toggle("mf-sticks-live", held);
    draw();
  }
  function show(yes) {
    if (!yes) end("sticks closed");
    open = yes;
    bar.hidden = both.hidden = !yes;
    toggle.setAttribute("aria-pressed", yes);
    fill();
  }

  function begin() {
    const now = axes();
    if (!now) return;
    ended = "";
    asked = true;
    emit("sticks", { begin: true, at: deflection(now, mode) });
    fill();
  }
  function end(why) {
    if (asked || held) emit("sticks", { end: why });
    asked = held = false;
    if (why) ended = why;
    screen.fill(0);
    fill();
  }
  function tick() {
    if (!open) return;
    if (source !== "screen" && !pad()) {
      source = "screen";
      end("joystick disconnected");
    }
    const now = axes();
    draw();
    if (now && (held || asked)) emit("sticks", { at: deflection(now, mode) });
  }
  const timer = setInterval(tick, SAY_MS);
  const away = (why) => () => (asked || held) && end(why);
  const hidden = () => document.hidden && away("window hidden")();
  const events = [
    [document, "visibilitychange", hidden], [window, "blur", away("window lost focus")], [window, "pagehide", away("page closed")],
    [window, "gamepadconnected", (event) => {
      if (!asked && !held && event.gamepad.axes.length >= 4) source = `${event.gamepad.index}`;
      fill();
    }],
    [window, "gamepaddisconnected", (event) => {
      if (`${event.gamepad.index}` === source) tick();
      fill();
    }],
  ];
  for (const [what, name, act] of events) what.addEventListener(name, act);
  const panel = live.panel({}, () => {}, { offline: (yes) => yes && away("connection to the station lost")() });
  fill();
  return {
    show(now) {
      reason = now.reason;
      if (now.held) (held = true), (asked = false);
      fill();
    },
    ended(why) {
      asked = held = false;
      ended = why;
      fill();
    },
    close() {
      end("page closed");
      clearInterval(timer);
      for (const [what, name, act] of events) what.removeEventListener(name, act);
      panel.close();
    },
  };
}
