// The list of characters that are there, to look at another one.

import { call } from "./api.js";
import { attempt, byId, el } from "./dom.js";
import { on, view } from "./store.js";

const EVERY_MS = 5000;

/** Wire the picker over the view. */
export function setUpCharacters(session) {
  const select = byId("characters");

  async function refresh() {
    const { items } = await call("GET", "/v1/characters");
    const { watching } = view;
    const options = items.map((item, i) =>
      el("option", { value: item.id }, `Character ${i + 1}${item.scene === "flat" ? "" : `, ${item.scene}`}`),
    );
    if (watching?.kind === "episode") options.unshift(el("option", { value: "" }, "Episode"));
    select.replaceChildren(...options, el("option", { value: "new" }, "New character"));
    select.value = watching?.kind === "character" ? watching.id : "";
  }

  select.addEventListener("change", () =>
    attempt(async () => {
      if (select.value === "new") await session.create({});
      else if (select.value !== "") {
        const { items } = await call("GET", "/v1/characters");
        const found = items.find((item) => item.id === select.value);
        if (found !== undefined) session.watch({ kind: "character", id: found.id }, found);
      }
    }),
  );
  select.addEventListener("focus", () => attempt(refresh));
  on("watching", () => attempt(refresh));
  setInterval(() => {
    if (!document.hidden && document.activeElement !== select) refresh().catch(() => undefined);
  }, EVERY_MS);
}
