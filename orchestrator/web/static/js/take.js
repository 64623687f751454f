// Files of the character shown: the part that was recorded, or the last minute.

import { download } from "./api.js";
import { attempt, byId, el, setText, toast } from "./dom.js";
import { on, view } from "./store.js";

const NAMES = { bvh: "BVH", glb: "glTF", npz: "npz", csv: "CSV", mp4: "MP4" };
const LAST_S = 60;
const LONGEST_S = { mp4: 120 };
const LONGEST_MOTION_S = 600;

function spanOf(format) {
  const now = view.frame.tick;
  const { recording } = view;
  const longest = LONGEST_S[format] ?? LONGEST_MOTION_S;
  const span = recording === null
    ? { seconds: Math.min(LAST_S, longest), stop: null }
    : { seconds: ((recording.stopTick ?? now) - recording.startTick + 1) / 30, stop: recording.stopTick };
  if (span.seconds > longest) throw new Error(`${NAMES[format]} holds at most ${longest} seconds: record less`);
  return span;
}

/** Wire the buttons; `formats` are those of motion that the server offers. */
export function setUpTake(formats) {
  const buttons = [...formats, "mp4"].map((format) => {
    const button = el("button", { type: "button", class: "quiet", "aria-label": `Download as ${NAMES[format]}`,
      onclick: () => {
        button.disabled = true;
        attempt(async () => {
          const { seconds, stop } = spanOf(format);
          const query = `seconds=${seconds.toFixed(4)}${stop === null ? "" : `&until_tick=${stop}`}`;
          if (format === "mp4") toast("Filming; this takes a moment.", "info");
          const file = format === "mp4" ? "video.mp4" : `motion.${format}`;
          await download(`/v1/characters/${view.watching.id}/${file}?${query}`, `character.${format}`);
        }).finally(() => {
          button.disabled = false;
        });
      } }, NAMES[format]);
    return button;
  });
  byId("take").replaceChildren(...buttons);

  function refresh() {
    const usable = view.watching?.kind === "character" && view.mode === "live" && view.frame !== null;
    for (const button of buttons) button.hidden = !usable;
    const { recording } = view;
    setText(byId("take-hint"), recording === null
      ? "The last minute of this character, or what you record."
      : recording.stopTick === null
        ? "Recording. Press Record again to stop."
        : `The ${((recording.stopTick - recording.startTick) / 30).toFixed(1)} seconds you recorded.`);
  }
  for (const topic of ["watching", "recording", "mode"]) on(topic, refresh);
  let ready = false;
  on("frame", () => {
    if (ready === (view.watching?.kind === "character")) return;
    ready = !ready;
    refresh();
  });
}
