// Smooth solids of the mannequin, each in the frame of its joint in the T-pose: X forward, Y left, Z up, metres.

import * as THREE from "/web/vendor/three.module.js";

const AROUND = 20;

/**
 * A turned shape from the joint along `to` (a vector). `outline` is [[place along it, radius in metres], ...]; the ends
 * are rounded off. `flat` squeezes it across: [sideways, forward] factors.
 */
export function limb(to, outline, flat = [1, 1]) {
  const axis = new THREE.Vector3(...to);
  const length = axis.length();
  const curve = new THREE.SplineCurve(outline.map(([place, radius]) => new THREE.Vector2(radius, place * length)));
  const [first] = outline;
  const last = outline[outline.length - 1];
  const points = [...cap(first[1], first[0] * length, -1), ...curve.getPoints(14), ...cap(last[1], last[0] * length, 1)];
  const shape = new THREE.LatheGeometry(points, AROUND);
  shape.scale(flat[0], 1, flat[1]);
  const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 1, 0), axis.normalize());
  shape.applyQuaternion(turn);
  return shape;
}

function cap(radius, height, side) {
  const points = [];
  for (let i = 0; i < 5; i++) {
    const angle = (i / 5) * (Math.PI / 2);
    points.push(new THREE.Vector2(radius * Math.sin(angle) + 1e-4, height + side * 0.8 * radius * Math.cos(angle)));
  }
  return side < 0 ? points : points.reverse();
}

/** An ellipsoid: middle and half sizes. `power` above 2 makes it boxier. */
export function blob(middle, sizes, power = 2) {
  const shape = new THREE.SphereGeometry(1, 24, 18);
  if (power !== 2) {
    const points = shape.attributes.position;
    const v = new THREE.Vector3();
    for (let i = 0; i < points.count; i++) {
      v.fromBufferAttribute(points, i);
      const norm = (Math.abs(v.x) ** power + Math.abs(v.y) ** power + Math.abs(v.z) ** power) ** (1 / power);
      v.divideScalar(norm);
      points.setXYZ(i, v.x, v.y, v.z);
    }
  }
  shape.scale(...sizes);
  shape.computeVertexNormals();
  shape.translate(...middle);
  return shape;
}

/** Cut a shape off flat below a height, as the sole of a shoe is. */
export function flatBelow(shape, height) {
  const points = shape.attributes.position;
  for (let i = 0; i < points.count; i++) points.setZ(i, Math.max(points.getZ(i), height));
  shape.computeVertexNormals();
  return shape;
}

/** Several shapes with a colour each as one geometry, so that a body part is one draw call. */
export function merged(parts) {
  const positions = [];
  const normals = [];
  const colours = [];
  for (const { shape, colour } of parts) {
    const plain = shape.index === null ? shape : shape.toNonIndexed();
    positions.push(...plain.attributes.position.array);
    normals.push(...plain.attributes.normal.array);
    const paint = new THREE.Color(colour);
    for (let i = 0; i < plain.attributes.position.count; i++) colours.push(paint.r, paint.g, paint.b);
  }
  const out = new THREE.BufferGeometry();
  out.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
  out.setAttribute("normal", new THREE.Float32BufferAttribute(normals, 3));
  out.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
  return out;
}
