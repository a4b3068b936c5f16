// The stream of frames: one web socket a window. Panels say what they show, and get it while they are shown.
//
// A frame is acknowledged when it has been drawn. A hidden window acknowledges nothing, so the server sends nothing.

const RECONNECT_MS = 1000;
const CAPACITY = 1 << 16;

const panels = new Set();
let socket = null;
let wanted = "";
let pendingDraw = null;

export const live = {
  latest: null, // the last frame that had a snapshot
  connected: false,
  catalog: [],
  mission: undefined, // the last mission table, while some panel wants it
  samples: { t: new Float64Array(CAPACITY), n: 0, columns: new Map(), version: 0 },
  frames: 0,

  // want: { sections, signals, window_s, spectrum, spectrum_s }; frame(f) is called for every frame.
  panel(want, frame, { offline = null } = {}) {
    const panel = { want, frame, offline };
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

  say(content) {
    if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(content));
  },
};
window.muflyLive = live; // for the tests of the page

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
    const column = samples.columns.get(name), values = h.v[k];
    for (let i = 0; i < extra; i++) column[n + i] = values[i] === null ? NaN : values[i];
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

function setConnected(yes) {
  if (live.connected === yes) return;
  live.connected = yes;
  document.body.classList.toggle("mf-offline", !yes);
  // What is pressed now would reach the station when it is back, and the vehicle then.
  for (const part of document.querySelectorAll(".mf-page, .mf-stop, .q-dialog")) part.inert = !yes;
  for (const panel of panels) panel.offline?.(!yes);
}

let last = 0;
function connect() {
  const scheme = location.protocol === "https:" ? "wss://" : "ws://";
  socket = new WebSocket(`${scheme}${location.host}/live/${window.clientId}`);
  socket.onopen = () => {
    if (wanted) socket.send(wanted);
    setConnected(true);
  };
  socket.onmessage = (event) => {
    const frame = JSON.parse(event.data);
    take(frame);
    last = frame.n;
    // Frames arrive while the window is shown; say "drawn" after the browser has had its chance to draw.
    if (!document.hidden && pendingDraw === null) {
      pendingDraw = requestAnimationFrame(() => {
        pendingDraw = null;
        live.say({ drawn: last });
      });
    }
  };
  socket.onclose = () => {
    setConnected(false);
    setTimeout(connect, RECONNECT_MS);
  };
}
document.addEventListener("visibilitychange", () => {
  if (!document.hidden) live.say({ drawn: last });
});
(function begin() {
  if (window.clientId) connect();
  else setTimeout(begin, 20);
})();
