// The objects of a scene, put where the state says.

import * as THREE from "/web/vendor/three.module.js";

const SHAPES = {
  box: ([x, y, z]) => new THREE.BoxGeometry(2 * x, 2 * y, 2 * z),
  cylinder: ([radius, half]) => new THREE.CylinderGeometry(radius, radius, 2 * half, 40).rotateX(Math.PI / 2),
  capsule: ([radius, half]) => new THREE.CapsuleGeometry(radius, 2 * half, 10, 28).rotateX(Math.PI / 2),
  sphere: ([radius]) => new THREE.SphereGeometry(radius, 32, 24),
};

/** Shows the bodies of all known scenes as far as the state names them. */
export class SceneObjects {
  constructor(scene, scenes) {
    this.root = new THREE.Group();
    this.bodies = new Map(scenes.flatMap(({ bodies }) => bodies.map((body) => [body.name, body])));
    this.meshes = new Map();
    this.material = new THREE.MeshStandardMaterial({ color: 0x8a94a6, roughness: 0.75 });
    scene.add(this.root);
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

  mesh(name) {
    if (this.meshes.has(name)) return this.meshes.get(name);
    const body = this.bodies.get(name);
    if (body === undefined) return null;
    const mesh = new THREE.Mesh(SHAPES[body.shape](body.size_m), this.material);
    mesh.castShadow = mesh.receiveShadow = true;
    this.root.add(mesh);
    this.meshes.set(name, mesh);
    return mesh;
  }
}
