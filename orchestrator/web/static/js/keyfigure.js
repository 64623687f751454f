// Keyframes in the view: a stick figure for each, and balls on the one that is being edited.

import * as THREE from "/web/vendor/three.module.js";

const COLOUR = 0xd97a12;
const BONE_M = 0.02;
const BALL_M = 0.055;
const FAINT = 0.3;
const CHAINS = {
  left_wrist: ["left_shoulder", "left_elbow", "left_wrist"], right_wrist: ["right_shoulder", "right_elbow", "right_wrist"],
  left_ankle: ["left_hip", "left_knee", "left_ankle"], right_ankle: ["right_hip", "right_knee", "right_ankle"],
};
const ALONG = { left_ankle: "left_foot", right_ankle: "right_foot" };

/** Joints of a key that can be dragged: the pelvis takes the whole pose along, a hand or foot bends its limb. */
export const HANDLES = ["pelvis", ...Object.keys(CHAINS)];

/**
 * Move a joint of a pose (joints x 3, changed in place) to a point, with the lengths of bones kept.
 * @returns the names of the joints that have moved
 */
export function moveJoint(joints, positions, name, point) {
  const read = (joint) => new THREE.Vector3().fromArray(positions, 3 * joints.indexOf(joint));
  const write = (joint, vector) => vector.toArray(positions, 3 * joints.indexOf(joint));
  if (name === "pelvis") {
    const shift = point.clone().sub(read("pelvis"));
    for (const joint of joints) write(joint, read(joint).add(shift));
    return [...joints];
  }
  const [root, middle, end] = CHAINS[name].map(read);
  const before = end.clone();
  const [upper, lower] = [root.distanceTo(middle), middle.distanceTo(end)];
  const along = point.clone().sub(root);
  const reach = Math.min(Math.max(along.length(), Math.abs(upper - lower) + 0.02), upper + lower - 0.005);
  if (along.lengthSq() < 1e-9) along.set(0, 0, -1);
  along.normalize();
  const bend = middle.clone().sub(root);
  bend.addScaledVector(along, -bend.dot(along));
  if (bend.lengthSq() < 1e-8) bend.crossVectors(along, new THREE.Vector3(1, 0.3, 0.2));
  bend.normalize();
  const cos = Math.min(Math.max((upper * upper + reach * reach - lower * lower) / (2 * upper * reach), -1), 1);
  middle.copy(root).addScaledVector(along, upper * cos).addScaledVector(bend, upper * Math.sqrt(1 - cos * cos));
  end.copy(root).addScaledVector(along, reach);
  write(CHAINS[name][1], middle);
  write(name, end);
  const moved = CHAINS[name].slice(1);
  if (name in ALONG) {
    write(ALONG[name], read(ALONG[name]).add(end.clone().sub(before)));
    moved.push(ALONG[name]);
  }
  return moved;
}

/** Draws the keys that there are. */
export class KeyFigures {
  constructor(scene, skeleton) {
    this.joints = skeleton.joints;
    this.bones = skeleton.parents.map((parent, i) => [parent, i]).filter(([parent]) => parent >= 0);
    this.root = new THREE.Group();
    this.figures = new Map();
    this.balls = [];
    this.bone = new THREE.CylinderGeometry(BONE_M, BONE_M, 1, 10).translate(0, 0.5, 0);
    this.ball = new THREE.SphereGeometry(BALL_M, 18, 12);
    const paint = (opacity) =>
      new THREE.MeshStandardMaterial({ color: COLOUR, emissive: COLOUR, emissiveIntensity: 0.3, transparent: true, opacity });
    this.strong = paint(0.9);
    this.faint = paint(FAINT);
    // One reaches for a ball also where the body hides it.
    this.grip = new THREE.MeshBasicMaterial({ color: COLOUR, transparent: true, opacity: 0.85, depthTest: false });
    scene.add(this.root);
  }

  /** Show these keys ({ id, positions }); the selected one with its balls. */
  show(keys, selected) {
    this.root.clear();
    this.balls = [];
    for (const key of keys) {
      const at = (i) => new THREE.Vector3().fromArray(key.positions, 3 * i);
      const mine = key.id === selected;
      for (const [parent, i] of this.bones) {
        const bone = new THREE.Mesh(this.bone, mine ? this.strong : this.faint);
        const along = at(i).sub(at(parent));
        bone.position.copy(at(parent));
        bone.scale.y = along.length();
        bone.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.normalize());
        this.root.add(bone);
      }
      if (!mine) continue;
      for (const joint of HANDLES) {
        const ball = new THREE.Mesh(this.ball, this.grip);
        ball.position.copy(at(this.joints.indexOf(joint)));
        ball.userData.joint = joint;
        ball.renderOrder = 4;
        this.root.add(ball);
        this.balls.push(ball);
      }
    }
  }

  /** The ball that a ray meets: { joint, point }, or null. */
  under(raycaster) {
    const [hit] = raycaster.intersectObjects(this.balls, false);
    return hit === undefined ? null : { joint: hit.object.userData.joint, point: hit.object.position.clone() };
  }

  /** Where the ball of a joint was last drawn, [x, y, z] in metres, or null. */
  drawn(joint) {
    const ball = this.balls.find((item) => item.userData.joint === joint);
    return ball === undefined ? null : new THREE.Vector3().setFromMatrixPosition(ball.matrixWorld).toArray();
  }
}
