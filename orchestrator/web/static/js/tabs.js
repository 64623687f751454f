// The panels as tabs (arrow keys go from one to the next), and the sheet's height on a phone.

import { byId } from "./dom.js";
import { emit } from "./store.js";

const NAMES = ["now", "tasks", "episodes", "services"];

/** Show a panel. */
export function showTab(name) {
  for (const other of NAMES) {
    const tab = byId(`tab-${other}`);
    tab.setAttribute("aria-selected", String(other === name));
    tab.tabIndex = other === name ? 0 : -1;
    byId(`pane-${other}`).hidden = other !== name;
  }
  emit("tab", name);
}

/** Wire the tabs. */
export function setUpTabs() {
  NAMES.forEach((name, i) => {
    const tab = byId(`tab-${name}`);
    tab.addEventListener("click", () => showTab(name));
    tab.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      const goal = event.key === "Home" ? 0 : event.key === "End" ? NAMES.length - 1 : step === undefined ? null : i + step;
      if (goal === null) return;
      event.preventDefault();
      const next = NAMES[(goal + NAMES.length) % NAMES.length];
      showTab(next);
      byId(`tab-${next}`).focus();
    });
  });
  const handle = byId("sheet");
  handle.addEventListener("click", () => {
    const tall = byId("panel").classList.toggle("tall");
    handle.setAttribute("aria-expanded", String(tall));
  });
}
