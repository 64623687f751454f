// How the mannequin is built: for every joint of the skeleton the solids that move with it.

import { blob, flatBelow, limb } from "./shapes.js";

const SKIN = 0xe9e2d6;
const JOINT = 0x596475;
const SHOE = 0x596475;
const VISOR = 0x2b313c;

const THIGH = [[0.0, 0.082], [0.12, 0.086], [0.4, 0.076], [0.75, 0.058], [0.95, 0.05]];
const SHANK = [[0.04, 0.048], [0.25, 0.057], [0.45, 0.052], [0.75, 0.037], [0.97, 0.033]];
const UPPER_ARM = [[0.0, 0.052], [0.2, 0.051], [0.45, 0.048], [0.8, 0.038], [0.97, 0.035]];
const FOREARM = [[0.03, 0.036], [0.22, 0.043], [0.5, 0.037], [0.85, 0.026], [0.98, 0.025]];

/**
 * Solids of every joint.
 * @param skeleton as from /v1/skeleton
 * @returns {Object<string, {shape, colour}[]>} by joint name
 */
export function figure(skeleton) {
  const offset = Object.fromEntries(skeleton.joints.map((name, i) => [name, skeleton.offsets_m[i]]));
  const ground = skeleton.rest_positions_m[skeleton.joints.indexOf("left_ankle")][2];
  const parts = {
    pelvis: [
      skin(blob([0.0, 0, -0.02], [0.106, 0.156, 0.112], 2.4)),
      dark(blob([-0.008, 0, 0.085], [0.086, 0.116, 0.07], 2.2)),
    ],
    spine1: [skin(blob([0.004, 0, 0.07], [0.094, 0.126, 0.125], 2.3))],
    spine2: [skin(blob([0.006, 0, 0.035], [0.106, 0.148, 0.15], 2.3))],
    spine3: [
      skin(blob([0.002, 0, 0.045], [0.115, 0.166, 0.15], 2.5)),
      skin(blob([-0.012, 0, 0.14], [0.082, 0.125, 0.075])),
    ],
    neck: [skin(limb([0.03, 0, 0.12], [[-0.45, 0.06], [0.2, 0.052], [0.9, 0.05]]))],
    head: [
      skin(blob([0.012, 0, 0.085], [0.096, 0.079, 0.122], 2.15)),
      skin(blob([0.04, 0, 0.005], [0.058, 0.054, 0.055])),
      { shape: blob([0.034, 0, 0.096], [0.081, 0.0725, 0.026], 2.3), colour: VISOR },
    ],
  };
  for (const side of ["left", "right"]) {
    const sign = side === "left" ? 1 : -1;
    const of = (name) => `${side}_${name}`;
    parts[of("hip")] = [
      dark(blob([0, 0.008 * sign, 0.0], [0.084, 0.08, 0.084])),
      skin(limb(offset[of("knee")], THIGH.map(([place, radius]) => [place, radius]))),
    ];
    parts[of("knee")] = [
      dark(blob([0.004, 0, 0], [0.052, 0.052, 0.052])),
      skin(limb(offset[of("ankle")], SHANK, [1, 1.05])),
    ];
    parts[of("ankle")] = [
      dark(blob([0, 0, 0], [0.037, 0.037, 0.037])),
      shoe(flatBelow(blob([0.04, 0, -0.03], [0.118, 0.046, 0.048], 2.5), -ground + 0.002)),
    ];
    const sole = -ground - offset[of("foot")][2];
    parts[of("foot")] = [shoe(flatBelow(blob([0.0, 0, 0.004], [0.085, 0.0475, 0.04], 2.5), sole + 0.002))];
    const across = offset[of("shoulder")];
    parts[of("collar")] = [skin(limb(across, [[-0.35, 0.06], [0.3, 0.066], [0.85, 0.055]]))];
    parts[of("shoulder")] = [
      dark(blob([0, 0, 0], [0.058, 0.058, 0.058])),
      skin(limb(offset[of("elbow")], UPPER_ARM)),
    ];
    parts[of("elbow")] = [
      dark(blob([0, 0, 0], [0.039, 0.039, 0.039])),
      skin(limb(offset[of("wrist")], FOREARM)),
    ];
    parts[of("wrist")] = [
      dark(blob([0, 0, 0], [0.027, 0.027, 0.027])),
      skin(blob([0.004, 0.062 * sign, -0.002], [0.038, 0.05, 0.019], 2.4)),
      skin(limb([0.012 * sign * sign, 0.075 * sign, 0], [[1.1, 0.018], [1.5, 0.017], [2.15, 0.012]], [1.7, 0.85])),
      skin(limb([0.035, 0.05 * sign, -0.006], [[0.5, 0.015], [1.0, 0.014], [1.5, 0.011]])),
    ];
  }
  return parts;
}

function skin(shape) {
  return { shape, colour: SKIN };
}

function dark(shape) {
  return { shape, colour: JOINT };
}

function shoe(shape) {
  return { shape, colour: SHOE };
}
