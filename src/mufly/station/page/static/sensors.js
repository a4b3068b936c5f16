// What the estimator thinks of each sensor: fused or not, and by how much it misses.
import { live } from "./live.js";
import { el, icon, number, put } from "./draw.js";

const GOOD = { fused: true, rejected: false, faulty: false, missing: false, waiting: null };
const SAID = {
  fused: "fused",
  rejected: "rejected: innovation too large",
  faulty: "faulty",
  missing: "missing: no measurements",
  waiting: "waiting: not yet measured, or not needed",
};

export function mount(element) {
  element.classList.add("mf-column");
  const head = el("p", { class: "mf-checks-head", role: "status" });
  const list = el("ul", { class: "mf-checks" });
  element.append(head, list);
  function fill(sensors) {
    const bad = sensors.filter(([, status]) => GOOD[status] === false).length;
    put(head, !sensors.length ? "No sensor status reported." : bad ? `${bad} of ${sensors.length} sensors not fused` : "All sensors fused");
    head.dataset.state = bad ? "bad" : sensors.length ? "good" : "open";
    list.replaceChildren(...sensors.map(([name, status, ratio, why]) => {
      const ok = GOOD[status];
      return el("li", { class: ok === false ? "mf-level-error" : ok ? "mf-level-ok" : "", "data-status": status },
        icon(ok === false ? "error" : ok ? "ok" : "open"),
        el("div", {}, el("strong", { text: name }), el("div", { class: "mf-dim", text: `${SAID[status]}; last innovation ${number(Math.abs(ratio), 1)} σ` }),
          why ? el("div", { text: why, "data-testid": "sensor-reason" }) : null));
    }));
  }
  const panel = live.panel({ sections: ["sensors"] }, (f) => {
    if (f.sensors) fill(f.sensors);
    else if (f.new) fill([]);
  });
  fill([]);
  return { close: () => panel.close() };
}
