// What a "title" says, in a box of the page's own below its toasts: the browser's would lie on top of everything.
const WAIT_MS = 450;

export function mount(element) {
  element.hidden = true;
  const box = document.createElement("div");
  box.className = "mf-hint";
  box.hidden = true;
  document.body.append(box);
  let over = null, words = "", timer = null;

  function leave() {
    clearTimeout(timer);
    box.hidden = true;
    if (over && !over.hasAttribute("title")) over.setAttribute("title", words);
    over = null;
  }
  function show() {
    if (!over?.isConnected) return leave();
    const at = over.getBoundingClientRect();
    box.textContent = words;
    box.hidden = false;
    const { offsetWidth: w, offsetHeight: h } = box, below = at.bottom + 6 + h < innerHeight;
    box.style.left = `${Math.max(8, Math.min(innerWidth - w - 8, at.left + at.width / 2 - w / 2))}px`;
    box.style.top = `${Math.max(8, below ? at.bottom + 6 : at.top - h - 6)}px`;
  }
  function enter(event) {
    if (over?.contains(event.target)) return;
    leave();
    const found = event.target.closest?.("[title]");
    if (!found || !(words = found.getAttribute("title"))) return;
    over = found;
    over.removeAttribute("title");
    timer = setTimeout(show, WAIT_MS);
  }
  const listeners = [["mouseover", enter], ["mouseleave", leave], ["pointerdown", leave], ["keydown", leave], ["scroll", leave]];
  for (const [name, act] of listeners) document.addEventListener(name, act, true);
  return {
    close() {
      leave();
      box.remove();
      for (const [name, act] of listeners) document.removeEventListener(name, act, true);
    },
  };
}
