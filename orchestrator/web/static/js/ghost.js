// The plan: a translucent body about a second ahead, and the path of its pelvis on the floor.

import * as THREE from "/web/vendor/three.module.js";

import { place, thighOf } from "./mannequin.js";
import { emptyPose, planPose } from "./pose.js";
import { accent } from "./world.js";

const AHEAD_TICKS = 27;
const CLEAR_OF_BODY_M = 0.05; // nearer to the body than this (on average) the ghost would only muddy it
const OPAQUE_M = 0.35;
const STRENGTH = 0.27;
const PATH_POINTS = 24;

/** Draws the newest plan; `on` is the viewer's choice. */
export class Ghost {
  constructor(scene, skeleton, shapes) {
    this.on = true;
    this.thigh = thighOf(skeleton);
    this.pose = emptyPose(skeleton.joints.length);
    this.spare = emptyPose(skeleton.joints.length);
    this.root = new THREE.Group();
    this.root.visible = false;
    const colour = accent();
    // Two passes: the first fills only the depth, so that inner faces do not shine through the outer ones.
    const depth = new THREE.MeshBasicMaterial({ colorWrite: false });
    this.skin = new THREE.MeshStandardMaterial({ color: colour, transparent: true, depthFunc: THREE.LessEqualDepth,
      roughness: 0.9, emissive: colour, emissiveIntensity: 0.25 });
    this.groups = skeleton.joints.map((name) => {
      const group = new THREE.Group();
      const first = new THREE.Mesh(shapes[name], depth);
      const second = new THREE.Mesh(shapes[name], this.skin);
      first.renderOrder = 1;
      second.renderOrder = 2;
      group.add(first, second);
      this.root.add(group);
      return group;
    });
    this.path = new THREE.Points(
      new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * PATH_POINTS), 3)),
      new THREE.PointsMaterial({ color: colour, size: 0.055, map: disc(), transparent: true, opacity: 0.8,
        depthWrite: false }),
    );
    this.path.frustumCulled = false;
    scene.add(this.root, this.path);
  }

  /** Draw `plan` for a body at `tick` in `pose`. */
  show(plan, tick, pose) {
    const end = plan === null ? 0 : plan.startTick + (plan.count / plan.fps) * 30;
    const shown = this.on && plan !== null && tick < end;
    this.path.visible = shown;
    this.root.visible = shown;
    if (!shown) return;
    planPose(plan, Math.min(tick + AHEAD_TICKS, end), this.pose);
    const away = distance(this.pose, pose);
    const strength = Math.min(Math.max((away - CLEAR_OF_BODY_M) / (OPAQUE_M - CLEAR_OF_BODY_M), 0), 1);
    this.root.visible = strength > 0.02;
    this.skin.opacity = STRENGTH * strength;
    place(this.groups, this.pose, this.thigh);
    this.drawPath(plan, tick, end);
  }

  /** Show nothing. */
  hide() {
    this.root.visible = false;
    this.path.visible = false;
  }

  drawPath(plan, tick, end) {
    const points = this.path.geometry.attributes.position;
    let count = 0;
    let last = null;
    for (let i = 0; i < PATH_POINTS; i++) {
      planPose(plan, tick + ((end - tick) * i) / (PATH_POINTS - 1), this.spare);
      const [x, y] = this.spare.positions;
      if (last !== null && Math.hypot(x - last[0], y - last[1]) < 0.06) continue;
      points.setXYZ(count, x, y, 0.012);
      last = [x, y];
      count += 1;
    }
    this.path.geometry.setDrawRange(0, count > 2 ? count : 0);
    points.needsUpdate = true;
  }
}

/** A round dot: points are square by themselves. */
function disc() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 32;
  const g = canvas.getContext("2d");
  g.fillStyle = "#fff";
  g.arc(16, 16, 14, 0, 2 * Math.PI);
  g.fill();
  return new THREE.CanvasTexture(canvas);
}

function distance(a, b) {
  let sum = 0;
  const joints = a.positions.length / 3;
  for (let i = 0; i < joints; i++) {
    sum += Math.hypot(
      a.positions[3 * i] - b.positions[3 * i],
      a.positions[3 * i + 1] - b.positions[3 * i + 1],
      a.positions[3 * i + 2] - b.positions[3 * i + 2],
    );
  }
  return sum / joints;
}
