// The slider of a recording: play, pause, speed, any moment.
import { live } from "./live.js";
import { clock, el, put } from "./draw.js";

export function mount(element, options, emit) {
  element.classList.add("mf-replay");
  const play = el("button", { type: "button", class: "mf-play", "data-key": " ", onclick: () => emit("replay", { play: !playing }) });
  const slider = el("input", { type: "range", min: 0, max: 1, step: "any", value: 0, "aria-label": "moment of the recording", "data-testid": "replay-slider" });
  const speed = el("select", { "aria-label": "speed of play", onchange: () => emit("replay", { speed: Number(speed.value) }) },
    ...[0.25, 0.5, 1, 2, 4, 8].map((x) => el("option", { value: x, text: `${x}×` })));
  speed.value = "1";
  const time = el("span", { class: "mf-num" }), name = el("strong");
  const close = el("button", { type: "button", text: "Close recording", onclick: () => emit("replay", { close: true }) });
  element.append(play, slider, time, speed, name, close);
  let playing = false, held = false, waiting = null;
  const seek = () => {
    waiting = null;
    emit("replay", { seek: Number(slider.value) });
  };
  slider.addEventListener("input", () => {
    held = true;
    if (waiting === null) waiting = setTimeout(seek, 60);
  });
  slider.addEventListener("change", () => (held = false));
  const panel = live.panel({}, (f) => {
    const r = f.about?.replay;
    element.parentElement.hidden = !r;
    document.body.classList.toggle("mf-replaying", Boolean(r));
    if (!r) return;
    playing = r.playing;
    put(play, playing ? "❚❚" : "▶");
    play.setAttribute("aria-label", playing ? "pause" : "play");
    slider.min = r.from;
    slider.max = r.to;
    if (!held && waiting === null) slider.value = r.t;
    slider.setAttribute("aria-valuetext", clock(r.t));
    put(time, `${clock(r.t)} / ${clock(r.to)}`);
    if (document.activeElement !== speed) speed.value = String(r.speed);
    put(name, r.name);
  });
  return { close: () => panel.close() };
}
