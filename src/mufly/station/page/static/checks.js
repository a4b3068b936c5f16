// Pre-flight checks: a word and an icon each.
import { live } from "./live.js";
import { el, icon, put } from "./draw.js";

export function mount(element) {
  element.classList.add("mf-column");
  const head = el("p", { class: "mf-checks-head", role: "status" });
  const list = el("ul", { class: "mf-checks" });
  element.append(head, list);
  function fill(checks) {
    const bad = checks.filter(([, ok]) => ok === false).length, open = checks.filter(([, ok]) => ok === null).length;
    const rank = ([, ok]) => (ok === false ? 0 : ok === null ? 1 : 2);
    checks = [...checks].sort((a, b) => rank(a) - rank(b)); // what failed first, what cannot be judged next
    const failed = checks.slice(0, bad).map(([name]) => name).join(", ");
    put(head, !checks.length ? "No checks available." : bad ? `Not ready: ${failed} (${bad} of ${checks.length} failed)` : open ? `${open} undecided` : "Ready to fly");
    head.dataset.state = bad ? "bad" : open || !checks.length ? "open" : "good";
    list.replaceChildren(...checks.map(([name, ok, text]) => el("li", { class: ok === false ? "mf-level-error" : ok ? "mf-level-ok" : "" },
      icon(ok === false ? "error" : ok ? "ok" : "open"), el("div", {}, el("strong", { text: `${name}: ${ok === false ? "failed" : ok ? "ok" : "unknown"}` }), el("div", { class: "mf-dim", text })))));
  }
  const panel = live.panel({ sections: ["checks"] }, (f) => {
    if (f.checks) fill(f.checks);
    else if (f.new) fill([]);
  });
  fill([]);
  return { close: () => panel.close() };
}
