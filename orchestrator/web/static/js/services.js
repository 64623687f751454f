// Planner and tracker: how they are, and which plug-in is in use. Also the choice of a new character.

import { call } from "./api.js";
import { attempt, byId, el, setText, toast } from "./dom.js";
import { on, update, view } from "./store.js";

const KINDS = ["planner", "tracker"];
const EVERY_MS = 1500;
const TITLE = { planner: "Planner", tracker: "Tracker" };
const WORDS = { ok: "answers", degraded: "degraded", away: "away" };

/** Wire the panel; `session` makes and ends characters. */
export async function setUpServices(session) {
  const cards = Object.fromEntries(KINDS.map((kind) => [kind, makeCard(kind)]));
  byId("services").replaceChildren(...KINDS.map((kind) => cards[kind].root));

  async function refreshServices() {
    const services = await call("GET", "/v1/services");
    update("services", { services });
    for (const kind of KINDS) showChoices(cards[kind], services[kind]);
  }

  async function refreshHealth() {
    let health;
    try {
      health = await call("GET", "/v1/services/health");
    } catch {
      return; // the badge over the view says that the server is away
    }
    update("health", { health });
    for (const kind of KINDS) showHealth(cards[kind], health[kind]);
    byId("tab-services").querySelector(".dot").hidden = KINDS.every((kind) => health[kind].status === "ok");
    if (KINDS.some((kind) => view.services?.[kind].plugin !== health[kind].plugin)) await refreshServices();
  }

  async function loop() {
    if (!document.hidden) await attempt(refreshHealth);
    setTimeout(loop, EVERY_MS);
  }

  function swap(kind, plugin) {
    const { select } = cards[kind];
    select.disabled = true;
    return attempt(async () => {
      await call("PUT", `/v1/services/${kind}`, { plugin });
      toast(`${TITLE[kind]} is now ${plugin}`, "info");
    }).finally(async () => {
      select.disabled = false;
      await attempt(refreshServices);
    });
  }

  for (const kind of KINDS) cards[kind].select.addEventListener("change", (event) => swap(kind, event.target.value));
  on("swapped", () => attempt(refreshServices));
  setUpFresh(session);
  await refreshServices();
  loop();
}

function makeCard(kind) {
  const lamp = el("i", { class: "lamp" });
  const state = el("span", { role: "status" }, "-");
  const select = el("select", { id: `pick-${kind}`, "aria-label": `Plug-in of the ${kind}` });
  const note = el("p", { class: "service-note" });
  const root = el(
    "div",
    { class: "card", id: `card-${kind}` },
    el("div", { class: "service-head" }, lamp, el("b", {}, TITLE[kind]), state),
    select,
    note,
  );
  return { root, lamp, state, select, note };
}

function showChoices({ select }, service) {
  select.replaceChildren(...service.plugins.map((name) => el("option", { value: name }, name)));
  select.value = service.plugin;
}

function showHealth({ lamp, state, note }, health) {
  lamp.dataset.state = health.status;
  setText(state, health.status === "away" || health.latency_ms === null
    ? WORDS[health.status]
    : `${WORDS[health.status]} in ${health.latency_ms.toFixed(0)} ms`);
  setText(note, health.message ?? health.endpoint);
}

function setUpFresh(session) {
  const form = byId("fresh");
  attempt(async () => {
    const { items } = await call("GET", "/v1/scenes");
    for (const id of ["fresh-scene", "episode-scene"]) {
      byId(id).replaceChildren(...items.map(({ name }) => el("option", { value: name }, name)));
      byId(id).value = "flat";
    }
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const { scene, seed } = form.elements;
    attempt(() => session.create({ scene: scene.value, seed: Number(seed.value) }));
  });
  byId("end").addEventListener("click", () => {
    if (view.watching?.kind !== "character") return;
    attempt(() => call("DELETE", `/v1/characters/${view.watching.id}`));
  });
}
