// The objects of a scene, put where the state says.

import * as THREE from "/web/vendor/three.module.js";

const SHAPES = {
  box: ([x, y, z]) => new THREE.BoxGeometry(2 * x, 2 * y, 2 * z),
  cylinder: ([radius, half]) => new THREE.CylinderGeometry(radius, radius, 2 * half, 40).rotateX(Math.PI / 2),
  capsule: ([radius, half]) => new THREE.CapsuleGeometry(radius, 2 * half, 10, 28).rotateX(Math.PI / 2),
  sphere: ([radius]) => new THREE.SphereGeometry(radius, 32, 24),
};

/** Shows the bodies of one scene as far as the state names them. */
export class SceneObjects {
  constructor(scene) {
    this.root = new THREE.Group();
    this.bodies = new Map();
    this.meshes = new Map();
    this.paints = new Map();
    this.useful = new Set();
    scene.add(this.root);
  }

  /** The scene that is shown from now on, as its seed made it; null for none. */
  use(scene) {
    for (const mesh of this.meshes.values()) {
      this.root.remove(mesh);
      for (const solid of mesh.children) solid.geometry.dispose();
    }
    this.meshes.clear();
    this.bodies = new Map((scene?.bodies ?? []).map((body) => [body.name, body]));
  }

  /** Names, positions (O x 3) and quaternions (O x 4, wxyz) of a state. */
  show(names, positions, rotations) {
    for (const mesh of this.meshes.values()) mesh.visible = false;
    names.forEach((name, i) => {
      const mesh = this.mesh(name);
      if (mesh === null) return;
      mesh.visible = true;
      mesh.position.set(positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]);
      mesh.quaternion.set(rotations[4 * i + 1], rotations[4 * i + 2], rotations[4 * i + 3], rotations[4 * i]);
    });
  }

  /** Which bodies do something when they are clicked. */
  allow(names) {
    this.useful = new Set(names);
  }

  /** The useful body that a ray meets first, if no other body is before it: { name, distance }, or null. */
  under(raycaster) {
    const seen = [...this.meshes.values()].filter((mesh) => mesh.visible);
    const [hit] = raycaster.intersectObjects(seen, true);
    const name = hit?.object.parent.userData.name;
    return this.useful.has(name) ? { name, distance: hit.distance } : null;
  }

  /** Where a body is drawn: { position, quaternion } of three.js, or null. */
  poseOf(name) {
    const mesh = this.meshes.get(name);
    return mesh?.visible ? mesh : null;
  }

  /** What is drawn now: name to position and number of parts. */
  shown() {
    const visible = [...this.meshes].filter(([, mesh]) => mesh.visible);
    return Object.fromEntries(visible.map(([name, mesh]) => [name, [...mesh.position.toArray(), mesh.children.length]]));
  }

  /** The material of a colour, [red, green, blue] from 0 to 1, or null for the usual one. */
  paint(colour) {
    const key = String(colour);
    if (!this.paints.has(key)) {
      const color = new THREE.Color(0x8a94a6);
      if (colour !== null) color.setRGB(...colour, THREE.SRGBColorSpace);
      this.paints.set(key, new THREE.MeshStandardMaterial({ color, roughness: 0.75 }));
    }
    return this.paints.get(key);
  }

  mesh(name) {
    if (this.meshes.has(name)) return this.meshes.get(name);
    const body = this.bodies.get(name);
    if (body === undefined) return null;
    const mesh = new THREE.Group();
    mesh.userData.name = name;
    for (const part of body.parts) {
      const solid = new THREE.Mesh(SHAPES[part.shape](part.size_m), this.paint(part.colour));
      solid.position.set(...part.position_b_m);
      solid.rotation.set(...part.rotation_deg.map(THREE.MathUtils.degToRad), "ZYX");
      solid.castShadow = solid.receiveShadow = true;
      mesh.add(solid);
    }
    this.root.add(mesh);
    this.meshes.set(name, mesh);
    return mesh;
  }
}
