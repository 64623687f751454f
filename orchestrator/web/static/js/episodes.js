// The list of recorded episodes: how they went, replay, files.

import { call, download } from "./api.js";
import { attempt, byId, el, toast } from "./dom.js";
import { on, view } from "./store.js";
import { showTab } from "./tabs.js";

const PAGE = 10;
const FILES = { bvh: "BVH", glb: "glTF", npz: "npz", csv: "CSV" };

/** The motion formats the server offers, from its own description of itself. */
export async function offeredFormats() {
  const document = await call("GET", "/openapi.json");
  const path = Object.entries(document.paths).find(([name]) => name.startsWith("/v1/episodes/{episode_id}/motion."));
  const parameter = path?.[1].get.parameters.find(({ name }) => name === "suffix");
  return Object.keys(FILES).filter((format) => parameter?.schema.enum?.includes(format));
}

/** Wire the panel. `session` shows a running episode, `replay` plays one that is over. */
export function setUpEpisodes(session, replay, formats) {
  let shown = PAGE;

  async function refresh() {
    const { items, total } = await call("GET", `/v1/episodes?limit=${shown}`);
    byId("episodes").replaceChildren(...items.map((item) => row(item)));
    byId("episodes-empty").hidden = items.length > 0;
    byId("more").hidden = total <= items.length;
  }

  function row(item) {
    const running = item.status === "running";
    const current = view.watching?.id === item.id || replay.id === item.id;
    const labels = item.results.map((result) =>
      el("span", { class: "outcome", dataset: { ok: String(result.success_strict) }, title: result.reason ?? "" },
        result.label));
    if (labels.length === 0) labels.push(...item.spec.tasks.map((task) => el("span", { class: "outcome" }, task.type)));
    const act = (words, work) => el("button", { type: "button", class: "quiet", onclick: (event) => {
      event.target.disabled = true;
      attempt(work).finally(() => { event.target.disabled = false; });
    } }, words);
    const buttons = running
      ? [act("Watch", () => session.watch({ kind: "episode", id: item.id })),
        act("Cancel", () => call("DELETE", `/v1/episodes/${item.id}`))]
      : [act("Replay", () => replay.open(item.id, titleOf(item))), ...formats.map((format) =>
        act(FILES[format], () => download(`/v1/episodes/${item.id}/motion.${format}`, `episode.${format}`))),
      act("MP4", async () => {
        toast("Filming the episode; this takes a moment.", "info");
        await download(`/v1/episodes/${item.id}/video.mp4`, "episode.mp4");
      })];
    return el("li", { dataset: { current: String(current), id: item.id } },
      el("div", { class: "head" }, el("b", {}, titleOf(item)), el("span", {}, whenOf(item))),
      el("div", { class: "outcomes" }, ...labels),
      el("div", { class: "row" }, ...buttons));
  }

  byId("refresh").addEventListener("click", () => attempt(refresh));
  byId("more").addEventListener("click", () => {
    shown += PAGE;
    attempt(refresh);
  });
  on("tab", (name) => {
    if (name === "episodes") attempt(refresh);
  });
  on("episode-ended", (id) =>
    attempt(async () => {
      const item = await call("GET", `/v1/episodes/${id}`);
      const done = item.results.filter((result) => result.success_strict).length;
      toast(`Episode ${item.status}: ${done} of ${item.spec.tasks.length} tasks done`, "info");
      showTab("episodes");
    }),
  );
}

function titleOf(item) {
  if (item.spec.name) return item.spec.name;
  const count = item.spec.tasks.length;
  return `${count} ${count === 1 ? "task" : "tasks"}, ${item.status}`;
}

function whenOf(item) {
  const when = new Date(item.created_s * 1000);
  const today = when.toDateString() === new Date().toDateString();
  const time = when.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
  return today ? time : `${when.toLocaleDateString()} ${time}`;
}
