// Alerts aloud: spoken where the browser has a voice, a tone otherwise, one for each level; muted by a switch that is
// remembered. A browser lets a page sound only after a click or a key: until then the switch says that it waits.
import { live } from "./live.js";
import { el, icon } from "./draw.js";

const LOST_MS = 3000, KEY = "mufly-alerts", RANK = { info: 0, warning: 1, error: 2 };
// Tones of a level: [frequency (Hz), length (s)], one after the other.
const TONES = { info: [[660, 0.12]], warning: [[520, 0.16], [420, 0.22]], error: [[880, 0.14], [620, 0.14], [880, 0.14], [620, 0.2]] };

export function mount(element) {
  const state = { muted: false, voice: true, least: "info" };
  try {
    Object.assign(state, JSON.parse(localStorage.getItem(KEY) || "{}"));
  } catch (error) { /* begin anew */ }
  let sound = null, free = false, lost = false;
  const said = []; // for the tests of the page
  window.muflyAlerts = { said, state };

  const voices = () => (window.speechSynthesis?.getVoices?.() ?? []);
  const toggle = el("button", { type: "button", class: "mf-icon-button", "data-testid": "alerts", onclick: () => (menu.hidden = !menu.hidden) });
  const mute = el("input", { type: "checkbox", "data-testid": "mute", onchange: () => ((state.muted = mute.checked), state.muted && window.speechSynthesis?.cancel(), keep()) });
  const voice = el("input", { type: "checkbox", onchange: () => ((state.voice = voice.checked), keep()) });
  const least = el("select", { "aria-label": "lowest level announced", onchange: () => ((state.least = least.value), keep()) },
    el("option", { value: "info", text: "all alerts" }), el("option", { value: "warning", text: "warnings and errors" }), el("option", { value: "error", text: "errors" }));
  const note = el("span", { class: "mf-dim" });
  const menu = el("div", { class: "mf-alert-menu", hidden: true, role: "group", "aria-label": "audio alerts" },
    el("label", { class: "mf-check" }, mute, " mute"), el("label", { class: "mf-check" }, voice, " speech, if available"), least,
    el("button", { type: "button", text: "Test", onclick: () => sound_it({ level: "warning", text: "test warning" }, true) }), note);
  element.append(toggle, menu);

  function keep() {
    localStorage.setItem(KEY, JSON.stringify(state));
    fill();
  }
  function fill() {
    mute.checked = state.muted;
    voice.checked = state.voice;
    least.value = state.least;
    const waits = !state.muted && !free;
    toggle.replaceChildren(icon(state.muted ? "mute" : "sound"));
    toggle.classList.toggle("mf-alerts-wait", waits);
    const words = state.muted ? "alerts muted" : waits ? "alerts start after the first click or key press" : "audio alerts on";
    toggle.title = words;
    toggle.setAttribute("aria-label", words);
    toggle.setAttribute("aria-expanded", !menu.hidden);
    note.textContent = voices().length ? "" : "no speech in this browser; tones only";
  }

  // The first click or key frees the sound; a context made before it would be refused, with a warning.
  function awake() {
    if (!free) {
      free = true;
      try {
        sound = new AudioContext();
      } catch (error) { /* no sound in this browser: the page shows all of it anyway */ }
      fill();
    }
    if (sound?.state === "suspended") sound.resume().catch(() => {});
  }
  function tone(level) {
    if (!sound || sound.state !== "running") return;
    let at = sound.currentTime + 0.02;
    for (const [frequency, length] of TONES[level] ?? TONES.info) {
      const source = sound.createOscillator(), gain = sound.createGain();
      source.frequency.value = frequency;
      source.type = level === "error" ? "square" : "sine";
      gain.gain.setValueAtTime(0.0001, at);
      gain.gain.exponentialRampToValueAtTime(level === "error" ? 0.12 : 0.2, at + 0.02);
      gain.gain.exponentialRampToValueAtTime(0.0001, at + length);
      source.connect(gain).connect(sound.destination);
      source.start(at);
      source.stop(at + length + 0.02);
      at += length + 0.03;
    }
  }
  function sound_it({ level, text }, always = false) {
    said.push({ level, text, muted: state.muted });
    if (said.length > 100) said.shift();
    if (!free || (!always && (state.muted || RANK[level] < RANK[state.least]))) return;
    tone(level);
    if (!state.voice || !voices().length) return;
    try {
      if (level === "error") window.speechSynthesis.cancel(); // what is graver does not wait
      const words = new SpeechSynthesisUtterance(text.replace(/[[\]_]/g, " "));
      words.lang = "en";
      words.rate = 1.1;
      window.speechSynthesis.speak(words);
    } catch (error) { /* the tone was sounded */ }
  }

  const outside = (event) => !menu.hidden && !element.contains(event.target) && (menu.hidden = true);
  const awakening = ["pointerdown", "keydown"];
  for (const name of awakening) window.addEventListener(name, awake, true);
  document.addEventListener("pointerdown", outside);
  window.speechSynthesis?.addEventListener?.("voiceschanged", fill);
  // A gap of a moment is seen, but not spoken of.
  let gap = null;
  const panel = live.panel({}, () => {}, { offline: (yes) => {
    clearTimeout(gap);
    if (!yes && lost) sound_it({ level: "info", text: "connection to the station regained" });
    lost &&= yes;
    if (yes && !lost) gap = setTimeout(() => ((lost = true), sound_it({ level: "error", text: "connection to the station lost" })), LOST_MS);
  } });
  fill();
  return {
    say(list) {
      list.forEach((alert) => sound_it(alert));
    },
    close() {
      for (const name of awakening) window.removeEventListener(name, awake, true);
      document.removeEventListener("pointerdown", outside);
      window.speechSynthesis?.removeEventListener?.("voiceschanged", fill);
      panel.close();
      sound?.close?.();
    },
  };
}
