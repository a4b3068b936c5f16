// The mission table: where it goes, what is behind it, what it flies to now.
import { live } from "./live.js";
import { DEG, el, icon, number, put } from "./draw.js";

export function mount(element) {
  element.classList.add("mf-column", "mf-mission");
  let rows = [], current = undefined, filled = 0, replay = false;
  const bar = el("div", { class: "mf-bar-fill" });
  const words = el("span", { class: "mf-dim" });
  const body = el("tbody");
  const table = el("table", { class: "mf-table" }, el("thead", {}, el("tr", {}, ...[["", ""], ["", ""], ["N", "m"], ["E", "m"], ["height", "m"], ["wait", "s"]].map(([text, unit]) => el("th", { scope: "col" }, text, el("br"), unit)))), body);
  const progress = el("div", { class: "mf-progress", role: "progressbar", "aria-label": "mission progress", "aria-valuemin": 0, "aria-valuemax": 100 }, el("div", { class: "mf-bar" }, bar), words);
  element.append(progress, el("div", { class: "mf-scroll", tabindex: 0 }, table));

  function fill() {
    const done = rows.filter((r) => r.reached).length;
    bar.style.transform = `scaleX(${rows.length ? done / rows.length : 0})`;
    progress.setAttribute("aria-valuenow", rows.length ? Math.round((100 * done) / rows.length) : 0);
    put(words, rows.length ? `${done} of ${rows.length} done` : "");
    body.replaceChildren(...rows.map((r, k) => {
      const now = k === current, state = now ? "here" : r.reached ? "ok" : "open";
      const [n, e, d] = r.p;
      return el("tr", { class: now ? "mf-now" : r.reached ? "mf-done" : "", "aria-current": now ? "step" : null },
        el("td", { title: now ? "current" : r.reached ? "reached" : "pending" }, icon(state)),
        el("td", {}, `${r.action}${r.heading !== null && r.heading !== undefined ? ` ${Math.round(r.heading * DEG)}°` : ""}${r.text ? `, ${r.text}` : ""}`),
        ...[n, e].map((x) => el("td", { class: "mf-num", text: x === null ? "" : number(x) })),
        el("td", { class: "mf-num", text: d === null ? "" : number(d === 0 ? 0 : -d) }), el("td", { class: "mf-num", text: r.wait ? number(r.wait, 1) : "" }));
    }));
    if (!rows.length) body.append(el("tr", {}, el("td", { colspan: 6, class: "mf-empty", text: "no mission in the vehicle; upload a mission" })));
  }
  const panel = live.panel({ sections: ["mission"] }, (f) => {
    const at = f.s ? f.s.waypoint : current;
    if (f.about) replay = Boolean(f.about.replay);
    if (f.new && !f.mission) rows = [];
    if (f.mission) rows = f.mission;
    const now = performance.now();
    if (f.mission || f.new || (at !== current && now - filled > 250)) {
      [current, filled] = [at, now];
      fill();
    }
  });
  fill();
  return { close: () => panel.close() };
}
