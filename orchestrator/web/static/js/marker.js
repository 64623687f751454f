// The target on the floor or in the air, and the arrow of a push.

import * as THREE from "/web/vendor/three.module.js";

import { accent } from "./world.js";

/** A ring on the floor for the whole body; for a joint a ball with a line down to its ring. */
export class TargetMarker {
  constructor(scene) {
    const colour = accent();
    this.root = new THREE.Group();
    this.root.visible = false;
    this.flat = new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.95, depthWrite: false,
      side: THREE.DoubleSide });
    this.soft = this.flat.clone();
    this.soft.opacity = 0.16;
    this.ring = new THREE.Mesh(new THREE.RingGeometry(0.235, 0.262, 64), this.flat);
    this.disc = new THREE.Mesh(new THREE.CircleGeometry(0.235, 48), this.soft);
    this.dot = new THREE.Mesh(new THREE.CircleGeometry(0.045, 32), this.flat);
    this.wave = new THREE.Mesh(this.ring.geometry, this.soft.clone());
    for (const part of [this.disc, this.ring, this.dot, this.wave]) part.renderOrder = 0;
    this.ball = new THREE.Mesh(new THREE.SphereGeometry(0.055, 24, 16),
      new THREE.MeshStandardMaterial({ color: colour, emissive: colour, emissiveIntensity: 0.35, roughness: 0.4 }));
    this.stem = new THREE.Line(
      new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(), new THREE.Vector3(0, 0, -1)]),
      new THREE.LineBasicMaterial({ color: colour, transparent: true, opacity: 0.55 }),
    );
    this.ground = new THREE.Group();
    this.ground.add(this.disc, this.ring, this.dot, this.wave);
    this.root.add(this.ground, this.ball, this.stem);
    // What a finger can grab is larger than what is drawn.
    this.grip = new THREE.Mesh(new THREE.SphereGeometry(0.16, 12, 8), new THREE.MeshBasicMaterial({ visible: false }));
    this.pad = new THREE.Mesh(new THREE.CylinderGeometry(0.29, 0.29, 0.06, 24).rotateX(Math.PI / 2),
      new THREE.MeshBasicMaterial({ visible: false }));
    this.root.add(this.grip, this.pad);
    this.position = new THREE.Vector3();
    this.joint = null;
    scene.add(this.root);
  }

  /** Show the target of a command ({ joint, position_m } or null). */
  show(target, pulse) {
    this.root.visible = target !== null;
    if (target === null) return;
    const floor = target.joint === "traj";
    const [x, y, z] = target.position_m;
    const height = floor ? 0 : z;
    this.joint = target.joint;
    this.position.set(x, y, height);
    this.root.position.set(x, y, height);
    this.ground.position.z = 0.008 - height;
    this.ground.scale.setScalar(floor ? 1 : 0.45);
    this.pad.position.z = 0.02 - height;
    this.pad.visible = floor;
    this.ball.visible = !floor;
    this.grip.visible = !floor;
    this.stem.visible = !floor;
    this.stem.scale.z = Math.max(height, 0.001);
    const grown = 1 + 0.55 * pulse;
    this.wave.scale.setScalar(grown);
    this.wave.material.opacity = 0.34 * (1 - pulse);
  }

  /** Where it was last drawn, [x, y, z] in metres, or null. */
  drawn() {
    if (!this.root.visible) return null;
    return new THREE.Vector3().setFromMatrixPosition(this.root.matrixWorld).toArray();
  }

  /** The same for the ball of a joint's target alone. */
  ballDrawn() {
    return this.joint === "traj" ? null : this.drawn();
  }

  /** Whether a ray meets it. */
  hit(raycaster) {
    if (!this.root.visible) return null;
    const part = this.joint === "traj" ? this.pad : this.grip;
    return raycaster.intersectObject(part, false)[0] ?? null;
  }
}

/** The arrow that shows a push while it is drawn. */
export class PushArrow {
  constructor(scene) {
    const material = new THREE.MeshBasicMaterial({ color: accent(), depthTest: false, transparent: true, opacity: 0.95 });
    this.shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.013, 0.013, 1, 12).translate(0, 0.5, 0), material);
    this.tip = new THREE.Mesh(new THREE.ConeGeometry(0.042, 0.1, 20).translate(0, -0.05, 0), material);
    this.root = new THREE.Group();
    this.root.add(this.shaft, this.tip);
    this.root.visible = false;
    for (const part of [this.shaft, this.tip]) part.renderOrder = 5;
    scene.add(this.root);
  }

  /** From a point along a vector, both in the world. */
  show(from, along) {
    const length = along.length();
    this.root.visible = length > 0.03;
    if (!this.root.visible) return;
    this.root.position.copy(from);
    this.root.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.clone().normalize());
    this.shaft.scale.y = Math.max(length - 0.08, 0.01);
    this.tip.position.y = length;
  }

  /** Show nothing. */
  hide() {
    this.root.visible = false;
  }
}
