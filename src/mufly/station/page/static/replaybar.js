// The slider of a recording: play, pause, speed, any moment.
import { live } from "./live.js";
import { clock, el, put } from "./draw.js";

export function mount(element, options, emit) {
  element.classList.add("mf-replay");
  const play = el("button", { type: "button", class: "mf-play", "data-key": " ", onclick: () => emit("replay", { play: !playing }) });
  const slider = el("input", { type: "range", min: 0, max: 1, step: "any", value: 0, "aria-label": "playback position", "data-testid": "replay-slider" });
  const speed = el("select", { "aria-label": "playback speed", onchange: () => emit("replay", { speed: Number(speed.value) }) },
    ...[0.25, 0.5, 1, 2, 4, 8].map((x) => el("option", { value: x, text: `${x}×` })));
  speed.value = "1";
  const time = el("span", { class: "mf-num" }), name = el("strong");
  const close = el("button", { type: "button", text: "Close recording", onclick: () => emit("replay", { close: true }) });
  const by = el("select", { "aria-label": "aligned by", "data-testid": "compare-by", onchange: () => emit("replay", { by: by.value }) }, ...["take-off", "arming", "start", "clock"].map((word) => el("option", { value: word, text: word })));
  const offset = el("input", { type: "number", step: 0.1, value: 0, "aria-label": "time offset (s)", "data-testid": "compare-offset", onchange: () => Number.isFinite(parseFloat(offset.value)) && emit("replay", { offset: parseFloat(offset.value) }) });
  const other = el("strong", { class: "mf-compared-name" }), noted = el("span", { class: "mf-dim" });
  const beside = el("div", { class: "mf-compare", hidden: true, "data-testid": "compare" }, el("span", { class: "mf-dim", text: "compared with" }), other, el("label", { class: "mf-dim" }, "aligned by ", by), el("label", { class: "mf-dim" }, "offset ", offset, " s"), noted, el("button", { type: "button", text: "✕", title: "show the first recording alone", "aria-label": "show the first recording alone", onclick: () => emit("replay", { alone: true }) }));
  element.append(play, slider, time, speed, name, close, beside);
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
    const c = f.about.compared;
    beside.hidden = !c;
    if (!c) return;
    put(other, c.name);
    put(noted, c.note);
    if (document.activeElement !== by) by.value = c.by;
    if (document.activeElement !== offset) offset.value = String(c.offset);
  });
  return { close: () => panel.close() };
}
