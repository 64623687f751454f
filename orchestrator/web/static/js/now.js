// The panel "Now": what the character does, in words and numbers; and the badges over the view.

import { triesWords } from "./agenda.js";
import { byId, clock, jointWords, setText } from "./dom.js";
import { on, view } from "./store.js";

const WORDS = {
  connecting: "connecting", lost: "reconnecting", ended: "ended",
  running: "running", paused: "paused", degraded: "planner away", failed: "failed", created: "preparing",
  choosing: "between tasks", settling: "holding still", recovering: "back on its feet soon",
};
const REACHED_M = 0.3;

/** How far the joint of a target is from it, in metres; on the floor for the whole body. */
export function distanceTo(target, positions, joints) {
  const i = Math.max(0, joints.indexOf(target.joint));
  const flat = target.joint === "traj";
  const [x, y, z] = target.position_m;
  return Math.hypot(positions[3 * i] - x, positions[3 * i + 1] - y, flat ? 0 : positions[3 * i + 2] - z);
}

function doing() {
  if (view.mode === "replay") return "replaying an episode";
  if (view.watching?.kind === "episode") return view.task?.label ?? "preparing the episode";
  const { command } = view;
  if (command === null || command === undefined) return "waiting for a character";
  if (command.text) return command.text;
  if (command.target) return command.target.joint === "traj" ? "walking to the target" : "reaching for the target";
  return "moving as told";
}

function targetWords() {
  const target = view.mode === "live" ? view.command?.target : null;
  if (!target) return "none";
  const place = target.position_m.slice(0, target.joint === "traj" ? 2 : 3).map((value) => value.toFixed(2));
  const words = `${target.joint === "traj" ? "" : `${jointWords(target.joint)} `}(${place.join(", ")})`;
  if (view.frame === null || view.skeleton === null) return words;
  const away = distanceTo(target, view.frame.positions, view.skeleton.joints);
  return away <= REACHED_M ? `${words} reached` : `${words} ${away.toFixed(1)} m`;
}

/** How it is, in words: on its feet, getting up, at which try of a task. */
function stateWords(frame) {
  if (frame === null) return "-";
  if (gettingUp()) return "getting up";
  if (frame.fallen) return "fallen";
  const now = view.watching?.kind === "episode" ? view.agenda.find((item) => item.state === "now") : undefined;
  const of = now === undefined || now.retries === 0 ? "" : `, ${triesWords(now)}`;
  if (frame.status === "acting") return `acting${of}`;
  return WORDS[frame.status] ?? frame.status;
}

/** Whether the newest of the events that tell of it says that a fallen body is on its way up. */
function gettingUp() {
  const { status } = view.frame;
  if (view.mode !== "live" || (view.watching?.kind === "episode" && status !== "recovering")) return false;
  const told = view.events.findLast(({ type }) => ["getting_up", "stood_up", "reset", "task_begin"].includes(type));
  return told?.type === "getting_up";
}

/** Wire the panel. */
export function setUpNow() {
  const facts = {
    target: byId("fact-target"), state: byId("fact-state"), time: byId("fact-time"), place: byId("fact-position"),
  };
  let drawn = 0;
  function refresh() {
    setText(byId("doing"), doing());
    setText(facts.target, targetWords());
    const { frame } = view;
    setText(facts.state, stateWords(frame));
    setText(facts.time, frame === null ? "-" : clock(frame.tick / 30));
    const place = frame === null ? null : [frame.positions[0], frame.positions[1]];
    setText(facts.place, place === null ? "-" : `${place[0].toFixed(2)}, ${place[1].toFixed(2)} m`);
  }
  function badges() {
    const { frame, link, measured } = view;
    const badge = byId("link");
    const live = link === "live";
    const paused = frame?.paused === true;
    badge.dataset.state = view.mode === "replay" ? "paused" : live && paused ? "paused" : link;
    const rate = measured.updatesPerS === null || paused ? "" : ` ${Math.round(measured.updatesPerS)}/s`;
    const words = view.mode === "replay" ? "replay" : !live ? WORDS[link] : paused ? "paused" : `live${rate}`;
    setText(badge.lastElementChild, words);
    const condition = byId("condition");
    const trouble = view.mode === "replay" || frame === null ? null : troubleOf(frame);
    condition.hidden = trouble === null;
    if (trouble !== null) {
      condition.dataset.state = frame.fallen || frame.status === "failed" ? "bad" : "warn";
      setText(condition.lastElementChild, trouble);
      condition.title = frame.reason ?? "";
    }
  }
  on("frame", () => {
    const now = performance.now();
    if (now - drawn < 100) return;
    drawn = now;
    refresh();
    badges();
  });
  for (const topic of ["command", "watching", "mode", "link", "agenda"]) {
    on(topic, () => {
      refresh();
      badges();
    });
  }
}

function troubleOf(frame) {
  if (frame.status === "failed") return "failed";
  if (frame.fallen) return "fallen";
  if (frame.status === "degraded") return "planner away";
  return null;
}
