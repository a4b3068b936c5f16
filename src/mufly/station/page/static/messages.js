// What the vehicle said; the level is an icon and a word, and can be filtered.
import { live } from "./live.js";
import { clock, el, icon } from "./draw.js";

const MOST = 500, RANK = { info: 0, warning: 1, error: 2 };

export function mount(element) {
  element.classList.add("mf-column");
  let all = [], least = 0, words = "";
  const level = el("select", { "aria-label": "lowest level shown", onchange: () => {
    least = Number(level.value);
    fill();
  } }, el("option", { value: 0, text: "all" }), el("option", { value: 1, text: "warnings and errors" }), el("option", { value: 2, text: "errors" }));
  const search = el("input", { type: "search", placeholder: "filter text", "aria-label": "filter messages by text", oninput: () => {
    words = search.value.toLowerCase();
    fill();
  } });
  const list = el("ol", { class: "mf-messages", role: "log", "aria-live": "polite", tabindex: 0, "aria-label": "messages" });
  element.append(el("div", { class: "mf-tools" }, level, search), list);
  const row = ([time, kind, text]) => el("li", { class: `mf-level-${kind}` }, el("span", { class: "mf-num mf-dim", text: clock(time ?? NaN) }), icon(kind), el("span", {}, kind === "info" ? "" : `${kind}: `, text));
  const shown = ([, kind, text]) => (RANK[kind] ?? 0) >= least && text.toLowerCase().includes(words);
  function fill() {
    const kept = all.filter(shown);
    list.replaceChildren(...(kept.length ? kept.map(row) : [el("li", { class: "mf-empty", text: all.length ? "no message matches the filter" : "no messages yet" })]));
    list.scrollTop = list.scrollHeight;
  }
  const panel = live.panel({ sections: ["messages"] }, (f) => {
    if (f.new || f.messages_new) {
      all = [];
      if (!f.messages) fill();
    }
    if (!f.messages) return;
    all.push(...f.messages);
    if (all.length > MOST || all.length === f.messages.length) {
      all = all.slice(-MOST);
      fill();
      return;
    }
    const atEnd = list.scrollTop + list.clientHeight > list.scrollHeight - 30;
    list.append(...f.messages.filter(shown).map(row));
    if (atEnd) list.scrollTop = list.scrollHeight;
  });
  fill();
  return { close: () => panel.close() };
}
