// The command box: history, suggestions, and targets that come from the 3D view or from numbers.

import { call } from "./api.js";
import { attempt, byId, el, jointWords, toast } from "./dom.js";
import { jointPosition, on, update, view } from "./store.js";

const HISTORY_KEY = "motionloop.history";
const KEPT = 50;
const IDEAS = [
  "walk forward", "wave with the right hand", "run", "turn left", "jump", "stand still",
  "walk in a circle", "walk backwards", "wave with both hands", "raise both arms", "walk slowly", "run forward fast",
];
const SHOWN_IDEAS = 5;
const STEER_MS = 100;
const REACHING = {
  left_wrist: "a person reaches out with the left hand.", right_wrist: "a person reaches out with the right hand.",
  left_foot: "a person lifts the left foot.", right_foot: "a person lifts the right foot.",
};

/** Send a command to the character shown; resolves to how it was taken, or throws what is wrong with it. */
export async function send(command) {
  const { watching } = view;
  if (watching?.kind !== "character") throw new Error("go back to the character to give it commands");
  return call("POST", `/v1/characters/${watching.id}/commands`, command);
}

/** What is worth a note of how a command was taken. */
function takenAs(taken) {
  const notes = [];
  if (taken.dropped.length > 0 || taken.steps.length > 1) notes.push(`Understood as: ${taken.understood}.`);
  if (taken.nearest !== null) notes.push(`It was trained on nothing like this; nearest: “${taken.nearest.text}”.`);
  return notes.join(" ");
}

/** Send a joint (null or `traj`: the whole body) to a point of the world. */
export async function sendTarget(joint, position) {
  const target = { joint: joint ?? "traj", position_m: position.map((value) => Math.round(value * 1000) / 1000) };
  await send({ text: REACHING[target.joint] ?? null, target });
}

/**
 * A function that sends a character where a drag goes: the newest place, one request at a time, ten a second at most.
 * It returns a promise of when the last place given was sent.
 */
export function makeSteering() {
  let wanted = null;
  let running = null;
  async function pump() {
    while (wanted !== null) {
      const [joint, position] = wanted;
      wanted = null;
      await sendTarget(joint, position);
      if (wanted !== null) await new Promise((resolve) => setTimeout(resolve, STEER_MS));
    }
  }
  return (joint, position) => {
    wanted = [joint, position];
    running ??= attempt(pump).finally(() => {
      running = null;
    });
    return running;
  };
}

/** Choose the limb that the next target is for. */
export function pickLimb(joint) {
  update("picked", { picked: joint });
}

/** Where a click on the floor sends the picked joint: above that place, at the height it has now. */
export function pointFor(joint, floorPoint) {
  if (joint === null) return [floorPoint.x, floorPoint.y, 0];
  const here = jointPosition(joint);
  return [floorPoint.x, floorPoint.y, Math.max(0.05, here === null ? 0.9 : here[2])];
}

/** Wire the form. */
export function setUpCommands() {
  const box = byId("say");
  const history = loadHistory();
  let place = history.length;
  let draft = "";

  async function say(text) {
    const words = text.trim();
    if (words === "") return;
    if (history.at(-1) !== words) history.push(words);
    localStorage.setItem(HISTORY_KEY, JSON.stringify(history.slice(-KEPT)));
    place = history.length;
    box.value = "";
    showIdeas("");
    await attempt(async () => {
      const note = takenAs(await send({ text: words }));
      if (note !== "") toast(note, "info");
    });
  }

  function showIdeas(typed) {
    const wanted = typed.trim().toLowerCase();
    const known = [...new Set([...IDEAS, ...history.slice(-KEPT).reverse()])];
    const found = wanted === "" ? IDEAS : known.filter((idea) => idea.toLowerCase().includes(wanted));
    const buttons = found
      .slice(0, SHOWN_IDEAS)
      .map((idea) => el("button", { type: "button", onclick: () => say(idea) }, idea));
    byId("ideas").replaceChildren(...buttons);
  }

  byId("command").addEventListener("submit", (event) => {
    event.preventDefault();
    say(box.value);
  });
  box.addEventListener("input", () => showIdeas(box.value));
  box.addEventListener("keydown", (event) => {
    if (event.key !== "ArrowUp" && event.key !== "ArrowDown") return;
    if (place === history.length) draft = box.value;
    const next = place + (event.key === "ArrowUp" ? -1 : 1);
    if (next < 0 || next > history.length) return;
    event.preventDefault();
    place = next;
    box.value = place === history.length ? draft : history[place];
    showIdeas(box.value);
  });
  byId("unpick").addEventListener("click", () => pickLimb(null));
  on("picked", () => {
    byId("picked").hidden = view.picked === null;
    if (view.picked !== null) {
      byId("picked").firstElementChild.textContent = `Click where the ${jointWords(view.picked)} should go`;
    }
  });
  showIdeas("");
}

/** The form under "Target by numbers": the same as clicking, for keyboards. */
export function setUpTargetForm(skeleton) {
  const form = byId("target");
  const joints = ["traj", ...skeleton.target_joints.filter((name) => name !== "traj")];
  byId("target-joint").replaceChildren(
    ...joints.map((name) => el("option", { value: name }, name === "traj" ? "whole body" : jointWords(name))),
  );
  form.elements.joint.addEventListener("change", () => {
    const here = jointPosition(form.elements.joint.value);
    if (here === null) return;
    [form.elements.x.value, form.elements.y.value, form.elements.z.value] = here.map((value) => value.toFixed(2));
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const { joint, x, y, z } = form.elements;
    attempt(() => sendTarget(joint.value, [x, y, z].map((input) => Number(input.value))));
  });
}

function loadHistory() {
  try {
    const found = JSON.parse(localStorage.getItem(HISTORY_KEY) ?? "[]");
    return Array.isArray(found) ? found.filter((item) => typeof item === "string") : [];
  } catch {
    return [];
  }
}
