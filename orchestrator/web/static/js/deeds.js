// What can be done with the things of a scene: a click on a seat sits down on it, one on the bag hits it.

import { call } from "./api.js";
import { attempt, byId, el } from "./dom.js";
import { jointPosition, on, view } from "./store.js";

const LIMBS = ["left_hand", "right_hand", "left_foot", "right_foot"];
const LIMB_OF = { left_wrist: "left_hand", right_wrist: "right_hand", left_foot: "left_foot", right_foot: "right_foot" };
const RETRIES = 2;
const FOOT_BELOW_M = 0.5;
const SITS_OVER_M = 0.3; // so much above the seat's top a pelvis is on it
const BESIDE_M = 0.2;

/** What the bodies of a scene are for: [{ body, mark, does: "sit" | "strike" }]. */
export function usesOf(scene) {
  const bodies = new Map((scene?.bodies ?? []).map((body) => [body.name, body]));
  const marks = Object.entries(scene?.marks ?? {}).filter(([, mark]) => mark.body !== null);
  const names = new Set(marks.map(([name]) => name));
  return marks.flatMap(([mark, { body, half_size_m: area }]) => {
    const kin = (end, other) => mark.endsWith(end) && names.has(`${mark.slice(0, -end.length)}${other}`);
    if (kin("_front", "_centre")) return [];
    if (area || kin("_centre", "_front")) return [{ body, mark, does: "sit" }];
    return bodies.get(body)?.motion === "fixed" ? [] : [{ body, mark, does: "strike" }];
  });
}

/** Where a mark is now, [x, y, z] in metres, given the pose of its body ({ position, quaternion } of three.js). */
function placeOf(scene, name, pose) {
  const [x, y, z] = scene.marks[name].position_b_m;
  return pose.position.clone().set(x, y, z).applyQuaternion(pose.quaternion).add(pose.position).toArray();
}

/** Wire the row over the command box; returns the function for a click on a body of the scene, by name. */
export function setUpDeeds(session, objects) {
  let uses = [];
  const limb = el("select", { "aria-label": "Hit with" }, el("option", { value: "" }, "any limb"),
    ...LIMBS.map((name) => el("option", { value: name }, name.replace("_", " "))));

  function place(use) {
    const pose = objects.poseOf(use.body);
    return pose === null ? null : placeOf(view.scene, use.mark, pose);
  }

  function seatedOn(use) {
    const seat = place(use);
    const pelvis = jointPosition("pelvis");
    if (seat === null || pelvis === null || view.watching?.kind !== "episode") return false;
    const reach = Math.max(...(view.scene.marks[use.mark].half_size_m ?? [0.3])) + BESIDE_M;
    const over = Math.hypot(pelvis[0] - seat[0], pelvis[1] - seat[1]) < reach;
    return over && pelvis[2] - seat[2] < SITS_OVER_M;
  }

  /** The limb that was chosen, else the hand on the side of the bag; a foot for what is low. */
  function limbFor(use) {
    const picked = LIMB_OF[view.picked] ?? limb.value;
    if (picked !== "") return picked;
    const there = place(use);
    const [left, right] = [jointPosition("left_hip"), jointPosition("right_hip")];
    if (there === null || left === null) return "right_hand";
    const away = (joint) => Math.hypot(joint[0] - there[0], joint[1] - there[1]);
    return `${away(left) < away(right) ? "left" : "right"}_${there[2] < FOOT_BELOW_M ? "foot" : "hand"}`;
  }

  function taskOf(use) {
    if (use.does === "strike") return { type: "strike", mark: use.mark, limb: limbFor(use) };
    return { type: seatedOn(use) ? "get_up" : "sit", mark: use.mark };
  }

  async function perform(task) {
    const { watching } = view;
    if (watching === null) return;
    const given = { ...task, retries: RETRIES };
    if (watching.kind === "episode") {
      await call("POST", `/v1/episodes/${watching.id}/insert`, { task: given, place: 0 });
      return;
    }
    // The same room, as its seed made it, with a fresh body in it.
    const { items } = await call("GET", "/v1/characters");
    const { planner, tracker, seed } = items.find(({ id }) => id === watching.id) ?? {};
    const scene = { ...view.scene, bodies: view.scene.bodies.map((body) => ({ ...body, random: null })) };
    const spec = { scene, planner, tracker, seed, pacing: "realtime", on_fall: "get_up", tasks: [given] };
    const made = await call("POST", "/v1/episodes", spec);
    session.watch({ kind: "episode", id: made.id });
  }

  function act(body) {
    const use = uses.find((item) => item.body === body);
    if (use !== undefined) attempt(() => perform(taskOf(use)));
  }

  function refresh() {
    const live = view.mode === "live" && view.watching !== null;
    uses = live ? usesOf(view.scene) : [];
    objects.allow(uses.map((use) => use.body));
    const episode = live && view.watching.kind === "episode";
    const button = (words, work) => el("button", { type: "button", onclick: () => attempt(work) }, words);
    const seats = uses.filter((use) => use.does === "sit");
    const items = uses.filter((use) => use.does === "strike").map((use) => button(`Hit the ${use.body}`, () =>
      perform(taskOf(use))));
    if (items.length > 0) items.push(limb);
    for (const use of seats) {
      items.push(button(`Sit on the ${use.body}`, () => perform({ type: "sit", mark: use.mark })));
      if (episode) items.push(button("Get up", () => perform({ type: "get_up", mark: use.mark })));
    }
    if (episode) {
      items.push(button("Skip this task", () => call("POST", `/v1/episodes/${view.watching.id}/skip`)));
      items.push(button("End", () => call("DELETE", `/v1/episodes/${view.watching.id}`)));
    }
    byId("deeds").replaceChildren(...items);
    byId("deeds").hidden = items.length === 0;
  }
  for (const topic of ["scene", "watching", "mode"]) on(topic, refresh);
  refresh();
  return act;
}
