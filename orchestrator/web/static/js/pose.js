// From states at 30 Hz to poses at the screen's rate.

const LONGEST_STEP_MS = 120;

/** Where all joints are: (22 x 3) metres and (22 x 4) quaternions wxyz, world frame. */
export function emptyPose(joints) {
  return { positions: new Float32Array(3 * joints), rotations: new Float32Array(4 * joints) };
}

/** a + (b - a) * t, joint by joint, into `out`; quaternions take the shorter way. */
export function blend(a, b, t, out) {
  for (let i = 0; i < out.positions.length; i++) {
    out.positions[i] = a.positions[i] + (b.positions[i] - a.positions[i]) * t;
  }
  for (let i = 0; i < out.rotations.length; i += 4) {
    let dot = 0;
    for (let k = i; k < i + 4; k++) dot += a.rotations[k] * b.rotations[k];
    const sign = dot < 0 ? -1 : 1;
    let norm = 0;
    for (let k = i; k < i + 4; k++) {
      const value = a.rotations[k] * (1 - t) + sign * b.rotations[k] * t;
      out.rotations[k] = value;
      norm += value * value;
    }
    norm = Math.sqrt(norm) || 1;
    for (let k = i; k < i + 4; k++) out.rotations[k] /= norm;
  }
}

function copy(from, to) {
  to.positions.set(from.positions);
  to.rotations.set(from.rotations);
}

/** Glides from what is on screen to the newest state; keeps no others. */
export class LivePose {
  constructor(joints) {
    this.shown = emptyPose(joints);
    this.from = emptyPose(joints);
    this.to = null;
    this.since = 0;
    this.step = 33;
  }

  /** A new state came at `now` (ms). A jump (reset, another character) is not glided over. */
  push(frame, now) {
    if (this.to === null || jumped(this.shown, frame)) {
      copy(frame, this.shown);
    } else {
      this.step += 0.2 * (Math.min(now - this.since, LONGEST_STEP_MS) - this.step);
    }
    copy(this.shown, this.from);
    this.to = frame;
    this.since = now;
  }

  /** The pose to draw at `now`. */
  at(now) {
    if (this.to === null) return null;
    blend(this.from, this.to, Math.min(1, (now - this.since) / Math.max(this.step, 8)), this.shown);
    return this.shown;
  }

  /** Forget everything (another character). */
  clear() {
    this.to = null;
  }
}

function jumped(a, b) {
  const d = Math.hypot(
    a.positions[0] - b.positions[0],
    a.positions[1] - b.positions[1],
    a.positions[2] - b.positions[2],
  );
  return d > 0.6;
}

/** The pose of a plan at a tick (30 Hz): frame i is at start_tick / 30 + (i + 1) / fps seconds. */
export function planPose(plan, tick, out) {
  const frames = plan.count;
  const exact = ((tick - plan.startTick) / 30) * plan.fps - 1;
  const place = Math.min(Math.max(exact, 0), frames - 1);
  const i = Math.floor(place);
  const j = Math.min(i + 1, frames - 1);
  blend(frameOf(plan, i), frameOf(plan, j), place - i, out);
  return out;
}

/** Views of frame i of many, without copying. */
export function frameOf(many, i) {
  const joints = many.joints;
  return {
    positions: many.positions.subarray(3 * joints * i, 3 * joints * (i + 1)),
    rotations: many.rotations.subarray(4 * joints * i, 4 * joints * (i + 1)),
  };
}
