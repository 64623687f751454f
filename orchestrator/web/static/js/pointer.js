// What a mouse or finger does in the 3D view: targets, limbs, pushes. Everything else turns the camera.

import * as THREE from "/web/vendor/three.module.js";

const CLICK_PX = 6;
const NS_PER_M = 110;
const MOST_NS = 180;
const LEAST_NS = 4;
const FARTHEST_M = 25;
const NEAR_PX = { mouse: 12, pen: 14, touch: 26 }; // so far beside a limb or the ball still takes it
const STEADY_MS = 1000;

/**
 * Calls back with what was meant: floor(point), limb(joint), object(name), moveTarget(point), dropTarget(point),
 * moveKey(joint, point), push(joint, impulse), pushing(newtonseconds or null). Where not `enabled`, only the camera can be turned and, with
 * `objectsEnabled`, an object clicked.
 */
export class Pointer {
  constructor({ world, mannequin, marker, arrow, objects, keys }, callbacks) {
    Object.assign(this, { world, mannequin, marker, arrow, objects, keys, callbacks });
    this.enabled = true;
    this.objectsEnabled = true;
    this.raycaster = new THREE.Raycaster();
    this.plane = new THREE.Plane();
    this.drag = null;
    this.overUntil = 0;
    const { canvas } = world;
    canvas.addEventListener("pointerdown", (event) => this.down(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", () => this.cancel());
    window.addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.cancel();
    });
  }

  down(event) {
    if (!event.isPrimary || event.button !== 0) {
      this.cancel();
      return;
    }
    this.drag = { kind: "view", x: event.clientX, y: event.clientY, moved: false };
    this.aim(event);
    const found = this.found(event);
    if (found === null) return;
    this.drag = { ...this.drag, ...found };
    if (found.kind === "object") return; // drawn aside it turns the camera
    if (found.kind === "key") {
      this.facing(found.point, false);
    } else if (found.kind === "target") {
      this.facing(this.marker.position, this.marker.joint === "traj");
    } else {
      Object.assign(this.drag, { from: found.body.point.clone(), along: new THREE.Vector3() });
      this.facing(found.body.point, false);
    }
    this.world.controls.enabled = false;
    this.world.canvas.setPointerCapture(event.pointerId);
  }

  move(event) {
    const { drag } = this;
    if (drag === null) {
      this.hover(event);
      return;
    }
    if (!event.isPrimary) return;
    if (Math.hypot(event.clientX - drag.x, event.clientY - drag.y) > CLICK_PX) drag.moved = true;
    if (!drag.moved || drag.kind === "view" || drag.kind === "object") return;
    this.aim(event);
    const point = this.raycaster.ray.intersectPlane(this.plane, new THREE.Vector3());
    if (point === null) return;
    if (drag.kind === "key") {
      if (this.nearEnough(point)) this.callbacks.moveKey(drag.joint, point);
      return;
    }
    if (drag.kind === "target") {
      if (this.marker.joint !== "traj") point.z = Math.max(point.z, 0.02);
      if (this.nearEnough(point)) {
        drag.point = point;
        this.callbacks.moveTarget(point);
      }
      return;
    }
    drag.along.copy(point).sub(drag.from);
    drag.along.clampLength(0, MOST_NS / NS_PER_M);
    this.arrow.show(drag.from, drag.along);
    this.callbacks.pushing(drag.along.length() * NS_PER_M);
  }

  up(event) {
    const { drag } = this;
    if (drag === null || !event.isPrimary) return;
    this.cancel();
    if (drag.kind === "object") {
      if (!drag.moved) this.callbacks.object(drag.name);
      return;
    }
    if (!this.enabled) return;
    if (drag.kind === "target") {
      if (drag.moved && drag.point) this.callbacks.dropTarget(drag.point);
    } else if (drag.kind === "body") {
      const impulse = drag.along.clone().multiplyScalar(NS_PER_M);
      if (drag.moved && impulse.length() >= LEAST_NS) this.callbacks.push(drag.body.joint, impulse);
      else if (!drag.moved && drag.body.limb !== null) this.callbacks.limb(drag.body.limb);
    } else if (drag.kind === "view" && !drag.moved) {
      this.aim(event);
      const point = this.floorPoint();
      if (point !== null && this.nearEnough(point)) this.callbacks.floor(point);
    }
  }

  cancel() {
    this.drag = null;
    this.world.controls.enabled = true;
    this.arrow.hide();
    this.callbacks.pushing(null);
  }

  hover(event) {
    if (event.pointerType === "touch") return;
    this.aim(event);
    const over = this.found(event) !== null;
    this.overUntil = over ? performance.now() + STEADY_MS : 0;
    this.world.canvas.classList.toggle("over-body", over);
    this.world.canvas.classList.toggle("over-floor", this.enabled && !over && this.floorPoint() !== null);
  }

  /**
   * What a press would take, `aim` being done: { kind: "key", joint, point }, { kind: "target" }, { kind: "body", body }, { kind: "object", name }, or
   * null. What is under the pointer goes before what is a little beside it.
   */
  found(event) {
    const key = this.enabled ? this.keys.under(this.raycaster) : null;
    if (key !== null) return { kind: "key", ...key }; // drawn over everything, and taken before it
    const [first] = this.hits().sort((a, b) => a.distance - b.distance);
    if (first !== undefined) return first;
    if (!this.enabled) return null;
    const near = NEAR_PX[event.pointerType] ?? NEAR_PX.mouse;
    const away = (position) => {
      const { x, y } = onScreen(this.world, position);
      return Math.hypot(x - event.clientX, y - event.clientY);
    };
    const ball = this.marker.ballDrawn();
    if (ball !== null && away(ball) <= near) return { kind: "target" };
    const [limb] = this.mannequin.limbs().filter((item) => away(item.point) <= near)
      .sort((a, b) => away(a.point) - away(b.point));
    return limb === undefined ? null : { kind: "body", body: limb };
  }

  hits() {
    const out = [];
    const grabbed = this.enabled ? this.marker.hit(this.raycaster) : null;
    if (grabbed !== null) out.push({ kind: "target", distance: grabbed.distance });
    const body = this.enabled ? this.mannequin.under(this.raycaster) : null;
    if (body !== null) {
      out.push({ kind: "body", body, distance: this.raycaster.ray.origin.distanceTo(body.point) });
    }
    const object = this.objectsEnabled ? this.objects.under(this.raycaster) : null;
    if (object !== null) out.push({ kind: "object", ...object });
    return out;
  }

  /** What is held at this moment: { kind: "view" | "target" | "body" | "key" | "object", joint, name }, or null. */
  held() {
    if (this.drag === null) return null;
    const { kind, body, name, joint } = this.drag;
    const held = kind === "target" ? this.marker.joint : (body?.joint ?? joint);
    return { kind, joint: held ?? null, name: name ?? null };
  }

  /** Whether the camera must keep still: while something is dragged, and when the pointer has just come upon it. */
  steadies(now) {
    return this.drag === null ? now < this.overUntil : this.drag.kind !== "view";
  }

  aim(event) {
    const box = this.world.canvas.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * 2 - 1;
    const y = 1 - ((event.clientY - box.top) / box.height) * 2;
    this.raycaster.setFromCamera(new THREE.Vector2(x, y), this.world.camera);
  }

  /** Set the plane of a drag: the floor, or upright through a point and facing the camera. */
  facing(point, floor) {
    if (floor) {
      this.plane.set(new THREE.Vector3(0, 0, 1), 0);
      return;
    }
    const normal = this.world.camera.getWorldDirection(new THREE.Vector3()).negate();
    this.plane.setFromNormalAndCoplanarPoint(normal, point);
  }

  floorPoint() {
    const floor = new THREE.Plane(new THREE.Vector3(0, 0, 1), 0);
    return this.raycaster.ray.intersectPlane(floor, new THREE.Vector3());
  }

  nearEnough(point) {
    return point.distanceTo(this.world.controls.target) < FARTHEST_M;
  }
}

/** Where a point of the world is on the page, in pixels (for tests and labels). */
export function onScreen(world, position) {
  const point = new THREE.Vector3(...position).project(world.camera);
  const box = world.canvas.getBoundingClientRect();
  return { x: box.left + ((point.x + 1) / 2) * box.width, y: box.top + ((1 - point.y) / 2) * box.height };
}
