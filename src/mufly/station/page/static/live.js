// The stream of frames: one web socket a window. Panels say what they show, and get it while they are shown.
//
// A frame is acknowledged when it has been drawn. A hidden window acknowledges nothing, so the server sends nothing.
//
// A watchdog looks whether frames come. Without one for a second the page greys and nothing on it can be used: a station
// that is stopped, a network that is cut, a machine that slept. It comes back with the next frame. Every request names the
// newest frame and how long it was held back here; the station drops what is late (page/contact.py).

import { el } from "./draw.js";

const RECONNECT_MS = 1000, GIVE_UP_MS = 3000; // a stream that says nothing for so long is opened anew
const CONTACT_MS = 900, LOOK_MS = 50, LATE_MS = 1000; // greyed within a second
const CAPACITY = 1 << 16;

const panels = new Set(), waiting = [];
let socket = null, last = 0;
let wanted = "";
let pendingDraw = null;

export const live = {
  latest: null, // the last frame that had a snapshot
  connected: false, // frames come, and what is asked reaches the station
  lost: false, // it was connected, or should be by now: the page is grey
  catalog: [],
  mission: undefined, // the last mission table, while some panel wants it
  samples: { t: new Float64Array(CAPACITY), n: 0, columns: new Map(), version: 0 },
  frames: 0,

  // want: { sections, signals, window_s, spectrum, spectrum_s }; frame(f) is called for every frame, offline(yes) when the
  // contact is lost or back, silent(ms) once a second while it is lost (null: nobody knows for how long).
  panel(want, frame, { offline = null, silent = null } = {}) {
    const panel = { want, frame, offline, silent };
    panels.add(panel);
    tell();
    // A panel that is shown late gets the present at once, when its own set-up is done.
    queueMicrotask(() => {
      // A table that another panel wants already is not sent again: it gets our copy.
      if (live.latest && panels.has(panel)) frame({ s: live.latest.s, about: live.latest.about, mission: live.mission, repeated: true });
    });
    return {
      set(change) {
        Object.assign(panel.want, change);
        tell();
      },
      close() {
        panels.delete(panel);
        tell();
      },
    };
  },

  column(name) {
    return live.samples.columns.get(name);
  },

  // What is sent to the station as a file names the newest frame, too.
  headers: () => [{ name: "X-Mufly-Frame", value: String(last) }],
  // For how long an event waited in this browser (ms): a page that is busy or asleep gets presses late.
  held: (event) => Math.max(0, performance.now() - event.timeStamp),
  // Whether a press is too old to be obeyed; says so.
  isLate(event) {
    const late = live.held(event) > LATE_MS;
    if (late) refuse(live.held(event));
    return late;
  },
  // The first moment at which the station can be asked for something.
  whenConnected: (then) => (live.connected ? then() : waiting.push(then)),

  say(content) {
    if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(content));
  },
};
window.muflyLive = live; // for the tests of the page
live.take = take;

let telling = false;
function tell() {
  if (telling) return;
  telling = true; // several panels mount at once: say it once
  queueMicrotask(() => {
    telling = false;
    const sections = new Set(), signals = new Set();
    let window_s = 0, spectrum = "", spectrum_s = 10;
    for (const { want } of panels) {
      (want.sections || []).forEach((s) => sections.add(s));
      (want.signals || []).forEach((s) => signals.add(s));
      window_s = Math.max(window_s, want.window_s || 0);
      if (want.spectrum) [spectrum, spectrum_s] = [want.spectrum, want.spectrum_s || 10];
    }
    const next = JSON.stringify({
      want: { sections: [...sections], signals: [...signals], window_s: window_s || 30, spectrum, spectrum_s },
    });
    if (next !== wanted) {
      wanted = next;
      if (!sections.has("mission")) live.mission = undefined; // the server sends it anew when it is wanted again
      if (socket?.readyState === WebSocket.OPEN) socket.send(next);
    }
  });
}

function store(h) {
  const { samples } = live;
  if (h.names) {
    samples.columns = new Map(h.names.map((name) => [name, new Float32Array(CAPACITY)]));
    samples.n = 0;
    samples.names = h.names;
  }
  if (!samples.names) return;
  const extra = h.t.length;
  if (!extra) return;
  if (samples.n + extra > CAPACITY) {
    const keep = CAPACITY >> 1, from = samples.n - keep;
    samples.t.copyWithin(0, from, samples.n);
    for (const c of samples.columns.values()) c.copyWithin(0, from, samples.n);
    samples.n = keep;
  }
  const n = samples.n;
  for (let i = 0; i < extra; i++) samples.t[n + i] = h.t[i];
  samples.names.forEach((name, k) => {
    const column = samples.columns.get(name), values = h.v[k] ?? [];
    for (let i = 0; i < extra; i++) column[n + i] = values[i] ?? NaN;
  });
  samples.n = n + extra;
  samples.version++;
}

function take(frame) {
  if (frame.new) {
    live.samples.n = 0;
    live.samples.version++;
    live.mission = undefined;
  }
  if (frame.mission) live.mission = frame.mission;
  if (frame.h) store(frame.h);
  if (frame.catalog) live.catalog = frame.catalog;
  if (frame.s) live.latest = frame;
  live.frames++;
  live.received = performance.timeOrigin + performance.now();
  for (const panel of [...panels]) {
    try {
      panel.frame(frame);
    } catch (error) {
      console.error(error);
    }
  }
}

// ---- the watchdog
const loaded = performance.now();
let heard = loaded, opened = loaded, shown = loaded, looked = loaded, wall = Date.now();

function look() {
  const now = performance.now();
  // The clock of pages may stand still while a machine sleeps, the one of the day does not: what was seen before is old.
  if (Math.abs(Date.now() - wall - (now - looked)) > LATE_MS) heard = -Infinity;
  [looked, wall] = [now, Date.now()];
  const answers = socket?.readyState === WebSocket.OPEN && window.socket?.connected && window.did_handshake;
  setConnected(Boolean(answers && last && now - heard < CONTACT_MS));
  if (!live.connected && !document.hidden && now - Math.max(heard, loaded) > CONTACT_MS) setLost(true);
  // While it is hidden no frames come; a station that does not answer for long is called more seldom.
  const patience = Math.min(10_000, Math.max(GIVE_UP_MS, 0.1 * (now - heard)));
  if (!document.hidden && now - Math.max(heard, opened, shown) > patience) connect();
  if (live.lost) tellLost(Number.isFinite(heard) ? now - heard : null);
}

function setConnected(yes) {
  if (yes) setLost(false);
  if (live.connected === yes) return;
  live.connected = yes;
  hold(!yes);
  if (yes) waiting.splice(0).forEach((then) => then());
}
// What cannot be used cannot be pressed, typed into or tabbed to; dialogs and menus stand beside the page.
let focused = null;
function hold(yes) {
  if (yes && document.activeElement !== document.body) focused = document.activeElement;
  for (const part of document.querySelectorAll(".mf-page, .mf-stop, [id^=q-portal]")) part.inert = yes;
  if (yes) return;
  if (document.activeElement === document.body && focused?.isConnected) focused.focus({ preventScroll: true });
  focused = null;
}

const seconds = el("span", { "aria-hidden": true, class: "mf-num" });
const overlay = el("div", { class: "mf-lost", role: "alert", hidden: true, "data-testid": "no-contact" }, el("strong", {}, "No link to the station", seconds),
  el("span", { text: "The display is outdated, and no command from this page reaches the vehicle." }),
  el("span", { text: "To stop the motors, use the transmitter or its kill switch." }));
document.body.append(overlay);
function setLost(yes) {
  if (live.lost === yes) return;
  live.lost = yes;
  document.body.classList.toggle("mf-offline", yes);
  overlay.hidden = !yes;
  for (const panel of panels) panel.offline?.(yes);
}
export const forSeconds = (ms) => (ms === null ? "" : ` for ${Math.floor(ms / 1000) || "less than 1"} s`);
function tellLost(ms) {
  hold(true);
  if (seconds.textContent !== forSeconds(ms)) {
    seconds.textContent = forSeconds(ms);
    for (const panel of panels) panel.silent?.(ms);
  }
}

// ---- requests: NiceGUI's events, with the newest frame and the time from press to departure
function guard(link) {
  const emit = link.emit.bind(link);
  link.emit = (name, ...content) => {
    if (name !== "event") return emit(name, ...content);
    look();
    const held = window.event?.isTrusted ? live.held(window.event) : 0, typed = ["input", "change"].includes(window.event?.type);
    // What is typed tells the station what stands in a field; whether that asks for something the station knows.
    if ((!live.connected || held > LATE_MS) && !typed) return refuse(held);
    return emit(name, { ...content[0], frame: last, held_ms: held, seen_ms: performance.now() - heard }, ...content.slice(1));
  };
  // A station that is stopped answers no handshake; the page waits for it and is not loaded anew.
  link.io.timeout(GIVE_UP_MS);
  link.io.reconnectionDelayMax(RECONNECT_MS);
  link.off("connect_error");
  link.on("connect_error", (error) => error.message === "Implicit handshake failed" && location.reload());
}
let refused = -Infinity;
function refuse(held) {
  if (performance.now() - refused < LATE_MS) return;
  refused = performance.now();
  const why = live.connected ? `delayed ${(held / 1000).toFixed(1)} s in this browser` : "no link to the station";
  window.Quasar?.Notify.create({ message: `Not sent: ${why}`, type: "warning", position: "bottom", timeout: 4000 });
}

// ---- the stream
function connect() {
  const scheme = location.protocol === "https:" ? "wss://" : "ws://";
  const old = socket, made = (socket = new WebSocket(`${scheme}${location.host}/live/${window.clientId}`));
  old?.close();
  opened = performance.now();
  made.onopen = () => {
    if (made === socket && wanted) made.send(wanted);
  };
  made.onmessage = (event) => {
    if (made !== socket) return;
    const frame = JSON.parse(event.data);
    last = frame.n;
    heard = performance.now();
    look();
    take(frame);
    // Frames arrive while the window is shown; say "drawn" after the browser has had its chance to draw.
    if (!document.hidden && pendingDraw === null) {
      pendingDraw = requestAnimationFrame(() => {
        pendingDraw = null;
        live.say({ drawn: last });
      });
    }
  };
  made.onclose = () => {
    if (made !== socket) return;
    look();
    setTimeout(() => made === socket && connect(), RECONNECT_MS);
  };
}
document.addEventListener("visibilitychange", () => {
  shown = performance.now();
  look();
  if (!document.hidden) live.say({ drawn: last });
});
(function begin() {
  if (!window.clientId || !window.socket) return void setTimeout(begin, 20);
  guard(window.socket);
  connect();
  setInterval(look, LOOK_MS);
})();
hold(true);
