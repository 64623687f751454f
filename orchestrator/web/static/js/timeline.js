// The last half minute of the character's state machine: states, commands or tasks, and what happened.

import { byId, clock, el } from "./dom.js";
import { titleOf } from "./agenda.js";
import { on, view } from "./store.js";
import { fitted, palette } from "./paint.js";

const WINDOW_TICKS = 30 * 30;
const NEXT = {
  created: "running", paused: "paused", resumed: "running", degraded: "degraded", recovered: "running",
  failed: "failed", fallen: "fallen", stood: "running", reset: "running", getting_up: "getting up", stood_up: "running",
};
const COLOUR = {
  running: "accent", acting: "accent", settling: "good", choosing: "muted", created: "muted", paused: "warn",
  degraded: "warn", recovering: "warn", "getting up": "warn", fallen: "bad", failed: "bad", finished: "good", cancelled: "muted",
};
const MARKS = {
  task_missed: "missed", getting_up: "gets up", impulse: "push", reset: "reset", swap: "swap", fallen: "fell", paused: "pause", degraded: "planner away",
  planner_lost: "planner away", recovered: "planner back", planner_back: "planner back", stepped: "step",
};

/** State segments [{ name, from, to }] from the events of a character or an episode, up to `now`. */
export function stateSegments(events, now) {
  const out = [];
  for (const event of events) {
    const name = event.type === "state" ? event.data.after : NEXT[event.type];
    if (name === undefined) continue;
    const last = out.at(-1);
    if (last !== undefined) last.to = event.tick;
    if (last?.name !== name) out.push({ name, from: event.tick, to: now });
  }
  if (out.length > 0) out.at(-1).to = now;
  return out;
}

/** What it was told, as segments with labels. */
export function orderSegments(events, now) {
  const out = [];
  for (const { type, tick, data } of events) {
    let label = null;
    if (type === "command") label = data.text ?? (data.target ? "to the target" : "moving");
    else if (type === "task_begin") label = data.label;
    else if (type === "reset") label = "stand";
    else if (type !== "task_end") continue;
    if (out.length > 0 && out.at(-1).to === now) out.at(-1).to = tick;
    if (label !== null) out.push({ label, from: tick, to: now });
  }
  return out;
}

/** An event in a few words for the list, or null for those of no interest to people. */
export function eventWords({ type, data }) {
  const told = data.text ?? (data.target ? `target (${data.target.position_m.map((v) => v.toFixed(1)).join(", ")})` : "");
  switch (type) {
    case "command": return `told: ${told}`;
    case "task_begin": return `begins: ${data.label}`;
    case "task_missed": return `missed (${data.reason}), tries again`;
    case "task_inserted": return `added: ${titleOf(data.task.type).toLowerCase()}`;
    case "getting_up": return "gets up by itself";
    case "stood_up": return "stands again";
    case "task_end": return `${data.success_strict ? "done" : `not done (${data.reason})`}: ${data.label}`;
    case "state": return `${data.before} to ${data.after}`;
    case "impulse": return `pushed at the ${data.body.replace("_", " ")}, ${Math.round(Math.hypot(...data.impulse_ns))} N s`;
    case "swap": return `${data.service} is now ${data.plugin}`;
    case "degraded": case "planner_lost": return "the planner is away";
    case "recovered": case "planner_back": return "the planner is back";
    case "stood": return "stands again";
    case "fallen": return "fell";
    case "failed": case "physics_failed": case "plan_refused": return data.reason ?? data.message;
    case "created": case "paused": case "resumed": case "reset": case "stepped": return type;
    default: return null;
  }
}

/** Wire the timeline. */
export function setUpTimeline() {
  const canvas = byId("timeline");
  let drawn = 0;
  function refresh() {
    if (canvas.offsetParent === null || view.mode === "replay") return;
    drawn = performance.now();
    draw(canvas, view.events, view.frame?.tick ?? 0);
  }
  function list() {
    const items = [];
    for (let i = view.events.length - 1; i >= 0 && items.length < 4; i--) {
      const event = view.events[i];
      const words = eventWords(event);
      if (words === null) continue;
      items.push(el("li", {}, el("time", {}, clock(event.tick / 30)), el("span", { title: words }, words)));
    }
    byId("happened").replaceChildren(...items);
    refresh();
  }
  on("frame", () => {
    if (performance.now() - drawn > 120) refresh();
  });
  on("event", ({ type }) => {
    if (type !== "plan" && type !== "progress") list();
  });
  on("watching", list);
  on("tab", refresh);
}

function draw(canvas, events, now) {
  const { context: g, width, height } = fitted(canvas);
  const colours = palette();
  const first = now - WINDOW_TICKS;
  const x = (tick) => ((Math.max(tick, first) - first) / WINDOW_TICKS) * width;
  g.clearRect(0, 0, width, height);
  g.font = "11px system-ui, sans-serif";
  g.textBaseline = "middle";

  const lane = (segments, top, tall, paint) => {
    for (const segment of segments) {
      if (segment.to < first) continue;
      const left = x(segment.from);
      paint(segment, left, top, Math.max(x(segment.to) - left - 1, 1), tall);
    }
  };
  lane(stateSegments(events, now), 2, 18, (segment, left, top, wide, tall) => {
    const colour = colours[COLOUR[segment.name] ?? "muted"];
    box(g, left, top, wide, tall, colour, segment.name === "running" ? 0.22 : 0.34);
    label(g, segment.name, left, top, wide, tall, colours.text);
  });
  lane(orderSegments(events, now), 24, 22, (segment, left, top, wide, tall) => {
    box(g, left, top, wide, tall, colours.muted, 0.16);
    label(g, segment.label, left, top, wide, tall, colours.text);
  });
  for (const { type, tick } of events) {
    if (tick < first) continue;
    if (type === "plan") {
      g.fillStyle = colours.muted;
      g.globalAlpha = 0.7;
      g.fillRect(x(tick), 52, 1.5, 5);
    } else if (type in MARKS) {
      g.fillStyle = type === "fallen" ? colours.bad : colours.accent;
      g.globalAlpha = 1;
      g.beginPath();
      g.arc(x(tick), 54.5, 3.2, 0, 2 * Math.PI);
      g.fill();
    }
  }
  g.globalAlpha = 1;
  g.fillStyle = colours.line;
  g.fillRect(0, 62, width, 1);
  g.fillStyle = colours.muted;
  for (let seconds = 0; seconds <= 30; seconds += 10) {
    const words = seconds === 0 ? "now" : `-${seconds} s`;
    g.textAlign = seconds === 0 ? "right" : seconds === 30 ? "left" : "center";
    g.fillText(words, width * (1 - seconds / 30), 74);
  }
  g.textAlign = "left";
}

function box(g, left, top, wide, tall, colour, strength) {
  g.globalAlpha = strength;
  g.fillStyle = colour;
  g.beginPath();
  g.roundRect(left, top, wide, tall, Math.min(4, wide / 2));
  g.fill();
  g.globalAlpha = 1;
}

function label(g, words, left, top, wide, tall, colour) {
  if (wide < 26) return;
  let text = words;
  while (text.length > 1 && g.measureText(text).width > wide - 10) text = `${text.replace(/…$/, "").slice(0, -1)}…`;
  g.fillStyle = colour;
  g.fillText(text, left + 6, top + tall / 2 + 0.5);
}
