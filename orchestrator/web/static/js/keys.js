// Keyframes: "key this pose", drag it in the view, put it some seconds ahead, and see what the planner makes of it.

import { send } from "./command.js";
import { attempt, byId, el, icon, jointWords, setText } from "./dom.js";
import { HANDLES, moveJoint } from "./keyfigure.js";
import { on, view } from "./store.js";

const LONGEST_S = 6;
const FIRST_S = 1.5;
const APART_S = 1;
const LEAST_S = 0.2;
const TICK_HZ = 30;

/** The joints of a key that are sent, by its choice `part`: "all", "dragged" or one joint. */
export function jointsOf(key, joints) {
  if (key.part === "all") return joints;
  return key.part === "dragged" ? joints.filter((joint) => key.dragged.has(joint)) : [key.part];
}

/** A key as the body of a command has it. */
export function keyframeOf(key, joints) {
  const round = (value) => Math.round(value * 1000) / 1000;
  const place = (joint) => Array.from(key.positions.slice(3 * joints.indexOf(joint), 3 * joints.indexOf(joint) + 3), round);
  const sent = jointsOf(key, joints);
  return { in_s: key.inS, positions_m: Object.fromEntries(sent.map((joint) => [joint, place(joint)])) };
}

/**
 * What a plan says of a key that is due at a tick: "honoured", "waiting" (the plan ends before it), or null when the plan
 * begins after it. `plan` is the data of an event of that name.
 */
export function saidByPlan(plan, tick) {
  if (!plan.accepted || plan.start_tick >= tick) return null;
  if (plan.ignored.includes("keyframes")) return "ignored";
  return plan.ignored.includes(`keyframes:${tick}`) ? "waiting" : "honoured";
}

const WORDS = {
  new: "not sent", sent: "sent", waiting: "beyond the plan so far", honoured: "honoured by the plan",
  ignored: "ignored: this planner takes no keyframes", missed: "passed, and no plan took it up",
};

function statusWords(key) {
  const off = key.offM === null ? "" : `, ${Math.round(key.offM * 100)} cm off when it was due`;
  return `${WORDS[key.status]}${off}`;
}

/** Wire the card; `figures` shows the keys. Returns the function for a drag of a joint of the selected key. */
export function setUpKeys(figures) {
  const { joints } = view.skeleton;
  let made = 0;

  const card = byId("keys-card");
  const shown = () => card.open && view.mode === "live" && view.watching?.kind === "character";
  const redraw = () => figures.show(shown() ? view.keys : [], view.key);

  function change(key, changes) {
    Object.assign(key, { status: "new", tick: null, offM: null }, changes);
    refresh();
  }

  function keyThePose() {
    if (view.frame === null) return;
    const last = Math.max(FIRST_S - APART_S, ...view.keys.map(({ inS }) => inS));
    made += 1;
    const key = {
      id: made, inS: Math.min(last + APART_S, LONGEST_S), part: "all", dragged: new Set(), status: "new", tick: null, offM: null,
      positions: Float32Array.from(view.frame.positions),
    };
    view.keys.push(key);
    view.key = key.id;
    refresh();
  }

  async function sendKeys() {
    const sent = view.keys.filter((key) => jointsOf(key, joints).length > 0);
    // What it does goes on: the keys are put into the command in force.
    const { text = null, target = null, heading_rad = null, velocity_mps = null } = view.command ?? {};
    const keyframes = sent.map((key) => keyframeOf(key, joints));
    const taken = await send({ text, target, heading_rad, velocity_mps, keyframes });
    const ignored = taken.ignored_conditions.includes("keyframes");
    for (const key of sent) {
      Object.assign(key, { status: ignored ? "ignored" : "sent", tick: taken.tick + Math.round(key.inS * TICK_HZ), offM: null });
    }
    for (const { type, data } of view.events) if (type === "plan") heed(data);
    refresh();
  }

  function heed(plan) {
    for (const key of view.keys) {
      if (key.tick === null || !["sent", "waiting"].includes(key.status)) continue;
      if (plan.start_tick < key.tick - Math.round(key.inS * TICK_HZ)) continue; // made before it was told
      key.status = saidByPlan(plan, key.tick) ?? key.status;
    }
  }

  function row(key, i) {
    const seconds = el("input", { type: "number", min: String(LEAST_S), max: String(LONGEST_S), step: "0.1",
      value: key.inS.toFixed(1), "aria-label": `Key ${i + 1}, seconds ahead`,
      onchange: () => change(key, { inS: within(Number(seconds.value)) }) });
    const part = el("select", { "aria-label": `Joints of key ${i + 1}`, onchange: () => change(key, { part: part.value }) },
      el("option", { value: "all" }, "whole pose"), el("option", { value: "dragged" }, "what I drag"),
      ...joints.map((name) => el("option", { value: name }, jointWords(name))));
    part.value = key.part;
    return el("li", { dataset: { status: key.status } },
      el("button", { type: "button", class: "quiet", "aria-pressed": String(view.key === key.id),
        onclick: () => { view.key = key.id; refresh(); } }, `Key ${i + 1}`),
      el("label", {}, "in ", seconds, " s"), part,
      el("button", { type: "button", class: "icon-button", "aria-label": `Remove key ${i + 1}`, onclick: () => {
        view.keys.splice(i, 1);
        if (view.key === key.id) view.key = view.keys.at(-1)?.id ?? null;
        refresh();
      } }, icon("close")),
      el("p", {}, statusWords(key)));
  }

  function marker(key, i) {
    const node = el("button", { type: "button", role: "slider", class: "key-marker", "aria-label": `Key ${i + 1} on the timeline`,
      "aria-valuemin": String(LEAST_S), "aria-valuemax": String(LONGEST_S), "aria-valuenow": key.inS.toFixed(1),
      "aria-pressed": String(view.key === key.id) }, String(i + 1));
    node.style.left = `${(100 * key.inS) / LONGEST_S}%`;
    node.addEventListener("pointerdown", (event) => drag(event, key));
    node.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -0.1, ArrowRight: 0.1 }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      view.key = key.id;
      change(key, { inS: within(key.inS + step) });
      byId("key-strip").children[i].focus();
    });
    return node;
  }

  /** The strip keeps the pointer, since its markers are made anew while one is drawn along it. */
  function drag(event, key) {
    const strip = byId("key-strip");
    const box = strip.getBoundingClientRect();
    view.key = key.id;
    strip.setPointerCapture(event.pointerId);
    const move = ({ clientX }) => change(key, { inS: within(((clientX - box.left) / box.width) * LONGEST_S) });
    const over = new AbortController();
    const until = { signal: over.signal };
    strip.addEventListener("pointermove", move, until);
    for (const end of ["pointerup", "pointercancel"]) strip.addEventListener(end, () => over.abort(), until);
  }

  function refresh() {
    byId("keys").replaceChildren(...view.keys.map(row));
    byId("key-strip").replaceChildren(...view.keys.map(marker));
    byId("send-keys").disabled = view.keys.every((key) => jointsOf(key, joints).length === 0);
    byId("key-timeline").hidden = view.keys.length === 0;
    redraw();
  }

  function told() {
    view.keys.forEach((key, i) => {
      const note = byId("keys").children[i];
      note.dataset.status = key.status;
      setText(note.querySelector("p"), statusWords(key));
    });
  }

  byId("key-pose").addEventListener("click", keyThePose);
  byId("send-keys").addEventListener("click", () => attempt(sendKeys));
  card.addEventListener("toggle", redraw);
  on("mode", redraw);
  on("watching", () => {
    view.keys.length = 0;
    view.key = null;
    refresh();
  });
  on("event", ({ type, data }) => {
    if (type !== "plan") return;
    heed(data);
    told();
  });
  on("frame", ({ frame }) => {
    for (const key of view.keys) {
      if (key.tick === null || key.offM !== null || frame.tick < key.tick) continue;
      key.offM = meanDistance(key, jointsOf(key, joints).map((name) => joints.indexOf(name)), frame.positions);
      if (["sent", "waiting"].includes(key.status)) key.status = "missed";
      told();
    }
  });
  refresh();

  return (joint, point) => {
    const key = view.keys.find(({ id }) => id === view.key);
    if (key === undefined || !HANDLES.includes(joint)) return;
    for (const name of moveJoint(joints, key.positions, joint, point)) key.dragged.add(name);
    change(key, {});
  };
}

function within(seconds) {
  return Math.round(Math.min(Math.max(seconds || LEAST_S, LEAST_S), LONGEST_S) * 10) / 10;
}

/** How far joints are from where a key has them, on average, in metres. */
function meanDistance({ positions }, indices, there) {
  const away = (i) => Math.hypot(...[0, 1, 2].map((k) => there[3 * i + k] - positions[3 * i + k]));
  return indices.reduce((sum, i) => sum + away(i), 0) / Math.max(indices.length, 1);
}
