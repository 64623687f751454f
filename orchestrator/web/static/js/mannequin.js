// The body on screen: one mesh a joint, put where the state says.

import * as THREE from "/web/vendor/three.module.js";

import { figure } from "./figure.js";
import { accent } from "./world.js";
import { merged } from "./shapes.js";

/** Joints that can be given a target by clicking them, and the parts that stand for each. */
const LIMBS = {
  left_wrist: "left_wrist", right_wrist: "right_wrist", left_foot: "left_foot", right_foot: "right_foot",
  left_ankle: "left_foot", right_ankle: "right_foot",
};
const HANDLE_M = 0.1;
const SAME_SIZE = 0.03; // a blend of two poses is that much shorter

/** Geometry by joint name; shared by the body and the ghost. */
export function bodyShapes(skeleton) {
  return Object.fromEntries(Object.entries(figure(skeleton)).map(([name, parts]) => [name, merged(parts)]));
}

/** The joint whose target a click on this part sets, or null. */
export function limbOf(name) {
  return LIMBS[name] ?? null;
}

/** The bone that tells how large a character is: { from, to, length }. */
export function thighOf({ joints, offsets_m }) {
  const [from, to] = [joints.indexOf("left_hip"), joints.indexOf("left_knee")];
  return { from, to, length: Math.hypot(...offsets_m[to]) };
}

function sizeOf(positions, { from, to, length }) {
  const along = [0, 1, 2].map((k) => positions[3 * to + k] - positions[3 * from + k]);
  const size = Math.hypot(...along) / length;
  return Math.abs(size - 1) < SAME_SIZE ? 1 : size;
}

/** A body with one group a joint. */
export class Mannequin {
  constructor(scene, skeleton, shapes) {
    this.joints = skeleton.joints;
    this.thigh = thighOf(skeleton);
    this.root = new THREE.Group();
    this.root.visible = false;
    this.material = new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 0.55, metalness: 0.02 });
    this.groups = skeleton.joints.map((name) => {
      const group = new THREE.Group();
      const mesh = new THREE.Mesh(shapes[name], this.material);
      mesh.castShadow = true;
      mesh.receiveShadow = true;
      mesh.userData.joint = name;
      group.add(mesh);
      this.root.add(group);
      return group;
    });
    this.handles = this.makeHandles();
    scene.add(this.root);
  }

  /** Put every joint where a pose says. */
  show(pose) {
    this.root.visible = true;
    place(this.groups, pose, this.thigh);
  }

  /** Mark the limb that the next target is for (null: none). */
  pick(name) {
    for (const handle of this.handles) handle.material.visible = handle.userData.limb === name;
  }

  /** The joint under a ray: { joint, point, limb }, or null. */
  under(raycaster) {
    const [hit] = raycaster.intersectObject(this.root, true);
    if (hit === undefined) return null;
    const { joint, limb } = hit.object.userData;
    return { joint, limb: limb ?? limbOf(joint), point: hit.point };
  }

  /** The limbs that can be given a target, where they were last drawn: [{ joint, point, limb }]. */
  limbs() {
    return this.handles.map((handle) => {
      const { joint, limb } = handle.userData;
      return { joint, limb, point: new THREE.Vector3().setFromMatrixPosition(handle.matrixWorld) };
    });
  }

  /** Where a joint was last drawn, [x, y, z] in metres. */
  drawn(joint) {
    return new THREE.Vector3().setFromMatrixPosition(this.groups[this.joints.indexOf(joint)].matrixWorld).toArray();
  }

  makeHandles() {
    const ball = new THREE.SphereGeometry(HANDLE_M, 16, 12);
    return ["left_wrist", "right_wrist", "left_foot", "right_foot"].map((name) => {
      const material = new THREE.MeshBasicMaterial({
        color: accent(), transparent: true, opacity: 0.35, depthWrite: false, visible: false,
      });
      const handle = new THREE.Mesh(ball, material);
      handle.userData = { joint: name, limb: name };
      if (name.endsWith("wrist")) handle.position.y = name.startsWith("left") ? 0.06 : -0.06;
      this.groups[this.joints.indexOf(name)].add(handle);
      return handle;
    });
  }
}

/** Groups to where the joints are; quaternions are wxyz on the wire and xyzw in three.js. */
export function place(groups, { positions, rotations }, thigh) {
  const size = sizeOf(positions, thigh);
  groups.forEach((group, i) => {
    group.scale.setScalar(size);
    group.position.set(positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]);
    group.quaternion.set(rotations[4 * i + 1], rotations[4 * i + 2], rotations[4 * i + 3], rotations[4 * i]);
  });
}
