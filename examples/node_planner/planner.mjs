// A planner without any of our code: Node and ZeroMQ, from docs/protocol.md alone.
//
//   cd examples/node_planner && npm install && node planner.mjs tcp://127.0.0.1:5611
//   motionloop conformance tcp://127.0.0.1:5611
//   motionloop swap planner --endpoint tcp://127.0.0.1:5611
//
// It keeps the pose that the prefix ends in and slides it to a target of the root ("traj"), at most 1 m/s.
import { randomUUID } from "node:crypto";
import { Router } from "zeromq";

const VERSION = 2;
const FPS = 20;
const TICK_HZ = 30;
const JOINTS = [
  "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
  "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
  "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "traj",
];
const FURTHEST_M = 10;
const SPEED_MPS = 1;
const INSTANCE = randomUUID();
const STARTED_MS = Date.now();
const SPEC = {
  name: "slide", version: "0.1.0", weights_sha256: null, skeleton: "human22", fps: FPS, prefix_frames: 20,
  plan_frames: 40, replan_frames: null, target_joints: ["traj"], conditions: ["target"],
};

const CRC = Uint32Array.from({ length: 256 }, (_, n) => {
  for (let bit = 0; bit < 8; bit++) n = n & 1 ? (n >>> 1) ^ 0xedb88320 : n >>> 1;
  return n >>> 0;
});
function crc32(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) crc = CRC[(crc ^ byte) & 0xff] ^ (crc >>> 8);
  return (crc ^ 0xffffffff) >>> 0;
}

class Refusal extends Error {
  constructor(code, message, field = null, allowed = null, retryable = false) {
    super(message);
    this.body = { code, message, retryable, field, allowed };
  }
}

/** Header and arrays of received frames; throws a Refusal. */
function read(frames) {
  if (frames.length < 2 || frames[0].length !== 8 || frames[0].toString("latin1", 0, 4) !== "MLP\x01")
    throw new Refusal("malformed_message", "not a motionloop message");
  if (frames[0].readUInt32LE(4) !== crc32(frames[1]))
    throw new Refusal("malformed_message", "the header was corrupted on the way");
  const text = frames[1].toString("utf8");
  const header = JSON.parse(text);
  // A seed has 63 bits, a number of JavaScript 53: it goes back as the digits that came.
  header.seed = /"seed":\s*(\d+)/.exec(text)?.[1] ?? "0";
  header.arrays = Object.fromEntries((header.arrays ?? []).map((row, i) => {
    if (row.crc32 !== crc32(frames[i + 2])) throw new Refusal("malformed_message", `${row.name} was corrupted`);
    return [row.name, { ...row, bytes: frames[i + 2] }];
  }));
  return header;
}

/** Frames of a reply; `arrays` are [name, dtype, shape, typed array]. */
function write(request, type, body, arrays = [], seed = null) {
  const table = arrays.map(([name, dtype, shape, data]) => ({ name, dtype, shape, crc32: crc32(bytesOf(data)) }));
  const header = {
    protocol_version: VERSION, type, message_id: request.message_id ?? "unknown-id", sequence: request.sequence ?? 0,
    instance_id: INSTANCE, body, arrays: table,
  };
  if (request.character_id) header.character_id = request.character_id;
  if (request.trace_id) header.trace_id = request.trace_id;
  let text = JSON.stringify(header);
  if (seed !== null) text = text.replace('"seed":0', `"seed":${seed}`);
  const json = Buffer.from(text);
  const first = Buffer.alloc(8);
  first.write("MLP\x01", "latin1");
  first.writeUInt32LE(crc32(json), 4);
  return [first, json, ...arrays.map(([, , , data]) => bytesOf(data))];
}
const bytesOf = (data) => Buffer.from(data.buffer, data.byteOffset, data.byteLength);

function floats(array) {
  const copy = Uint8Array.from(array.bytes); // aligned, whatever the frame's place in memory was
  return new Float32Array(copy.buffer);
}

function checkTargets(targets, rootXY) {
  targets.forEach((target, number) => {
    if (!JOINTS.includes(target.joint))
      throw new Refusal("invalid_input", `unknown joint ${target.joint}`, `targets.${number}.joint`, JOINTS.join(", "));
    const [x, y, z] = target.position_w_m;
    if (Math.hypot(x - rootXY[0], y - rootXY[1]) > FURTHEST_M || Math.abs(z) > FURTHEST_M)
      throw new Refusal("invalid_input", "the target is out of reach", `targets.${number}.position_w_m`,
        `within ${FURTHEST_M} m`);
  });
}

function plan(request) {
  const { body, arrays } = request;
  if (body.fps !== FPS) throw new Refusal("invalid_input", `fps is ${body.fps}`, "fps", `${FPS}`);
  const frames = body.horizon_frames ?? 40;
  if (frames > SPEC.plan_frames)
    throw new Refusal("invalid_input", `horizon_frames is ${frames}`, "horizon_frames", `<= ${SPEC.plan_frames}`);
  const pose = floats(arrays.prefix_positions_w_m).slice(-66);
  const turns = floats(arrays.prefix_rotations_6d).slice(-132);
  const targets = body.targets ?? [];
  checkTargets(targets, pose);
  const target = targets.find((each) => each.joint === "traj");
  let way = [0, 0];
  let seconds = 1;
  if (target) {
    way = [target.position_w_m[0] - pose[0], target.position_w_m[1] - pose[1]];
    const given = (target.arrival_tick - body.start_tick) / TICK_HZ;
    seconds = Math.max(given, Math.hypot(...way) / SPEED_MPS, 1 / FPS);
  }
  const positions = new Float32Array(frames * 66);
  const rotations = new Float32Array(frames * 132);
  for (let frame = 0; frame < frames; frame++) {
    const share = Math.min((frame + 1) / FPS / seconds, 1);
    for (let joint = 0; joint < 22; joint++) {
      const at = frame * 66 + joint * 3;
      positions[at] = pose[joint * 3] + way[0] * share;
      positions[at + 1] = pose[joint * 3 + 1] + way[1] * share;
      positions[at + 2] = pose[joint * 3 + 2];
    }
    rotations.set(turns, frame * 132);
  }
  const ignored = targets.filter((each) => each.joint !== "traj").map((each) => `target:${each.joint}`);
  for (const [name, asked] of [
    ["text", body.text], ["heading", body.heading], ["velocity", body.desired_velocity_w_mps],
    ["facing", body.facing_rad],
  ]) if (asked !== null && asked !== undefined) ignored.push(name);
  for (const [name, array] of [["keyframes", "keyframe_ticks"], ["obstacles", "obstacle_pos_w_m"]])
    if (arrays[array]?.shape[0] > 0) ignored.push(name);
  const reply = {
    seed: 0, planner: SPEC.name, weights_id: null, skeleton: "human22", start_tick: body.start_tick, fps: FPS,
    action_space: null, ignored_conditions: ignored, timings_ms: {},
  };
  return write(request, "Plan", reply, [
    ["positions_w_m", "<f4", [frames, 22, 3], positions],
    ["rotations_6d", "<f4", [frames, 22, 6], rotations],
    ["actions", "<f4", [0, 0], new Float32Array(0)],
  ], request.seed);
}

function answer(request) {
  if (request.protocol_version !== VERSION)
    throw new Refusal("incompatible_peer", `the peer speaks protocol version ${request.protocol_version}, this side `
      + `speaks ${VERSION}`, "protocol_version", `${VERSION}`);
  if (request.type === "Hello") {
    if (request.body.skeleton && request.body.skeleton !== "human22")
      throw new Refusal("incompatible_peer", `skeleton ${request.body.skeleton}`, "skeleton", "human22");
    if (request.body.plugin && request.body.plugin !== SPEC.name)
      throw new Refusal("incompatible_peer", `no planner ${request.body.plugin}`, "plugin", SPEC.name);
    return write(request, "Welcome", {
      service: "planner", version: "0.1.0", protocol_version: VERSION, instance_id: INSTANCE,
      default_plugin: SPEC.name, plugins: [SPEC], state_endpoint: null,
    });
  }
  if (request.type === "Health")
    return write(request, "HealthReport", { status: "ok", uptime_s: (Date.now() - STARTED_MS) / 1000, detail: {} });
  if (request.instance_id !== INSTANCE)
    throw new Refusal("handshake_required", "shake hands first", null, null, true);
  if (request.deadline_unix_s && request.deadline_unix_s * 1000 < Date.now())
    throw new Refusal("deadline_exceeded", "too late", null, null, true);
  if (request.type === "ReadText") return write(request, "TextRead", { nearest: null, similarity: null, far: null });
  if (request.type !== "PlanRequest")
    throw new Refusal("malformed_message", `a planner does not answer ${request.type}`, "type", "PlanRequest");
  const wanted = request.body.planner;
  if (wanted && wanted !== SPEC.name) throw new Refusal("invalid_input", `no planner ${wanted}`, "planner", SPEC.name);
  return plan(request);
}

const replies = new Map(); // the first reply to a message id is the reply to each repetition
const socket = new Router({ linger: 0 });
await socket.bind(process.argv[2] ?? "tcp://127.0.0.1:5611");
console.log(`planner ready at ${socket.lastEndpoint} with ${SPEC.name}`);
for (const signal of ["SIGTERM", "SIGINT"]) process.on(signal, () => process.exit(0));
for await (const [sender, ...frames] of socket) {
  let request = {};
  let reply;
  try {
    request = read(frames);
    reply = replies.get(request.message_id) ?? answer(request);
    replies.set(request.message_id, reply);
    if (replies.size > 2048) replies.delete(replies.keys().next().value);
  } catch (error) {
    const body = error instanceof Refusal ? error.body
      : { code: "malformed_message", message: String(error), retryable: false, field: null, allowed: null };
    reply = write(request, "ErrorReply", body);
  }
  await socket.send([sender, ...reply]);
}
