// What the page knows and shows, in one place; parts listen to the topics they draw.

const listeners = new Map();

/** Everything on screen comes from here. `frame` is the newest state shown, live or replayed. */
export const view = {
  mode: "live", // or "replay"
  link: "connecting", // "live" | "lost" | "ended"
  watching: null, // { kind: "character" | "episode", id }
  skeleton: null,
  frame: null,
  liveFrame: null, // the newest of the stream, also while something is replayed
  plan: null,
  command: null,
  task: null, // of a running episode
  agenda: [], // of a running episode: [{ type, limb, retries, state, tries, reason }]
  keys: [], // keyframes that are being edited or were sent, see keys.js
  key: null, // id of the one that is edited
  scene: null, // as the seed made it
  events: [],
  health: null,
  services: null,
  updates: 0, // states received since the page was loaded
  measured: { planMs: null, errorMm: null, realtime: null, updatesPerS: null },
  recording: null, // { startTick, stopTick | null }
  picked: null, // joint that the next target is for
};

/** Call `listener` with every value emitted under `topic`. */
export function on(topic, listener) {
  if (!listeners.has(topic)) listeners.set(topic, []);
  listeners.get(topic).push(listener);
}

/** Tell the listeners of a topic. */
export function emit(topic, value) {
  for (const listener of listeners.get(topic) ?? []) listener(value);
}

/** Change fields of the view and tell the listeners of a topic. */
export function update(topic, changes) {
  Object.assign(view, changes);
  emit(topic, view);
}

/** Index of a joint by name. */
export function jointIndex(name) {
  return view.skeleton.joints.indexOf(name);
}

/** Where a joint is in the frame shown, [x, y, z] in metres, or null. */
export function jointPosition(name) {
  if (view.frame === null || view.skeleton === null) return null;
  const i = jointIndex(name);
  return i < 0 ? null : Array.from(view.frame.positions.subarray(3 * i, 3 * i + 3));
}

/** The command's target as { joint, position_m }, or null. */
export function currentTarget() {
  return view.mode === "live" ? (view.command?.target ?? null) : null;
}
