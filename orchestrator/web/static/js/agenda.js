// The tasks of the episode that is watched: which are done, which is being tried and for which time, what is to come.

import { call } from "./api.js";
import { attempt, byId, el } from "./dom.js";
import { on, update, view } from "./store.js";

const TITLE = {
  reach: "Walk to a point", halt: "Stand still", text: "Do what I say", strike: "Strike", sit: "Sit down",
  get_up: "Get up", velocity: "Keep a speed",
};

/** The name of a kind of task for people. */
export function titleOf(type) {
  return TITLE[type] ?? type;
}

/** "try 2 of 3". */
export function triesWords({ tries, retries }) {
  return `try ${tries} of ${retries + 1}`;
}

/** The tasks as the events of an episode left them, each with `state`: "to come", "now", "again", "done" or "missed". */
export function agendaOf(tasks, events) {
  const out = [];
  const add = (i, task) => {
    out[i] = { type: task.type, limb: task.limb ?? null, retries: task.retries ?? 0, state: "to come", tries: 0,
      reason: null };
  };
  tasks.forEach((task, i) => add(i, task));
  for (const { type, data } of events) {
    if (type === "task_inserted") add(data.index, data.task);
    const item = out[data.index];
    if (item === undefined) continue;
    if (type === "task_begin") Object.assign(item, { state: "now", tries: item.tries + 1 });
    else if (type === "task_missed") Object.assign(item, { state: "again", reason: data.reason });
    else if (type === "task_end") {
      Object.assign(item, { state: data.success_strict ? "done" : "missed", reason: data.reason ?? null });
    }
  }
  return out.filter((item) => item !== undefined);
}

function words(item) {
  const again = item.tries > 1 || (item.state === "again" && item.retries > 0);
  switch (item.state) {
    case "now": return again ? triesWords(item) : "now";
    case "again": return `missed (${item.reason}), tries again`;
    case "done": return again ? `done at try ${item.tries}` : "done";
    case "missed": return `not done: ${item.reason}`;
    default: return "to come";
  }
}

/** Wire the list in the panel "Now". */
export function setUpAgenda() {
  let tasks = [];

  function refresh() {
    const watched = view.watching?.kind === "episode" && view.mode === "live";
    update("agenda", { agenda: watched ? agendaOf(tasks, view.events) : [] });
    byId("agenda-card").hidden = view.agenda.length === 0;
    byId("agenda").replaceChildren(...view.agenda.map((item) => {
      const limb = item.limb === null ? "" : `, ${item.limb.replace("_", " ")}`;
      return el("li", { dataset: { state: item.state } }, el("b", {}, `${titleOf(item.type)}${limb}`),
        el("span", {}, words(item)));
    }));
  }

  on("watching", () => {
    tasks = [];
    refresh();
    const { kind, id } = view.watching ?? {};
    if (kind !== "episode") return;
    attempt(async () => {
      const { spec } = await call("GET", `/v1/episodes/${id}`);
      if (view.watching?.id !== id) return;
      tasks = spec.tasks;
      refresh();
    });
  });
  on("mode", refresh);
  on("event", ({ type }) => {
    if (type.startsWith("task_")) refresh();
  });
}
